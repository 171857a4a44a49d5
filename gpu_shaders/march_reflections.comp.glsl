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
        ReflectionMap map = load_map(int(ray.w));
        vec4 direction = texelFetch(ray_directions, pixel, 0);
        Found found = follow(map, ray.xyz, direction.xyz, direction.w);
        int beside = int(texelFetch(throughputs, pixel, 0).w);
        if (found.how == REFLECTED_OUT_OF_VIEW && beside >= 0) {
            found = follow(load_map(beside), ray.xyz, direction.xyz, direction.w);
        }
#ifndef BY_DIRECTION
        // found by marching alone, so nothing of it is by direction
        if (beside < -1) {
            Found own = march(load_map(-2 - beside), ray.xyz, direction.xyz, OWN_SHARE * direction.w);
            bool is_before = found.how != REFLECTED_SURFACE || own.meeting.along < found.meeting.along;
            if (own.how == REFLECTED_SURFACE && own.meeting.inside && is_before) {
                found = own;
            }
        }
#endif
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
