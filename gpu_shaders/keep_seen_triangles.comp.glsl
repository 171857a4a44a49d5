// Copies the small triangles that a well-distributed batch of views does not find far behind what it sees, all corners of them.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/hidden.glsl"
#include "lib/small_triangles.glsl"

// What faces away from the whole light and stands behind another surface is the far side of something: it comes into sight at holes only.
const float KEPT_DEPTH_FACING_AWAY_FOOTPRINTS = 4.0;

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(gathered_triangles, linear_texel(3 * index + i), 0);
    }
    float kept_depth_footprints = corners[0].w > 0.5 ? KEPT_DEPTH_FOOTPRINTS : KEPT_DEPTH_FACING_AWAY_FOOTPRINTS;
    bool hidden = true;
    int k = -1;
    do {
        k++;
        for (int i = 0; i < 3; i++) {
            float linear;
            vec2 at = place_corner(k, corners[i].xyz, linear);
            hidden = hidden && hidden_from(k, at, depth_of(linear), kept_depth_footprints);
        }
    } while (hidden && k + 1 < view_count);
    if (hidden) {
        return;
    }
    // counted all the same: the host learns how much room is missing
    int place = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
    if (place >= triangle_capacity) {
        return;
    }
    // handed on: another kernel may round it differently, and would then put more into a block than was counted
    int block = block_of(corners[0].xyz);
    corners[1].w = float(block);
    imageAtomicAdd(block_counts, linear_texel(block), 1u);
    for (int i = 0; i < 3; i++) {
        imageStore(kept_triangles, linear_texel(3 * place + i), corners[i]);
    }
}
