// The same in every texel of a texture.
void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (at.x < width && at.y < height) {
        imageStore(filled, at, vec4(0.0, 0.0, 0.0, fourth));
    }
}
