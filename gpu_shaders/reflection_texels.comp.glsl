// From which triangle the centre of each of a map's texels sees to the range of its depths within the texel.
#include "lib/scene_data.glsl"
#include "lib/reflection_map.glsl"

#ifdef OF_CLOUD
const uint NOT_COVERED = 0xffffffffu;

// What a texel shows: what the rasterizer drew, or what was splatted before it.
uvec2 nearer(ReflectionMap map, int face, ivec2 cell, ivec2 at, uvec2 drawn) {
    ivec2 address = linear_texel(first_texel + at.y * map.size.x + at.x);
    uint number = texelFetch(nearest_numbers, address, 0).x;
    if (number == NOT_COVERED) {
        return drawn;
    }
    vec4 work = texelFetch(work_table, linear_texel(int(number / uint(WORK_GROUP_SIZE))), 0);
    uvec2 splatted = uvec2(uint(work.x) + 1u, uint(work.y) + number % uint(WORK_GROUP_SIZE));
    if (drawn.x == 0u) {
        return splatted;
    }
    InstanceData instance = load_instance(int(drawn.x) - 1);
    TriangleData triangle = load_triangle(instance, int(drawn.y));
    vec3 normal = in_face(face, map_direction(map, scaled_geometric_normal(instance, triangle)));
    vec3 corner = in_face(face, map_direction(map, triangle.position_ws[0] - map.center_ws));
    float depth = dot(normal, corner) / dot(normal, vec3(map.corner + (vec2(cell) + 0.5) * map.texel, 1.0));
    return depth < uintBitsToFloat(texelFetch(nearest_depths, address, 0).x) ? drawn : splatted;
}
#endif

const float RANGE_ROUNDING = 4.0e-6;  // of a depth: planes are computed from corners in world space

void main() {
    ReflectionMap map = load_map(map_number);
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    int face;
    ivec2 cell;
    if (!find_cell(map, 0, face, cell)) {
        return;
    }
#ifdef OF_CLOUD
    uvec2 seen = nearer(map, face, cell, at, is_drawn != 0 ? texelFetch(visibility, at, 0).xy : uvec2(0u));
#else
    uvec2 seen = texelFetch(visibility, at, 0).xy;
#endif
    ivec2 address = linear_texel(map_index(map, 0, face, cell));
    if (seen.x == 0u) {
        imageStore(map_texels, address, vec4(NOTHING_NEARER, -1.0, -1.0, -1.0));
        return;
    }
    InstanceData instance = load_instance(int(seen.x) - 1);
    TriangleData triangle = load_triangle(instance, int(seen.y));
    vec3 normal = in_face(face, map_direction(map, scaled_geometric_normal(instance, triangle)));
    vec3 corners[3];
    float nearest = NOTHING_NEARER;
    float farthest = 0.0;
    for (int k = 0; k < 3; k++) {
        corners[k] = in_face(face, map_direction(map, triangle.position_ws[k] - map.center_ws));
        nearest = min(nearest, corners[k].z);
        farthest = max(farthest, corners[k].z);
    }
    float offset = dot(normal, corners[0]);
    vec2 range = vec2(nearest, farthest);
    vec2 within = vec2(NOTHING_NEARER, 0.0);
    for (int k = 0; k < 4; k++) {
        vec2 tangent = map.corner + (vec2(cell) + vec2(k & 1, k >> 1)) * map.texel;
        float along = dot(normal, vec3(tangent, 1.0));
        float depth = offset / along;
        // a plane seen edge-on has no depth in a part of the texel
        bool meets = along != 0.0 && depth > 0.0;
        within = meets ? vec2(min(within.x, depth), max(within.y, depth)) : vec2(within.x, NOTHING_NEARER);
    }
    if (within.x <= farthest && within.y >= nearest) {
        range = vec2(max(range.x, within.x), min(range.y, within.y));
    }
    range = max(range * vec2(1.0 - RANGE_ROUNDING, 1.0 + RANGE_ROUNDING), map.near_m);
    imageStore(map_texels, address, vec4(range, float(seen.x) - 1.0, float(seen.y)));
}
