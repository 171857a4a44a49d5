void main() {
    // 1/w is linear on the screen, so this is the exact linear depth at the texel's centre
    depth_bits = floatBitsToUint(1.0 / gl_FragCoord.w);
}
