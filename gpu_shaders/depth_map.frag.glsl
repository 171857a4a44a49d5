#include "lib/face.glsl"

void main() {
#ifdef ORTHOGRAPHIC
    depth_bits = floatBitsToUint(mix(near_m, far_m, gl_FragCoord.z));
#else
    // 1/w is linear on the screen, so this is the exact linear depth at the texel's centre
    depth_bits = floatBitsToUint(1.0 / gl_FragCoord.w);
#endif
#ifdef MIXED_MAPS
    depth_bits &= ~1u;
#endif
}
