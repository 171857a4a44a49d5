// One sequence of samples for all pixels, and where each pixel begins in it.
#include "lib/hash.glsl"

const float FIRST_SHARE = 1.0e-5;  // of how far a ray has come and of its distance from the world's origin: what is nearer is rounding

// A place in the unit square, moved by what is this pixel's and this dimension's own, around its edges.
vec2 shifted(ivec2 pixel, vec2 place, int dimension) {
    uint own = pcg_hash(uint(pixel.x) ^ pcg_hash(uint(pixel.y) ^ pcg_hash(uint(dimension))));
    return fract(place + vec2(unit_float(own), unit_float(pcg_hash(own))));
}
