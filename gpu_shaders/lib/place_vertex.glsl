#include "lib/linear_texel.glsl"

vec3 place_vertex(int instance, vec3 p_os) {
    vec4 p = vec4(p_os, 1.0);
    int base = instance * INSTANCE_TEXELS;
    return vec3(
        dot(texelFetch(instances, linear_texel(base), 0), p),
        dot(texelFetch(instances, linear_texel(base + 1), 0), p),
        dot(texelFetch(instances, linear_texel(base + 2), 0), p));
}
