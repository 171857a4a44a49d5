// A geometry shader makes everything of the number of a primitive.
void main() {
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
}
