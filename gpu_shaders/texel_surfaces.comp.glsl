// What the centres of all of a map's texels see, kept where the map keeps its texels.
#include "lib/keep_texel.glsl"

void main() {
    ReflectionMap map = load_map(map_number);
    int face;
    ivec2 cell;
    if (!find_cell(map, 0, face, cell)) {
        return;
    }
    keep_texel(map, face, cell, linear_texel(map_index(map, 0, face, cell)));
}
