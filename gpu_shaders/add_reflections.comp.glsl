// Adds a round to the running sums of the reflection passes.
#include "lib/tiles.glsl"

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec3 radiance = texelFetch(radiances, pixel, 0).rgb;
    vec4 color = texelFetch(colors, pixel, 0);
    float luminance = dot(radiance, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE));
    imageStore(radiance_sums, pixel, imageLoad(radiance_sums, pixel) + vec4(radiance, luminance * luminance));
    imageStore(color_sums, pixel, imageLoad(color_sums, pixel) + color);
}
