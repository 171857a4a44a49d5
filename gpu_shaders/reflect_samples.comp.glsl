// All samples of a pixel at once, from one eye sample, and those texels of its reflector's cube that lie in their directions: with MARKING
// they are marked that see a surface, otherwise what they show is filtered.
#include "lib/surface_point.glsl"
#include "lib/reflected_ray.glsl"
#include "lib/reflection_map.glsl"
#include "lib/tiles.glsl"

// What is shaded for a sample: the middle of a block of texels, as wide as holds so many places for an eye's pixel, or of a narrower one
// where the middle sees another object than the sample does. xy: its texel; z: 1 where the sample meets a surface. pixel_angle: what the
// pixel shows, steradians
ivec3 place_towards(ReflectionMap map, vec3 direction, float pixel_angle) {
    vec3 f = map_direction(map, direction);
    int face = face_of(map, f);
    f = in_face(face, f);
    ivec2 cell = clamp(ivec2((f.xy / f.z - map.corner) / map.texel), ivec2(0), map.size - 1);
    ivec2 own = linear_texel(map_index(map, 0, face, cell));
    float instance = texelFetch(map_texels, own, 0).z;
    float texels = pixel_angle / (map.texel.x * map.texel.y * f.z * f.z * f.z);
    int level = clamp(int(round(0.5 * log2(max(texels / places_per_pixel, 1.0)))), 0, MAP_LEVELS - 1);
    for (; level > 0; level--) {
        ivec2 middle = linear_texel(map_index(map, 0, face, ((cell >> level) << level) + (1 << (level - 1))));
        if (texelFetch(map_texels, middle, 0).z == instance) {
            return ivec3(middle, instance >= 0.0 ? 1 : 0);
        }
    }
    return ivec3(own, instance >= 0.0 ? 1 : 0);
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    vec4 surface_texel = texelFetch(surfaces, pixel, 0);
    vec3 radiance = vec3(0.0);
    vec4 albedo = vec4(0.0);
    int instance_index = int(position.w);
    int map_number = instance_index >= 0 ? int(texelFetch(instance_maps, linear_texel(instance_index), 0).x) : -1;
    if (map_number >= 0) {
        vec4 normal = texelFetch(normals, pixel, 0);
        vec3 seen_along = eye[3].w > 0.5 ? normalize(eye[4].xyz) : normalize(position.xyz - eye[3].xyz);
        float traveled = eye[3].w > 0.5 ? 0.0 : length(position.xyz - eye[3].xyz);
        InstanceData instance = load_instance(instance_index);
        int triangle_index = int(surface_texel.x);
        TriangleData triangle = load_triangle(instance, triangle_index);
        vec3 weights = vec3(1.0 - surface_texel.y - surface_texel.z, surface_texel.yz);
        float side = shown_side(instance, triangle, normal.xyz);
        vec3 shading = side * shading_normal(instance, triangle, triangle_index, weights, side * normal.xyz);
        Surface surface = surface_at(instance_index, instance, triangle, triangle_index, weights, normal.xyz, shading);
        ReflectionMap map = load_map(map_number);
        vec3 towards[3];
        for (int k = 0; k < 3; k++) {
            Surface there = surface;
            vec3 place = position.xyz;
            vec3 incoming = seen_along;
            move_in_pixel(vec2(pixel) + 0.5 + vec2(k & 1, k >> 1), instance, triangle, triangle_index, side, normal.xyz, shading, traveled,
                          there, place, incoming);
            towards[k] = reflect(incoming, seen_normal(there.normal_ws, -incoming));
        }
        float pixel_angle = length(cross(towards[1] - towards[0], towards[2] - towards[0]));
        for (int k = 0; k < sample_count; k++) {
            Surface there = surface;
            vec3 place = position.xyz;
            vec3 incoming = seen_along;
            move_in_pixel(vec2(pixel) + 0.5 + samples[k].xy, instance, triangle, triangle_index, side, normal.xyz, shading, traveled, there,
                          place, incoming);
            Reflected found = reflected_ray(there, normal.xyz, incoming, pixel, samples[k].zw, 0);
            ivec3 shaded = place_towards(map, found.direction, pixel_angle);
#ifdef MARKING
            if (shaded.z > 0) {
                imageStore(needed, shaded.xy, uvec4(1u));
            }
            albedo.rgb += found.albedo;
#else
            int kept = int(texelFetch(needed, shaded.xy, 0).x) - 1;
            radiance += found.share * (shaded.z > 0 ? texelFetch(shown, linear_texel(kept), 0).rgb : world_radiance(found.direction));
#endif
        }
        radiance /= float(sample_count);
        albedo = vec4(albedo.rgb / float(sample_count), 1.0);
    }
#ifdef MARKING
    imageStore(colors, pixel, albedo);
#else
    imageStore(radiances, pixel, vec4(radiance, 0.0));
#endif
}
