// The surfaces that reflected rays meet.
#include "lib/surface_point.glsl"
#include "lib/march.glsl"
#include "lib/tiles.glsl"

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
        Found found = follow_through(numbers, ray.xyz, direction.xyz, direction.w);
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
