// Kernels that walk a list of tiles (core/passes/tiles.py), one group a tile; with PROBES several tiles a group, a few pixels of each.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

const int TILE_PIXELS = TILE_PX * TILE_PX;
const int PROBES_PER_ROW = TILE_PX / PROBE_STEP_PX;
const int PROBES_PER_TILE = PROBES_PER_ROW * PROBES_PER_ROW;

int tile_number() {
#ifdef PROBES
    return (linear_group() * TILE_PIXELS + int(gl_LocalInvocationIndex)) / PROBES_PER_TILE;
#else
    return linear_group();
#endif
}

// The list's texel of this invocation's tile.
vec4 own_tile() {
    return texelFetch(tiles, linear_texel(min(tile_number(), tile_count - 1)), 0);
}

// Whether this invocation has a pixel of the picture.
bool find_pixel(out ivec2 pixel) {
#ifdef PROBES
    int probe = int(gl_LocalInvocationIndex) % PROBES_PER_TILE;
    ivec2 within = ivec2(probe_x, probe_y) + PROBE_STEP_PX * ivec2(probe % PROBES_PER_ROW, probe / PROBES_PER_ROW);
#else
    ivec2 within = ivec2(gl_LocalInvocationID.xy);
#endif
    pixel = TILE_PX * ivec2(own_tile().xy) + within;
    return tile_number() < tile_count && pixel.x < width && pixel.y < height;
}
