// Finds the pixels all around which the pass is the same, wholly lit, dark or background.
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    uint found = 0u;
    ivec2 low = max(pixel - SETTLE_RADIUS_PX, ivec2(0));
    ivec2 high = min(pixel + SETTLE_RADIUS_PX, ivec2(width, height) - 1);
    for (int y = low.y; y <= high.y; y++) {
        for (int x = low.x; x <= high.x; x++) {
            found |= texelFetch(states, ivec2(x, y), 0).x;
        }
    }
    bool same = bitCount(found) == 1 && found != 1u;
    imageStore(settled, pixel, uvec4(same ? 1u : 0u));
}
