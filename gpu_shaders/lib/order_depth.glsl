// What is nearest wherever triangles are drawn in another order: what the depth test compares, in all 30 bits of floats from 0 to 1.
// The distance to one part in 2^20, and below it what decides where two are that near: front faces, as at folds in an outline, then a number
// of each triangle's own. A projection's depth would be 24 bits of which most are spent on what is just before the eye.
#define FINEST_BITS 3u  // of a distance's 23, left out
#define NEAREST_M 9.3132257e-10  // 2^-30
#define LEAST 0x00800000u  // smaller floats are denormal: devices take them for 0
#define FARTHEST 0x3f7fffffu  // less than what depth is cleared to

// tie_breaker: 3 bits count
float order_depth(bool is_orthographic, int tie_breaker) {
    uint steps = is_orthographic
        ? uint(gl_FragCoord.z * 33554432.0)  // all that there are
        : (floatBitsToUint(max(1.0 / gl_FragCoord.w, NEAREST_M)) - floatBitsToUint(NEAREST_M)) >> FINEST_BITS;
    uint side = gl_FrontFacing ? 0u : 8u;
    return uintBitsToFloat(min(LEAST + (steps << 4u | side | (uint(tie_breaker) & 7u)), FARTHEST));
}
