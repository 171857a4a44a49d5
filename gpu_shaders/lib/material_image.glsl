// Images of materials and the world, as core/passes/material_images.py packs them.
#include "lib/image_extension.glsl"
#include "lib/linear_texel.glsl"
#include "lib/integer_halves.glsl"

vec3 decoded_srgb(vec3 encoded) {
    vec3 high = pow(max((encoded + 0.055) / 1.055, 0.0), vec3(2.4));
    return mix(high, encoded / 12.92, vec3(lessThanEqual(encoded, vec3(0.04045))));
}

// Values of a texel, alpha last, as they are interpolated. One fetch serves all packings.
vec4 stored_texel(int first, int index, int packing) {
    int shift = packing == PACKED_FLOATS ? 0 : packing == PACKED_COLORS ? 2 : packing == PACKED_GRAYS ? 3 : 1;
    vec4 stored = texelFetch(surface_images, linear_texel(first + (index >> shift)), 0);
    if (packing == PACKED_FLOATS) {
        return stored;
    }
    int within = index & ((1 << shift) - 1);
    vec2 pair = (packing == PACKED_GRAYS ? within < 4 : shift == 2 ? within < 2 : within == 0) ? stored.xy : stored.zw;
    bool is_second = packing == PACKED_GRAYS ? (within & 2) != 0 : (within & 1) != 0;
    int bits = int(is_second && shift != 1 ? pair.y : pair.x);
    if (packing == PACKED_GRAYS) {
        float gray = float((bits >> (8 * (within & 1))) & 255) / 255.0;
        return vec4(gray, gray, gray, 1.0);
    }
    ivec2 blue_alpha = packing == PACKED_COLORS ? ivec2(bits >> 16, 255) : ivec2(int(pair.y) & 255, int(pair.y) >> 8);
    return vec4(bits & 255, (bits >> 8) & 255, blue_alpha) / 255.0;
}

vec4 image_texel(int first, ivec2 texel, ivec2 size, int packing, int extension) {
    if (!find_texel(texel, size, extension)) {
        return vec4(0.0);
    }
    return stored_texel(first, texel.y * size.x + texel.x, packing);
}

// flags: IMAGE_INTERPOLATED, IMAGE_ALPHA, IMAGE_DIVIDED of core/passes/material_images.py
vec3 image_color(int base, vec2 place, int extension, int flags) {
    vec4 header = texelFetch(surface_images, linear_texel(base), 0);
    ivec2 size = ivec2(header.xy);
    int packing = int(header.z);
    bool is_interpolated = (flags & IMAGE_INTERPOLATED) != 0;
    vec2 at = place * header.xy - (is_interpolated ? 0.5 : 0.0);
    vec2 low = floor(at);
    vec2 share = is_interpolated ? at - low : vec2(0.0);
    vec4 value = vec4(0.0);
    // in turns: what stands in a kernel four times is compiled four times
    for (int k = 0; k < (is_interpolated ? 4 : 1); k++) {
        ivec2 corner = ivec2(k & 1, k >> 1);
        vec2 weights = mix(1.0 - share, share, vec2(corner));
        value += weights.x * weights.y * image_texel(base + 1, ivec2(low) + corner, size, packing, extension);
    }
    if ((flags & IMAGE_ALPHA) != 0) {
        return value.aaa;
    }
    vec3 color = (flags & IMAGE_DIVIDED) != 0 && value.a > 0.0 ? value.rgb / value.a : value.rgb;
    return header.w > 0.5 ? decoded_srgb(color) : color;
}
