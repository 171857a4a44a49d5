void main() {
    // 0 is left for the background
    visible = uvec2(uint(instance_id) + 1u, uint(gl_PrimitiveID));
}
