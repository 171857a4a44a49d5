// Writes what a place of a cube sees: first the smallest depth, and when all are known the smallest number at that depth.
#include "lib/linear_texel.glsl"
#include "lib/cubes.glsl"

// Whether the number may be the texel's, which only those need to come back for.
bool write_texel(int k, int face, ivec2 texel, float depth, uint number) {
    ivec2 address = linear_texel(first_texel(k) + (face * cube_side(k) + texel.y) * cube_side(k) + texel.x);
    uint bits = floatBitsToUint(depth);
    uint known = imageLoad(nearest_depths, address).x;
    if (is_numbering != 0) {
        if (known == bits) {
            imageAtomicMin(nearest_numbers, address, number);
        }
    } else if (known > bits) {
        // much is hidden: looking first is cheaper than an atomic
        imageAtomicMin(nearest_depths, address, bits);
    }
    return known >= bits;
}
