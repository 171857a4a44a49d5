// Adds one light's running sums, as means over its rounds, to those of the lights before it.

// What all rounds deliver over what the rounds in the sums do: linear between the probes of a tile, of which there are two in a row.
float settled_light(ivec2 pixel, float late_share) {
    ivec2 low = pixel / TILE_PX * (TILE_PX / PROBE_STEP_PX);
    vec2 probed[4];
    vec2 of_tile = vec2(0.0);
    for (int i = 0; i < 4; i++) {
        probed[i] = texelFetch(probed_light, low + ivec2(i & 1, i >> 1), 0).xy;
        of_tile += probed[i];
    }
    vec4 later;
    for (int i = 0; i < 4; i++) {
        // where nothing was probed, as beyond the picture's edge, what the rest of the tile tells
        vec2 known = probed[i].y > 0.0 ? probed[i] : of_tile;
        later[i] = known.y > 0.0 ? known.x / known.y : 1.0;
    }
    vec2 at = clamp((vec2(pixel % TILE_PX) + 0.5) / float(PROBE_STEP_PX) - 0.5, 0.0, 1.0);
    vec2 in_rows = mix(later.xz, later.yw, at.x);
    return 1.0 + late_share * (mix(in_rows.x, in_rows.y, at.y) - 1.0);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec2 rounds = texelFetch(tile_rounds, pixel / TILE_PX, 0).xy;
    vec4 means = texelFetch(round_sums, pixel, 0) / rounds.x;
    means.xy *= settled_light(pixel, rounds.y);
    vec4 before = is_first != 0 ? vec4(0.0) : imageLoad(picture, pixel);
    // lights need not have the same receivers, and a surface is one whoever lights it
    imageStore(picture, pixel, vec4(before.xy + weight * means.xy, max(before.z, means.w), 0.0));
}
