// Adds one light's running sums, as means over its rounds, to those of the lights before it.

// Linear between the middles of a tile's cells, of which there are two in a row.
float light_of_settled(ivec2 pixel) {
    ivec2 low = pixel / TILE_PX * (TILE_PX / PROBE_STEP_PX);
    vec2 at = clamp((vec2(pixel % TILE_PX) + 0.5) / float(PROBE_STEP_PX) - 0.5, 0.0, 1.0);
    vec4 cells;
    for (int i = 0; i < 4; i++) {
        cells[i] = texelFetch(settled_light, low + ivec2(i & 1, i >> 1), 0).x;
    }
    vec2 in_rows = mix(cells.xz, cells.yw, at.x);
    return mix(in_rows.x, in_rows.y, at.y);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 means = texelFetch(round_sums, pixel, 0) / texelFetch(tile_rounds, pixel / TILE_PX, 0).x;
    means.xy *= light_of_settled(pixel);
    vec4 before = is_first != 0 ? vec4(0.0) : imageLoad(picture, pixel);
    // lights need not have the same receivers, and a surface is one whoever lights it
    imageStore(picture, pixel, vec4(before.xy + weight * means.xy, max(before.z, means.w), 0.0));
}
