// Five texels a triangle; test_shader_functions.py reads them.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/triangle_sampling.glsl"

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec3 corners[3];
    for (int k = 0; k < 3; k++) {
        corners[k] = texelFetch(triangle_corners, linear_texel(3 * index + k), 0).xyz;
    }
    vec3 point = texelFetch(queries, linear_texel(2 * index), 0).xyz;
    vec4 rectangle = texelFetch(queries, linear_texel(2 * index + 1), 0);
    AlignedTriangle t = align_triangle(corners[0], corners[1], corners[2]);
    int base = 5 * index;
    float overlaps = rectangle_overlaps(t, rectangle.xy, rectangle.zw) ? 1.0 : 0.0;
    imageStore(answers, linear_texel(base), vec4(closest_point(point, corners[0], corners[1], corners[2]), overlaps));
    imageStore(answers, linear_texel(base + 1), vec4(nearest_in_triangle(t, rectangle.xy), t.corner_uv[0]));
    imageStore(answers, linear_texel(base + 2), vec4(t.corner_uv[1], t.corner_uv[2]));
    imageStore(answers, linear_texel(base + 3), vec4(t.n, t.area));
    imageStore(answers, linear_texel(base + 4), vec4(point_at(t, t.corner_uv[2]), 0.0));
}
