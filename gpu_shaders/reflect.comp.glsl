// Reflects what is looked at, or what the rays before met: the next rays, and what the light that they find is multiplied by.
// Rough surfaces reflect along one of their facets' normals, another one for every pixel and round.
#include "lib/surface_point.glsl"
#include "lib/reflected_ray.glsl"
#include "lib/tiles.glsl"

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    vec4 surface_texel = texelFetch(surfaces, pixel, 0);
    vec4 origin = vec4(0.0, 0.0, 0.0, -1.0);
    vec4 color = vec4(0.0);
    vec4 albedo = vec4(0.0);
    vec4 ray = vec4(0.0);
    int instance_index = int(position.w);
    int map_number = -1;
    float others = 0.0;
    if (instance_index >= 0) {
        vec4 maps = texelFetch(instance_maps, linear_texel(instance_index), 0);
#ifdef FROM_EYE
        map_number = int(maps.x);
        others = maps.z + 1.0;
#ifdef ADAPTIVE
        map_number = texelFetch(settled, pixel, 0).x > 0.0 ? -1 : map_number;
#endif
#else
        map_number = int(maps.y);
#endif
        others += float(MAP_NUMBERS) * (maps.w + 1.0);
    }
    if (map_number >= 0) {
        vec4 normal = texelFetch(normals, pixel, 0);
#ifdef FROM_EYE
        vec3 incoming = eye[3].w > 0.5 ? normalize(eye[4].xyz) : normalize(position.xyz - eye[3].xyz);
        vec3 before = vec3(1.0);
        float traveled = eye[3].w > 0.5 ? 0.0 : length(position.xyz - eye[3].xyz);
#else
        vec3 incoming = imageLoad(ray_directions, pixel).xyz;
        vec3 before = imageLoad(throughputs, pixel).rgb;
        float traveled = length(position.xyz - imageLoad(ray_origins, pixel).xyz);
#endif
        InstanceData instance = load_instance(instance_index);
        int triangle_index = int(surface_texel.x);
        TriangleData triangle = load_triangle(instance, triangle_index);
        vec3 weights = vec3(1.0 - surface_texel.y - surface_texel.z, surface_texel.yz);
        // that of the G-buffer is rounded to a thousandth, which a mirror would show
        float side = shown_side(instance, triangle, normal.xyz);
        vec3 shading = side * shading_normal(instance, triangle, triangle_index, weights, side * normal.xyz);
        Surface surface = surface_at(instance_index, instance, triangle, triangle_index, weights, normal.xyz, shading);
#ifdef FILTERED
        move_in_pixel(vec2(pixel) + 0.5 + vec2(place_x, place_y), instance, triangle, triangle_index, side, normal.xyz, shading, traveled,
                      surface, position.xyz, incoming);
#endif
        Reflected found = reflected_ray(surface, normal.xyz, incoming, pixel, vec2(sample_x, sample_y), bounce);
        vec3 outgoing = found.direction;
        albedo = vec4(found.albedo, 1.0);
        color = vec4(share * before * found.share, others);
        origin = vec4(position.xyz, float(map_number));
        ray = vec4(outgoing, FIRST_SHARE * max(traveled, length(position.xyz)));
    }
    imageStore(ray_origins, pixel, origin);
    imageStore(ray_directions, pixel, ray);
    imageStore(throughputs, pixel, color);
#ifdef FROM_EYE
    imageStore(colors, pixel, albedo);
#endif
}
