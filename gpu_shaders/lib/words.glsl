// What the texels of cubes hold where points bring their own colours: 13 bits of depth above 19 of colour in one word (Gavane & Watson
// 2022, section 5.1), or a word of each.

const uint EMPTY_WORD = 0xffffffffu;
const float DEPTH_STEPS = 8191.0;  // of 13 bits, but for the last: an empty word is none of them
const vec3 COLOR_STEPS = vec3(63.0, 127.0, 63.0);  // of 6, 7 and 6 bits
const int EXPONENT_BIAS = 24;  // of 9 bits' fractions

// Steps of depth are all the same share of it, those of colours are their square root's, and what is brighter than 1 is 1. octaves: of depth
// from the nearest on
uint packed_word(float octaves, float per_octave, vec3 color) {
    uint steps = uint(clamp(octaves * per_octave, 0.0, DEPTH_STEPS - 1.0));
    uvec3 c = uvec3(sqrt(clamp(color, 0.0, 1.0)) * COLOR_STEPS + 0.5);
    return steps << 19u | c.r << 13u | c.g << 6u | c.b;
}

vec3 color_of_packed(uint word) {
    vec3 root = vec3(uvec3(word >> 13u & 63u, word >> 6u & 127u, word & 63u)) / COLOR_STEPS;
    return root * root;
}

// 9 bits a channel and an exponent for all of 5, which is never all ones.
uint color_word(vec3 color) {
    vec3 c = max(color, 0.0);
    float peak = max(max(c.r, max(c.g, c.b)), 1.0e-9);
    int exponent = clamp(int(floor(log2(peak))) + 16, 0, 30);
    uvec3 fractions = min(uvec3(c * exp2(float(EXPONENT_BIAS - exponent)) + 0.5), uvec3(511u));
    return uint(exponent) << 27u | fractions.r << 18u | fractions.g << 9u | fractions.b;
}

vec3 color_of_word(uint word) {
    return vec3(uvec3(word >> 18u & 511u, word >> 9u & 511u, word & 511u)) * exp2(float(int(word >> 27u) - EXPONENT_BIAS));
}
