// Depths that only 32 bits of floating point tell apart: 2^-64 and what follows it.
void main() {
    number = uint(instance_number * 10 + gl_PrimitiveID + 1);
    gl_FragDepth = uintBitsToFloat(0x1f800000u + uint(instance_number));
}
