// The reflection passes so far, as a picture to lay over another.
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec3 radiance = texelFetch(radiance_sums, pixel, 0).rgb / float(round_count);
    vec4 color = texelFetch(color_sums, pixel, 0) / float(round_count);
    if (shown == 2) {
        imageStore(picture, pixel, vec4(radiance, 0.0));
        return;
    }
    vec3 reflection = mix(vec3(0.0), radiance / max(color.rgb, vec3(1e-20)), greaterThan(color.rgb, vec3(0.0)));
    imageStore(picture, pixel, shown == 0 ? vec4(color.a * reflection, color.a) : color);
}
