// Adds one light's running sums, as means over its rounds, to those of the lights before it.
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 means = texelFetch(round_sums, pixel, 0) / texelFetch(tile_rounds, pixel / TILE_PX, 0).x;
    vec4 before = is_first != 0 ? vec4(0.0) : imageLoad(picture, pixel);
    // lights need not have the same receivers, and a surface is one whoever lights it
    imageStore(picture, pixel, vec4(before.xy + weight * means.xy, max(before.z, means.w), 0.0));
}
