// Splats points with their own colours into the cubes of a batch, a texel in each view whose bit they have. With PACKED depth and colour go
// in one word; without, depths come first and then, with IS_COLORING, the colours at these depths.
#include "lib/linear_invocation.glsl"
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/point_texel.glsl"
#include "lib/words.glsl"

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 place = texelFetch(points, linear_texel(2 * index), 0);
    ivec4 bits = ivec4(texelFetch(point_views, linear_texel(index * view_texels + view_texel), 0));
    vec3 normal = unpack_direction(place.w);
    vec3 color = texelFetch(shown, linear_texel(index), 0).rgb;
    for (int channel = 0; channel < 4; channel++) {
        for (int rest = bits[channel]; rest != 0; rest &= rest - 1) {
            int k = (channel * FACES_PER_CHANNEL + findLSB(rest)) / 6;
            int face;
            ivec2 texel;
            float depth;
            find_point_texel(k, place.xyz, normal, face, texel, depth);
            int base = first_texel(k) * SMALLEST_CUBE_TEXELS;
            ivec2 address = linear_texel(base + (face * cube_side(k) + texel.y) * cube_side(k) + texel.x);
#ifdef PACKED
            imageAtomicMin(words, address, packed_word(log2(depth / nearest_m), steps_per_octave, color));
#else
            uint depth_bits = floatBitsToUint(depth);
            if (is_coloring == 0) {
                imageAtomicMin(depths, address, depth_bits);
            } else if (imageLoad(depths, address).x == depth_bits) {
                imageAtomicMin(words, address, color_word(color));
            }
#endif
        }
    }
}
