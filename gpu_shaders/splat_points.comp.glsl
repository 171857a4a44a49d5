// Replays the point buffer into the depth maps of a batch of views.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/octahedral.glsl"
#include "lib/splat.glsl"

#ifdef LOCAL_CULLING
void main() {
    int first = POINTS_AT_ONCE * linear_invocation();
    if (first >= point_count) {
        return;
    }
    vec3 p_fs[POINTS_AT_ONCE];
    vec3 normal_fs[POINTS_AT_ONCE];
    for (int i = 0; i < POINTS_AT_ONCE; i++) {
        // the last one several times, if there are no more
        vec4 point = texelFetch(points, linear_texel(min(first + i, point_count - 1)), 0);
        p_fs[i] = point.xyz;
        normal_fs[i] = unpack_direction(point.w);
    }
    int k = -1;
    do {
        k++;
        ivec2 addresses[POINTS_AT_ONCE];
        uint bits[POINTS_AT_ONCE];
        for (int i = 0; i < POINTS_AT_ONCE; i++) {
            bits[i] = place_point(k, p_fs[i], normal_fs[i], addresses[i]);
        }
        for (int i = 0; i < POINTS_AT_ONCE; i++) {
            bool written = bits[i] != NOWHERE;
            for (int j = 0; j < POINTS_AT_ONCE; j++) {
                written = written && !(addresses[j] == addresses[i] && (bits[j] < bits[i] || (bits[j] == bits[i] && j < i)));
            }
            if (written) {
                write_bits(addresses[i], bits[i]);
            }
        }
    } while (k + 1 < view_count);
}
#else
void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 point = texelFetch(points, linear_texel(index), 0);
    splat(point.xyz, unpack_direction(point.w));
}
#endif
