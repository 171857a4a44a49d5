// What an image's texels are beyond its edges, as core/material.py's Extension says.

// The texel that stands for this one; false: none does, and there is nothing.
bool find_texel(inout ivec2 texel, ivec2 size, int extension) {
    if (extension == EXTENSION_CLIP && (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size)))) {
        return false;
    }
    if (extension == EXTENSION_REPEAT) {
        texel -= size * ivec2(floor(vec2(texel) / vec2(size)));
    } else if (extension == EXTENSION_MIRROR) {
        texel -= 2 * size * ivec2(floor(vec2(texel) / vec2(2 * size)));
        texel = min(texel, 2 * size - 1 - texel);
    }
    // repeated texels too: division may have rounded
    texel = clamp(texel, ivec2(0), size - 1);
    return true;
}
