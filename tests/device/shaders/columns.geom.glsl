// A column of pixels for every number.
void main() {
    imageAtomicAdd(counts, ivec2(0, 0), 1u);
    for (int k = 0; k < 4; k++) {
        column_number = gl_PrimitiveIDIn;
        float x = (float(gl_PrimitiveIDIn) + float(k & 1)) / float(column_count);
        gl_Position = vec4(2.0 * x - 1.0, k < 2 ? -1.0 : 1.0, 0.0, 1.0);
        EmitVertex();
    }
    EndPrimitive();
}
