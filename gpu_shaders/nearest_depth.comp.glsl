// Finds the smallest depth in a map.
void main() {
    ivec2 first = ivec2(gl_GlobalInvocationID.xy) * BLOCK_PX;
    uint smallest = 0xffffffffu;
    for (int i = 0; i < BLOCK_PX * BLOCK_PX; i++) {
        ivec2 texel = min(first + ivec2(i % BLOCK_PX, i / BLOCK_PX), ivec2(width, height) - 1);
        smallest = min(smallest, texelFetch(depth_maps, texel, 0).x);
    }
    imageAtomicMin(nearest, ivec2(0), smallest);
}
