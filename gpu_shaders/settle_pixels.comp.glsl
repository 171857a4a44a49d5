// Finds the pixels all around which the pass is the same, wholly lit, dark or background.
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    uint found = 0u;
    for (int y = -SETTLE_RADIUS_PX; y <= SETTLE_RADIUS_PX; y++) {
        for (int x = -SETTLE_RADIUS_PX; x <= SETTLE_RADIUS_PX; x++) {
            found |= texelFetch(states, clamp(pixel + ivec2(x, y), ivec2(0), ivec2(width, height) - 1), 0).x;
        }
    }
    bool same = bitCount(found) == 1 && found != 1u;
    imageStore(settled, pixel, uvec4(same ? 1u : 0u));
}
