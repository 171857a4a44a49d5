// What kernels share that look the picture up round by round: which pixels take part, and what becomes of their sums of shadowed and
// delivered light.
#include "lib/tiles.glsl"
#include "lib/pass_states.glsl"

// position: of the G-buffer
bool takes_light(vec4 position) {
    bool surface = position.w >= 0.0;
#ifdef RECEIVER_LINKING
    surface = surface && texelFetch(receivers, linear_texel(int(position.w)), 0).x > 0.5;
#endif
    return surface;
}

// Of TURN_DEFINES.
int own_turn() {
#ifdef PROBES
    return FIRST_FACE | LAST_FACE;
#else
    return int(own_tile().z);
#endif
}

// The pass's sums before this round. To be asked for long before they are needed: software rasterizers wait for memory.
vec4 pass_before(ivec2 pixel) {
#ifdef PROBES
    return vec4(0.0);
#else
    return imageLoad(round_sums, pixel);
#endif
}

vec2 sums_before(int turn, ivec2 pixel) {
    return (turn & FIRST_FACE) != 0 ? vec2(0.0) : imageLoad(batch_sums, pixel).xy;
}

// before: of pass_before
void add_to_pass(int turn, ivec2 pixel, bool surface, vec2 sums, vec4 before) {
#ifdef PROBES
    vec4 tile = own_tile();
    uint state = uint(tile.z);
    bool is_lit = state == STATE_LIT && wholly_lit(sums);
    bool is_dark = state == STATE_DARK && wholly_dark(sums);
    if (surface ? !is_lit && !is_dark : state != STATE_BACKGROUND) {
        imageStore(disagreeing, ivec2(tile.xy), uvec4(1u));
    }
    // what this round's part of the light delivers here, and the mean of the rounds in the sums, once however many faces the light has
    ivec2 cell = pixel / PROBE_STEP_PX;
    float known = tile.w * imageLoad(round_sums, pixel).y;
    imageStore(probed_light, cell, imageLoad(probed_light, cell) + vec4(sums.y, known, 0.0, 0.0));
#else
    if ((turn & LAST_FACE) == 0) {
        imageStore(batch_sums, pixel, vec4(sums, 0.0, 0.0));
        return;
    }
    // of a tile that was left out of rounds: by how much those add to the light before them; 0: it was left out of none
    float growth = own_tile().w;
    if (surface || growth > 0.0) {
        if (growth > 0.0) {
            before = vec4(before.xyz * growth, before.w > 0.0 ? float(rounds_before) : 0.0);
        }
        // Welford's way, for a ratio: (s - R d) of the ratio R before this round times that of the one after it
        float squared = 0.0;
        if (before.y > 0.0) {
            float deviation = sums.x - sums.y * (before.x / before.y);
            squared = deviation * deviation * (before.y / (before.y + sums.y));
        }
        imageStore(round_sums, pixel, before + vec4(sums, squared, surface ? 1.0 : 0.0));
    }
#endif
}
