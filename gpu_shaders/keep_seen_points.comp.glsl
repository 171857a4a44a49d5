// Copies the points that a well-distributed batch of views does not find far behind what it sees.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/hidden.glsl"

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 point = texelFetch(points, linear_texel(index), 0);
    bool hidden = true;
    // most are seen by the first views; loops that test at their beginning cost software rasterizers a turn
    int k = -1;
    do {
        k++;
        vec3 p = point.xyz - view_center(k);
        hidden = hidden_from(k, map_position(k, vec3(p.xy, max(p.z, near_m))), p.z, KEPT_DEPTH_FOOTPRINTS);
    } while (hidden && k + 1 < view_count);
    if (!hidden) {
        uint next = imageAtomicAdd(counters, ivec2(0, 0), 1u);
        imageStore(kept_points, linear_texel(int(next)), point);
    }
}
