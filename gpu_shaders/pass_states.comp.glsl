// What a pass has found of every pixel so far: always lit, never lit, always background, or something between.
const uint STATE_MIXED = 1u;
const uint STATE_LIT = 2u;
const uint STATE_DARK = 4u;
const uint STATE_BACKGROUND = 8u;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec2 sums = texelFetch(moments, pixel, 0).xy;
    float surface_samples = texelFetch(coverage, pixel, 0).y;
    uint state = STATE_MIXED;
    if (surface_samples == 0.0) {
        state = STATE_BACKGROUND;
    } else if (surface_samples == float(batch_count)) {
        // the two sums of a lit pixel have the same terms, but not always in the same order
        state = sums.x == 0.0 ? STATE_DARK : (sums.x >= sums.y * (1.0 - 1.0e-6) ? STATE_LIT : STATE_MIXED);
    }
    imageStore(states, pixel, uvec4(state));
}
