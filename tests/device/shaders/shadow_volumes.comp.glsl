#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/triangle_sampling.glsl"

void main() {
    int index = linear_invocation();
    if (index >= ball_count) {
        return;
    }
    vec4 ball = texelFetch(balls, linear_texel(index), 0);
    imageStore(distances, linear_texel(index), vec4(distance_to_shadow_volume(ball.xyz, ball.w)));
}
