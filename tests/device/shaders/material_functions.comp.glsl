// Six texels a query; test_materials.py reads them.
#include "lib/linear_invocation.glsl"
#include "lib/brdf.glsl"

void main() {
    int index = linear_invocation();
    if (index >= query_count) {
        return;
    }
    vec4 place = texelFetch(queries, linear_texel(4 * index), 0);
    vec4 to_eye = texelFetch(queries, linear_texel(4 * index + 1), 0);
    vec4 to_light = texelFetch(queries, linear_texel(4 * index + 2), 0);
    vec3 geometric = texelFetch(queries, linear_texel(4 * index + 3), 0).xyz;
    InstanceData instance = load_instance(int(place.x));
    TriangleData triangle = load_triangle(instance, int(place.y));
    vec3 weights = vec3(1.0 - place.z - place.w, place.zw);
    Surface s = surface_at(int(place.x), instance, triangle, int(place.y), weights, geometric, geometric);
    float cosine = max(dot(s.normal_ws, to_eye.xyz), LEAST_COSINE);
    Lobes lobes = lobes_of(s, cosine);
    int base = 6 * index;
    imageStore(answers, linear_texel(base), vec4(s.diffuse, s.roughness));
    imageStore(answers, linear_texel(base + 1), vec4(s.metal, s.metal_weight));
    imageStore(answers, linear_texel(base + 2), vec4(s.normal_ws, reflection_roughness(s, lobes)));
    imageStore(answers, linear_texel(base + 3), vec4(emitted(s, lobes), s.dielectric_weight));
    imageStore(answers, linear_texel(base + 4), vec4(brdf(s, to_eye.xyz, to_light.xyz, to_light.w), s.ior));
    imageStore(answers, linear_texel(base + 5), vec4(reflection_color(s, lobes), world_radiance(to_light.xyz).x));
}
