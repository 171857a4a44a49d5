// Sums over tiles of 16 x 16 pixels of the squared standard error of the luminance that reflections add, and of the pixels that show any.
void main() {
    ivec2 tile = ivec2(gl_GlobalInvocationID.xy);
    if (tile.x * 16 >= width || tile.y * 16 >= height) {
        return;
    }
    float count = float(round_count);
    vec2 sums = vec2(0.0);
    for (int y = tile.y * 16; y < min(tile.y * 16 + 16, height); y++) {
        for (int x = tile.x * 16; x < min(tile.x * 16 + 16, width); x++) {
            if (texelFetch(color_sums, ivec2(x, y), 0).a > 0.0) {
                vec4 radiance = texelFetch(radiance_sums, ivec2(x, y), 0) / count;
                float mean = dot(radiance.rgb, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE));
                float own = count;
#ifdef ADAPTIVE
                float settled_at = texelFetch(settled, ivec2(x, y), 0).x;
                own = settled_at > 0.0 ? settled_at : count;
#endif
                sums += vec2(max(radiance.a - mean * mean, 0.0) / (own - 1.0), 1.0);
            }
        }
    }
    imageStore(tile_sums, tile, vec4(sums, 0.0, 0.0));
}
