// Kernels that walk a list of tiles (core/passes/tiles.py), one group a tile.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

// Whether this invocation has a pixel of the picture.
bool find_pixel(out ivec2 pixel) {
    int group = linear_group();
    vec2 tile = texelFetch(tiles, linear_texel(min(group, tile_count - 1)), 0).xy;
    pixel = ivec2(tile) * ivec2(gl_WorkGroupSize.xy) + ivec2(gl_LocalInvocationID.xy);
    return group < tile_count && pixel.x < width && pixel.y < height;
}
