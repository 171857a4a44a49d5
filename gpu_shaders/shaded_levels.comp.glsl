// The next coarser level of a shaded map: means of four texels.
#include "lib/reflection_map.glsl"

void main() {
    ReflectionMap map = load_map(map_number);
    ivec2 size = map.size >> level;
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (at.x >= size.x || at.y >= size.y * face_count(map)) {
        return;
    }
    int row = at.y / size.y;
    int face = map.is_cube ? row : 4;
    ivec2 cell = ivec2(at.x, at.y - row * size.y);
    vec4 sum = vec4(0.0);
    for (int k = 0; k < 4; k++) {
        sum += imageLoad(radiances, linear_texel(map_index(map, level - 1, face, 2 * cell + ivec2(k & 1, k >> 1))));
    }
    imageStore(radiances, linear_texel(map_index(map, level, face, cell)), 0.25 * sum);
}
