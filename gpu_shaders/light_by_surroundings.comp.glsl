// What the world and surfaces that shine bring to those that rays met, from one direction for every pixel and round.
#include "lib/brdf.glsl"
#include "lib/march.glsl"
#include "lib/pixel_shift.glsl"
#include "lib/tiles.glsl"

const float PI = 3.14159265;

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 diffuse = texelFetch(scatterings, pixel, 0);
    vec4 glossy = texelFetch(glosses, pixel, 0);
    vec4 position = texelFetch(positions, pixel, 0);
    vec4 normal = texelFetch(normals, pixel, 0);
    vec3 n = unpack_direction(normal.w);
    vec3 scattered = diffuse.rgb;
    if (glossy.w > 0.0) {
        // no ray follows: so rough a surface shows no shapes
        float cos_eye = clamp(-dot(n, texelFetch(ray_directions, pixel, 0).xyz), 0.0, 1.0);
        scattered += gloss_fresnel(kept_gloss(diffuse.w, glossy), cos_eye) / PI;
    }
    if (position.w < 0.0 || dot(scattered, vec3(1.0)) <= 0.0) {
        return;
    }
    // directions distributed as their cosine: points of a sphere around the normal's end
    vec2 place = shifted(pixel, vec2(sample_x, sample_y), bounce);
    float height = 1.0 - 2.0 * place.x;
    float angle = 2.0 * PI * place.y;
    vec3 on_sphere = vec3(sqrt(max(1.0 - height * height, 0.0)) * vec2(cos(angle), sin(angle)), height);
    vec3 along = n + on_sphere;
    float squared = dot(along, along);
    vec3 direction = squared > 1.0e-8 ? along * inversesqrt(squared) : n;
    if (dot(direction, normal.xyz) <= 0.0) {
        return;
    }
    vec4 ray = texelFetch(ray_origins, pixel, 0);
    float first_m = FIRST_SHARE * max(length(position.xyz - ray.xyz), length(position.xyz));
    int beside = int(texelFetch(throughputs, pixel, 0).w);
    Found found = follow(load_map(beside >= 0 ? beside : int(ray.w)), position.xyz, direction, first_m, true);
    vec3 radiance = vec3(0.0);
    if (found.how == REFLECTED_NOTHING) {
        radiance = world_radiance(direction);
    } else if (!is_empty(found.texel)) {
        InstanceData instance = load_instance(int(found.texel.z));
        TriangleData triangle = load_triangle(instance, int(found.texel.w));
        vec3 weights = weights_within(found.meeting);
        vec3 scaled = scaled_geometric_normal(instance, triangle);
        vec3 geometric = dot(scaled, scaled) > 0.0 ? normalize(scaled) : -direction;
        geometric *= dot(geometric, direction) > 0.0 ? -1.0 : 1.0;
        Surface surface = surface_at(int(found.texel.z), instance, triangle, int(found.texel.w), weights, geometric, geometric);
        radiance = emitted(surface, lobes_of(surface, max(-dot(surface.normal_ws, direction), LEAST_COSINE)));
    }
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(PI * scattered * radiance, 0.0));
}
