// Sums over tiles of 16 x 16 pixels of the squared standard error of the pass, and of the pixels that it was summed over.
// Ratio estimator (Cochran 1977, section 6.4): R = sum s / sum d over n rounds, var R = n / (n - 1) sum (s - R d)^2 / (sum d)^2. The
// squared deviations come from ratios on the way to R (lib/rounds.glsl), which is the same where all rounds deliver alike.
void main() {
    ivec2 tile = ivec2(gl_GlobalInvocationID.xy);
    if (tile.x * 16 >= width || tile.y * 16 >= height) {
        return;
    }
    vec2 sums = vec2(0.0);
    for (int y = tile.y * 16; y < min(tile.y * 16 + 16, height); y++) {
        for (int x = tile.x * 16; x < min(tile.x * 16 + 16, width); x++) {
            vec4 rounds = texelFetch(round_sums, ivec2(x, y), 0);
            if (rounds.y > 0.0) {
                sums += vec2(rounds.z / rounds.y / rounds.y, 1.0);
            }
        }
    }
    imageStore(tile_sums, tile, vec4(sums, 0.0, 0.0));
}
