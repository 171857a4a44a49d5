// What the surfaces that rays met shine by themselves, what of the light upon them comes back along the rays, and the world where rays
// met nothing.
#include "lib/brdf.glsl"
#include "lib/surface_point.glsl"
#include "lib/tiles.glsl"

const float PER_PI = 0.318309886;

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 hit = texelFetch(surfaces, pixel, 0);
    int how = int(hit.w);
    vec3 own = vec3(0.0);
    vec3 scattered = vec3(0.0);
    vec3 throughput = texelFetch(throughputs, pixel, 0).rgb;
    Gloss gloss = Gloss(vec3(0.0), 0.0, 1.0, false);
    bool is_reflector = false;
    if (how == REFLECTED_NOTHING || how == REFLECTED_OUT_OF_VIEW) {
        own = world_radiance(texelFetch(ray_directions, pixel, 0).xyz);
    } else if (how != NO_RAY) {
        vec4 position = texelFetch(positions, pixel, 0);
        vec4 normal = imageLoad(normals, pixel);
        InstanceData instance = load_instance(int(position.w));
        TriangleData triangle = load_triangle(instance, int(hit.x));
        vec3 weights = vec3(1.0 - hit.y - hit.z, hit.yz);
        vec3 shading = unpack_direction(normal.w);
#ifdef NORMAL_MAPS
        // where texels are shaded again, what is there is mapped already
        float side = shown_side(instance, triangle, normal.xyz);
        shading = side * shading_normal(instance, triangle, int(hit.x), weights, side * normal.xyz);
#endif
        Surface surface = surface_at(int(position.w), instance, triangle, int(hit.x), weights, normal.xyz, shading);
#ifdef NORMAL_MAPS
        // lights take the cosine to it, and what they hide from the geometric one
        imageStore(normals, pixel, vec4(normal.xyz, pack_direction(surface.normal_ws)));
#endif
        vec3 to_eye = -texelFetch(ray_directions, pixel, 0).xyz;
        float cosine = max(dot(surface.normal_ws, to_eye), LEAST_COSINE);
        Lobes lobes = lobes_of(surface, cosine);
        float under = 1.0 - largest(dielectric_albedo(surface, lobes.base));
        scattered = PER_PI * max(under, 0.0) * (1.0 - coat_albedo(surface, lobes)) * surface.diffuse;
        own = emitted(surface, lobes);
        gloss = gloss_of(surface, throughput, lobes);
        vec4 maps = texelFetch(instance_maps, linear_texel(int(position.w)), 0);
        is_reflector = max(maps.x, maps.y) >= 0.0;
    }
    float grazing;
    vec4 glossy;
    keep_gloss(gloss, is_reflector, grazing, glossy);
    imageStore(scatterings, pixel, vec4(throughput * scattered, grazing));
    imageStore(glosses, pixel, glossy);
    vec3 before = bounce == 0 ? vec3(0.0) : imageLoad(radiances, pixel).rgb;
    imageStore(radiances, pixel, vec4(before + throughput * own, 0.0));
}
