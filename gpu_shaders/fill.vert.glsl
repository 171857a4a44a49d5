void main() {
    gl_Position = vec4(position_os, 1.0);
}
