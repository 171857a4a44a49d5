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
        int others = int(texelFetch(throughputs, pixel, 0).w);
        ivec3 numbers = ivec3(int(ray.w), others % MAP_NUMBERS - 1, others / MAP_NUMBERS - 1);
#ifdef BY_DIRECTION
        numbers.z = -1;
#endif
        Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), REFLECTED_NOTHING);
        // in turns: what stands in a kernel twice is compiled twice
        for (int turn = 0; turn < 3; turn++) {
            bool is_own = turn == 2;
            bool has_left = found.how == REFLECTED_OUT_OF_VIEW;
            bool is_asked = turn != 1 || has_left || found.how == REFLECTED_BY_DIRECTION;
            if (numbers[turn] < 0 || !is_asked) {
                continue;
            }
            // of itself it shows what is found by marching alone
            Found one = follow(load_map(numbers[turn]), ray.xyz, direction.xyz, (is_own ? OWN_SHARE : 1.0) * direction.w, !is_own);
            bool is_before = found.how != REFLECTED_SURFACE || one.meeting.along < found.meeting.along;
            bool is_sure = one.how == REFLECTED_SURFACE && (!is_own || one.meeting.inside);
            if (turn == 0 || (turn == 1 && has_left) || (is_sure && is_before)) {
                found = one;
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
