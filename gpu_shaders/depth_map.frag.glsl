#include "lib/view.glsl"
#ifdef CUT_OUT
#include "lib/opacity.glsl"
#endif

void main() {
#ifdef CUT_OUT
    if (opacity_at(map_base, map_header, uv) <= opacity_threshold(uint(map_number), threshold_seed)) {
        discard;
    }
#endif
#ifdef ORTHOGRAPHIC
    depth_bits = floatBitsToUint(mix(near_m, far_m, gl_FragCoord.z));
#else
    // 1/w is linear on the screen, so this is the exact linear depth at the texel's centre
    depth_bits = floatBitsToUint(1.0 / gl_FragCoord.w);
#endif
#ifdef MIXED_MAPS
    depth_bits &= ~1u;
#endif
    // what is nearer by the last bit wins, in whatever order it comes; a power of two leaves the bits alone
    gl_FragDepth = uintBitsToFloat(depth_bits) * 5.421010862427522e-20;
}
