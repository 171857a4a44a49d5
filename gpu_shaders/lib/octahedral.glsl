// Unit vectors as 24 bits in a float that holds them exactly: 12 + 12 bits of the octahedral map
// (Cigolle et al. 2014, "A Survey of Efficient Representations for Independent Unit Vectors"). Error below 0.06 degrees.
vec2 octahedral_wrap(vec2 p) {
    return (1.0 - abs(p.yx)) * vec2(p.x >= 0.0 ? 1.0 : -1.0, p.y >= 0.0 ? 1.0 : -1.0);
}

float pack_direction(vec3 n) {
    vec2 p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    if (n.z < 0.0) {
        p = octahedral_wrap(p);
    }
    vec2 q = floor((p * 0.5 + 0.5) * 4095.0 + 0.5);
    return q.x * 4096.0 + q.y;
}

vec3 unpack_direction(float packed_bits) {
    float x = floor(packed_bits / 4096.0);
    vec2 p = vec2(x, packed_bits - x * 4096.0) / 4095.0 * 2.0 - 1.0;
    vec3 n = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    if (n.z < 0.0) {
        n.xy = octahedral_wrap(n.xy);
    }
    return normalize(n);
}
