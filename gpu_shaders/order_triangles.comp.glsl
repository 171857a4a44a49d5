// Puts the small triangles that fall into the same texels together: their depths are then in the caches when the next one asks for them.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/integer_halves.glsl"

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(kept_triangles, linear_texel(3 * index + i), 0);
    }
    ivec2 block = linear_texel(int(corners[1].w));
    int place = integer_of(texelFetch(block_starts, block, 0).xy) + int(imageAtomicAdd(block_counts, block, 1u));
    for (int i = 0; i < 3; i++) {
        imageStore(ordered_triangles, linear_texel(3 * place + i), corners[i]);
    }
}
