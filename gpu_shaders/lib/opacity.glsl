// Opacity maps, as core/passes/opacity_maps.py lays them out, and the thresholds that decide what of them is drawn.
#include "lib/image_extension.glsl"
#include "lib/linear_texel.glsl"
#include "lib/hash.glsl"

float texel_value(ivec2 texel, ivec2 size, int extension, int first) {
    if (!find_texel(texel, size, extension)) {
        return 0.0;
    }
    int index = texel.y * size.x + texel.x;
    int two_bytes = int(texelFetch(opacity_maps, linear_texel(first + (index >> 3)), 0)[(index >> 1) & 3]);
    return float((two_bytes >> (8 * (index & 1))) & 255);
}

// base: of the map, as the vertex shader found it with what else of it the fragments of a triangle share
float opacity_at(int base, vec4 header, vec2 place) {
    ivec2 size = ivec2(header.xy);
    int extension = int(header.z);
    int first = base + 1 + OPACITY_TEXELS;
    vec2 at = place * header.xy;
    float value;
    if (header.w > 0.5) {
        vec2 low = floor(at - 0.5);
        vec2 share = at - 0.5 - low;
        ivec2 texel = ivec2(low);
        float bottom = mix(texel_value(texel, size, extension, first), texel_value(texel + ivec2(1, 0), size, extension, first), share.x);
        float top =
            mix(texel_value(texel + ivec2(0, 1), size, extension, first), texel_value(texel + ivec2(1, 1), size, extension, first), share.x);
        value = mix(bottom, top, share.y);
    } else {
        value = texel_value(ivec2(floor(at)), size, extension, first);
    }
    int step = int(value);
    vec4 steps = texelFetch(opacity_maps, linear_texel(base + 1 + (step >> 1)), 0);
    vec2 ends = (step & 1) == 0 ? steps.xy : steps.zw;
    return mix(ends.x, ends.y, value - float(step));
}

// The index-th threshold of a triangle, in [0, 1): of every aligned run of 2^k one lies in each 2^k-th. A van der Corput sequence whose
// indices are shuffled (Burley 2020, "Practical Hash-based Owen Scrambling"; permutation of Laine & Karras 2011): every run's
// order depends on the seed, so that of two layers of opacity 0.5 one hides half of what the other lets through.
float opacity_threshold(uint index, uint seed) {
    uint bits = bitfieldReverse(index) + seed;
    bits ^= bits * 0x6c50b47cu;
    bits ^= bits * 0xb82f1e52u;
    bits ^= bits * 0xc7afe638u;
    bits ^= bits * 0x8d22f6e6u;
    return unit_float(bits);
}
