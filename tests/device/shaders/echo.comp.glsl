// Says what every kind of constant and table arrived as.
void main() {
    imageStore(heard, ivec2(0, 0), vec4(float(an_int), a_float, 0.0, 0.0));
    imageStore(heard, ivec2(1, 0), vec4(a_vec2, 0.0, 0.0));
    imageStore(heard, ivec2(2, 0), vec4(a_vec3, 0.0));
    imageStore(heard, ivec2(3, 0), a_vec4);
    imageStore(heard, ivec2(4, 0), a_mat4 * a_vec4);
    for (int k = 0; k < 3; k++) {
        imageStore(heard, ivec2(5 + k, 0), first_table[k]);
    }
    imageStore(heard, ivec2(8, 0), second_table[0]);
#ifdef SCALED
    imageStore(heard, ivec2(9, 0), vec4(SCALE));
#endif
}
