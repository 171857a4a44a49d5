#ifdef CUT_OUT
#include "lib/opacity.glsl"
#endif

void main() {
#ifdef CUT_OUT
    // the samples of a pixel take the first thresholds, those of its next rasterization go on from there
    ivec2 at = ivec2(gl_FragCoord.xy);
    ivec2 pixel = at / samples_per_px;
    ivec2 within = at - pixel * samples_per_px;
    int index = first_threshold + within.y * samples_per_px + within.x;
    if (opacity_at(map_base, uv) <= opacity_threshold(uint(index), pcg_hash(threshold_seed ^ uint(pixel.y << 16 | pixel.x)))) {
        discard;
    }
#endif
    // 0 is left for the background
    visible = uvec2(uint(instance_id) + 1u, uint(gl_PrimitiveID));
}
