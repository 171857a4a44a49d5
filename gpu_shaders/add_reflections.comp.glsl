// Adds a round to the running sums of the reflection passes. With ADAPTIVE pixels settle when some more rays do not lessen the variance of what
// they found, and from then on count as the mean of those.
#include "lib/tiles.glsl"

#ifdef ADAPTIVE
const float EVEN_SHARE = 1.0e-6;  // of the squared mean: less variance is rounding
#endif

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
#ifdef ADAPTIVE
    vec4 settling = imageLoad(settled, pixel);
    if (settling.x > 0.0) {
        float growth = float(round_number + 1) / float(round_number);
        imageStore(radiance_sums, pixel, growth * imageLoad(radiance_sums, pixel));
        imageStore(color_sums, pixel, growth * imageLoad(color_sums, pixel));
        return;
    }
#endif
    vec3 radiance = texelFetch(radiances, pixel, 0).rgb;
    vec4 color = texelFetch(colors, pixel, 0);
    float luminance = dot(radiance, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE));
    vec4 sums = imageLoad(radiance_sums, pixel) + vec4(radiance, luminance * luminance);
    imageStore(radiance_sums, pixel, sums);
    imageStore(color_sums, pixel, imageLoad(color_sums, pixel) + color);
#ifdef ADAPTIVE
    int count = round_number + 1;
    if (count % ADAPTIVE_STEP == 0) {
        float mean = dot(sums.rgb, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE)) / float(count);
        float variance = sums.a / float(count) - mean * mean;
        bool is_even = variance <= EVEN_SHARE * mean * mean;
        bool has_declined = count == ADAPTIVE_STEP || variance < settling.y;
        bool is_settled = count >= least_rounds && (is_even || !has_declined);
        imageStore(settled, pixel, vec4(is_settled ? float(count) : 0.0, variance, 0.0, 0.0));
    }
#endif
}
