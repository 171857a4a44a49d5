// Finds the tiles in and around which the pass is the same, wholly lit, dark or background, and gets light evenly.
#include "lib/pass_states.glsl"

void main() {
    ivec2 tile = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = ivec2(width, height);
    if (any(greaterThanEqual(tile * TILE_PX, size))) {
        return;
    }
    ivec2 low = max(tile * TILE_PX - SETTLE_RADIUS_PX, 0);
    ivec2 high = min((tile + 1) * TILE_PX + SETTLE_RADIUS_PX, size);
    uint found = 0u;
    float least = 1.0e30;
    float most = 0.0;
    for (int y = low.y; y < high.y; y++) {
        for (int x = low.x; x < high.x; x++) {
            found |= texelFetch(states, ivec2(x, y), 0).x;
            float delivered = texelFetch(round_sums, ivec2(x, y), 0).y;
            least = min(least, delivered);
            most = max(most, delivered);
        }
    }
    bool same = bitCount(found) == 1 && found != STATE_MIXED && (is_combined == 0 || most <= MAX_UNEVENNESS * least);
    imageStore(tile_states, tile, uvec4(same ? found : 0u));
}
