// Images of materials and the world, as core/passes/material_images.py packs them.
#include "lib/linear_texel.glsl"
#include "lib/integer_halves.glsl"

vec3 decoded_srgb(vec3 encoded) {
    vec3 high = pow(max((encoded + 0.055) / 1.055, 0.0), vec3(2.4));
    return mix(high, encoded / 12.92, vec3(lessThanEqual(encoded, vec3(0.04045))));
}

// Values of a texel, alpha last, as they are interpolated.
vec4 stored_texel(int first, int index, int packing) {
    if (packing == PACKED_FLOATS) {
        return texelFetch(surface_images, linear_texel(first + index), 0);
    }
    if (packing == PACKED_COLORS) {
        int bits = int(texelFetch(surface_images, linear_texel(first + (index >> 2)), 0)[index & 3]);
        return vec4(bits & 255, (bits >> 8) & 255, bits >> 16, 255.0) / 255.0;
    }
    if (packing == PACKED_GRAYS) {
        int bits = int(texelFetch(surface_images, linear_texel(first + (index >> 3)), 0)[(index >> 1) & 3]);
        float gray = float((bits >> (8 * (index & 1))) & 255) / 255.0;
        return vec4(gray, gray, gray, 1.0);
    }
    vec4 two = texelFetch(surface_images, linear_texel(first + (index >> 1)), 0);
    ivec2 bits = ivec2((index & 1) == 0 ? two.xy : two.zw);
    return vec4(bits.x & 255, bits.x >> 8, bits.y & 255, bits.y >> 8) / 255.0;
}

vec4 image_texel(int first, ivec2 texel, ivec2 size, int packing, int extension) {
    if (extension == EXTENSION_CLIP && (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size)))) {
        return vec4(0.0);
    }
    if (extension == EXTENSION_REPEAT) {
        texel -= size * ivec2(floor(vec2(texel) / vec2(size)));
    } else if (extension == EXTENSION_MIRROR) {
        texel -= 2 * size * ivec2(floor(vec2(texel) / vec2(2 * size)));
        texel = min(texel, 2 * size - 1 - texel);
    }
    // repeated texels too: division may have rounded
    texel = clamp(texel, ivec2(0), size - 1);
    return stored_texel(first, texel.y * size.x + texel.x, packing);
}

// flags: IMAGE_INTERPOLATED, IMAGE_ALPHA, IMAGE_DIVIDED of core/passes/material_images.py
vec3 image_color(int base, vec2 place, int extension, int flags) {
    vec4 header = texelFetch(surface_images, linear_texel(base), 0);
    ivec2 size = ivec2(header.xy);
    int packing = int(header.z);
    int first = base + 1;
    vec2 at = place * header.xy;
    vec4 value;
    if ((flags & IMAGE_INTERPOLATED) != 0) {
        vec2 low = floor(at - 0.5);
        vec2 share = at - 0.5 - low;
        ivec2 texel = ivec2(low);
        vec4 bottom = mix(
            image_texel(first, texel, size, packing, extension), image_texel(first, texel + ivec2(1, 0), size, packing, extension), share.x
        );
        vec4 top = mix(
            image_texel(first, texel + ivec2(0, 1), size, packing, extension),
            image_texel(first, texel + ivec2(1, 1), size, packing, extension),
            share.x
        );
        value = mix(bottom, top, share.y);
    } else {
        value = image_texel(first, ivec2(floor(at)), size, packing, extension);
    }
    if ((flags & IMAGE_ALPHA) != 0) {
        return value.aaa;
    }
    vec3 color = (flags & IMAGE_DIVIDED) != 0 && value.a > 0.0 ? value.rgb / value.a : value.rgb;
    return header.w > 0.5 ? decoded_srgb(color) : color;
}
