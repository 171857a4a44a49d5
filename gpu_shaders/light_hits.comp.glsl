// Adds what one light brings to the surfaces that rays met.
#include "lib/tiles.glsl"

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec3 scattered = texelFetch(scatterings, pixel, 0).rgb;
    if (dot(scattered, vec3(1.0)) > 0.0) {
        float lit = texelFetch(batch_sums, pixel, 0).x;
        imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(lit * light_rgb * scattered, 0.0));
    }
}
