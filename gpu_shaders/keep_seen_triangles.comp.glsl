// Copies the small triangles that a well-distributed batch of views does not find far behind what it sees, all corners of them.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/hidden.glsl"
#include "lib/small_triangles.glsl"

bool corner_hidden_from(int k, vec3 corner) {
    float linear;
    vec2 at = place_corner(k, corner, linear);
    return hidden_from(k, at, depth_of(linear));
}

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(gathered_triangles, linear_texel(3 * index + i), 0);
    }
    bool hidden = true;
    int k = -1;
    do {
        k++;
        hidden = corner_hidden_from(k, corners[0].xyz) && corner_hidden_from(k, corners[1].xyz) && corner_hidden_from(k, corners[2].xyz);
    } while (hidden && k + 1 < view_count);
    if (hidden) {
        return;
    }
    // counted all the same: the host learns how much room is missing
    int place = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
    if (place >= triangle_capacity) {
        return;
    }
    imageAtomicAdd(block_counts, linear_texel(block_of(corners[0].xyz)), 1u);
    for (int i = 0; i < 3; i++) {
        imageStore(kept_triangles, linear_texel(3 * place + i), corners[i]);
    }
}
