// Begins the words of a map's texels with the surfaces that were drawn or splatted whole: their depths and, with PACKED, colours.
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
    vec4 position = texelFetch(positions, address, 0);
    float depth = in_face(face, map_direction(map, position.xyz - map.center_ws)).z;
#ifdef PACKED
    uint word = packed_word(log2(depth / nearest_m), steps_per_octave, texelFetch(shown, address, 0).rgb);
#else
    uint word = floatBitsToUint(depth);
#endif
    imageStore(begun, address, uvec4(position.w >= 0.0 ? word : EMPTY_WORD));
}
