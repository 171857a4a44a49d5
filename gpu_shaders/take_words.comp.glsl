// What a map's texels show by their words; those without one keep what they show.
#include "lib/reflection_map.glsl"
#include "lib/words.glsl"

void main() {
    ReflectionMap map = load_map(map_number);
    int face;
    ivec2 cell;
    if (!find_cell(map, 0, face, cell)) {
        return;
    }
    ivec2 address = linear_texel(map_index(map, 0, face, cell));
    uint word = texelFetch(words, address, 0).x;
    if (word != EMPTY_WORD) {
#ifdef PACKED
        imageStore(radiances, address, vec4(color_of_packed(word), 0.0));
#else
        imageStore(radiances, address, vec4(color_of_word(word), 0.0));
#endif
    }
}
