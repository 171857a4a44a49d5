// What a pass has found of a pixel so far: always lit, never lit, always background, or something between.
const uint STATE_MIXED = 1u;
const uint STATE_LIT = 2u;
const uint STATE_DARK = 4u;
const uint STATE_BACKGROUND = 8u;

// The two sums of a lit pixel have the same terms, but not always in the same order.
bool wholly_lit(vec2 sums) {
    return sums.x >= sums.y * (1.0 - 1.0e-6);
}
