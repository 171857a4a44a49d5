// The surfaces that reflected rays meet.
#include "lib/surface_point.glsl"
#include "lib/march.glsl"
#include "lib/tiles.glsl"

const float OWN_SHARE = 10.0;  // of what is rounding to other surfaces: the ray begins in its own

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 ray = texelFetch(ray_origins, pixel, 0);
    vec4 position = vec4(0.0, 0.0, 0.0, -1.0);
    vec4 normal = vec4(0.0);
    vec4 surface = vec4(0.0, 0.0, 0.0, float(NO_RAY));
    if (ray.w >= 0.0) {
        vec4 direction = texelFetch(ray_directions, pixel, 0);
        int beside = int(texelFetch(throughputs, pixel, 0).w);
#ifdef BY_DIRECTION
        bool shows_itself = false;
#else
        bool shows_itself = beside < -1;
#endif
        Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), REFLECTED_NOTHING);
        // in turns: what stands in a kernel twice is compiled twice
        for (int turn = 0; turn < 2; turn++) {
            bool is_own = turn == 1 && shows_itself;
            ReflectionMap map = load_map(turn == 0 ? int(ray.w) : is_own ? -2 - beside : beside);
            // of itself it shows what is found by marching alone
            Found one = follow(map, ray.xyz, direction.xyz, (is_own ? OWN_SHARE : 1.0) * direction.w, !is_own);
            bool is_before = found.how != REFLECTED_SURFACE || one.meeting.along < found.meeting.along;
            if (!is_own || (one.how == REFLECTED_SURFACE && one.meeting.inside && is_before)) {
                found = one;
            }
            if (!shows_itself && (found.how != REFLECTED_OUT_OF_VIEW || beside < 0)) {
                break;
            }
        }
        surface.w = float(found.how);
        if (!is_empty(found.texel)) {
            InstanceData instance = load_instance(int(found.texel.z));
            TriangleData triangle = load_triangle(instance, int(found.texel.w));
            vec3 weights = weights_within(found.meeting);
            position = vec4(weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2],
                            found.texel.z);
            vec3 scaled = scaled_geometric_normal(instance, triangle);
            float area_squared = dot(scaled, scaled);
            vec3 geometric = area_squared > 0.0 ? scaled * inversesqrt(area_squared) : -direction.xyz;
            vec3 shading = shading_normal(instance, triangle, int(found.texel.w), weights, geometric);
            float side = dot(geometric, direction.xyz) > 0.0 ? -1.0 : 1.0;
            normal = vec4(side * geometric, pack_direction(side * shading));
            surface.xyz = vec3(found.texel.w, weights.yz);
        }
    }
    imageStore(positions, pixel, position);
    imageStore(normals, pixel, normal);
    imageStore(surfaces, pixel, surface);
}
