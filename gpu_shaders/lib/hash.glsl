// PCG as a hash (Jarzynski & Olano 2020, "Hash Functions for GPU Rendering").
uint pcg_hash(uint value) {
    uint state = value * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Does not depend on where a vertex stands in its mesh, only on where it is.
uint hash_position(vec3 p) {
    return pcg_hash(floatBitsToUint(p.x) ^ pcg_hash(floatBitsToUint(p.y) ^ pcg_hash(floatBitsToUint(p.z))));
}

float unit_float(uint bits) {
    return float(bits >> 8u) * (1.0 / 16777216.0);
}
