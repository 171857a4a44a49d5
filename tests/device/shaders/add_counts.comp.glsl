// Reads what a dispatch before it wrote, as a texture and as an image.
void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    uint sum = texelFetch(seen, texel, 0).x + imageLoad(counts, texel).x;
    imageStore(counts, texel, uvec4(sum));
}
