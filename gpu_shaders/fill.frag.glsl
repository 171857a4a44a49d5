void main() {
    filled = uvec4(uint(value));
}
