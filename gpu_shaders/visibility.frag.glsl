#include "lib/order_depth.glsl"
#ifdef CUT_OUT
#include "lib/opacity.glsl"

// 14 bits, zeros between them
uint spread_bits(uint bits) {
    bits = (bits | bits << 8u) & 0x00ff00ffu;
    bits = (bits | bits << 4u) & 0x0f0f0f0fu;
    bits = (bits | bits << 2u) & 0x33333333u;
    return (bits | bits << 1u) & 0x55555555u;
}
#endif

void main() {
#ifdef CUT_OUT
    // filters take samples from several pixels: along this curve neighbours' thresholds are stratified wherever a pixel begins
    uvec2 at = uvec2(gl_FragCoord.xy);
    uint place = spread_bits(at.x) | spread_bits(at.y) << 1u;
    // from the other end: where the numbers' bits meet, samples thousands of texels apart change places, and none shares its thresholds
    uint index = place ^ bitfieldReverse(uint(rasterization));
    if (opacity_at(map_base, map_header, uv) <= opacity_threshold(index, threshold_seed)) {
        discard;
    }
#endif
    gl_FragDepth = order_depth(is_orthographic != 0, tie_breaker);
    // 0 is left for the background
    visible = uvec2(uint(instance_id) + 1u, uint(first_triangle + gl_PrimitiveID));
}
