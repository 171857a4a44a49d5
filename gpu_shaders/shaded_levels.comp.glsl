// The next coarser level of a shaded map: means of four texels.
#include "lib/reflection_map.glsl"

void main() {
    ReflectionMap map = load_map(map_number);
    int face;
    ivec2 cell;
    if (!find_cell(map, level, face, cell)) {
        return;
    }
    vec4 sum = vec4(0.0);
    for (int k = 0; k < 4; k++) {
        sum += imageLoad(radiances, linear_texel(map_index(map, level - 1, face, 2 * cell + ivec2(k & 1, k >> 1))));
    }
    imageStore(radiances, linear_texel(map_index(map, level, face, cell)), 0.25 * sum);
}
