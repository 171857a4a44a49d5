// The next coarser level of a map: the range of depths of four cells.
#include "lib/reflection_map.glsl"

void main() {
    ReflectionMap map = load_map(map_number);
    int face;
    ivec2 cell;
    if (!find_cell(map, level, face, cell)) {
        return;
    }
    vec2 range = vec2(NOTHING_NEARER, -1.0);
    for (int k = 0; k < 4; k++) {
        vec4 finer = imageLoad(map_texels, linear_texel(map_index(map, level - 1, face, 2 * cell + ivec2(k & 1, k >> 1))));
        range = vec2(min(range.x, finer.x), max(range.y, finer.y));
    }
    imageStore(map_texels, linear_texel(map_index(map, level, face, cell)), vec4(range, -1.0, -1.0));
}
