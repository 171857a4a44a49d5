// Reflects what is looked at, or what the rays before met: the next rays, and what the light that they find is multiplied by.
// Rough surfaces reflect along one of their facets' normals, another one for every pixel and round.
#include "lib/surface_point.glsl"
#include "lib/brdf.glsl"
#include "lib/facets.glsl"
#include "lib/pixel_shift.glsl"
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
        float side = dot(scaled_geometric_normal(instance, triangle), normal.xyz) < 0.0 ? -1.0 : 1.0;
        vec3 shading = side * shading_normal(instance, triangle, triangle_index, weights, side * normal.xyz);
        Surface surface = surface_at(instance_index, instance, triangle, triangle_index, weights, normal.xyz, shading);
#ifdef FILTERED
        // the surface goes on in the triangle's plane, its normal by the triangle's gradient; not so beyond where the plane ends
        vec2 at = vec2(pixel) + 0.5 + vec2(place_x, place_y);
        vec3 to_plane = eye[0].xyz + at.x * eye[1].xyz + at.y * eye[2].xyz;
        bool orthographic = eye[3].w > 0.5;
        vec3 from = orthographic ? eye[3].xyz + to_plane : eye[3].xyz;
        vec3 toward = orthographic ? incoming : normalize(to_plane);
        vec3 moved = plane_weights(triangle, from, toward);
        vec3 place = moved.x * triangle.position_ws[0] + moved.y * triangle.position_ws[1] + moved.z * triangle.position_ws[2];
        float farther = dot(place - from, toward);
        if (dot(toward, normal.xyz) < 0.0 && (orthographic || (farther > 0.5 * traveled && farther < 2.0 * traveled))) {
            vec3 turned = surface.normal_ws + side * shading_normal(instance, triangle, triangle_index, moved, side * normal.xyz) - shading;
            surface.normal_ws = dot(turned, turned) > 0.0 ? normalize(turned) : surface.normal_ws;
            position.xyz = place;
            incoming = toward;
        }
#endif
        vec3 n = seen_normal(surface.normal_ws, -incoming);
        surface.normal_ws = n;
        float cosine = max(-dot(n, incoming), LEAST_COSINE);
        Lobes lobes = lobes_of(surface, cosine);
        float roughness = reflection_roughness(surface, lobes);
        float width = roughness * roughness;
        vec3 facet = n;
        float masked = 1.0;
        if (width > MIRROR_WIDTH) {
            facet = facet_of(n, -incoming, width, shifted(pixel, vec2(sample_x, sample_y), bounce), masked);
        }
        vec3 outgoing = reflect(incoming, facet);
        float above = dot(outgoing, normal.xyz);
        if (above <= 0.0) {
            // a leaning shading normal would send it into the surface
            outgoing = normalize(outgoing - (above - 1.0e-3) * normal.xyz);
        }
        albedo = vec4(reflection_color(surface, lobes), 1.0);
        // a coat has other facets than what it lies upon: those of the one that reflects more stand for both
        vec3 reflected = albedo.rgb;
        if (surface.coat_weight > 0.0) {
            // the mean of masking over facets is in it already
            masked /= width > MIRROR_WIDTH ? (roughness == surface.coat_roughness ? lobes.coat : lobes.base).albedo : 1.0;
        } else {
            reflected = lobe_fresnel(surface, lobes.base, clamp(-dot(facet, incoming), 0.0, 1.0));
        }
        color = vec4(share * before * masked * reflected, others);
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
