// Tells pixels that are wholly lit, dark or background so far from the others.
#include "lib/pass_states.glsl"

// Between surfaces that meet or pass each other there may be a shadow thinner than a pixel, which few eye samples see.
const float MIN_NORMALS_COSINE = 0.8;
const float MAX_SINE_OUT_OF_PLANE = 0.35;

bool continues_to(ivec2 pixel, ivec2 neighbour) {
    vec4 here = texelFetch(positions, pixel, 0);
    vec4 there = texelFetch(positions, min(neighbour, ivec2(width, height) - 1), 0);
    vec3 normal = texelFetch(normals, pixel, 0).xyz;
    vec3 other_normal = texelFetch(normals, min(neighbour, ivec2(width, height) - 1), 0).xyz;
    vec3 step = there.xyz - here.xyz;
    return here.w < 0.0 || (there.w >= 0.0 && dot(normal, other_normal) >= MIN_NORMALS_COSINE &&
                            abs(dot(normal, step)) <= MAX_SINE_OUT_OF_PLANE * length(step));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 rounds = texelFetch(round_sums, pixel, 0);
    vec2 sums = rounds.xy;
    float surface_samples = rounds.w;
    uint state = STATE_MIXED;
    if (surface_samples == 0.0) {
        state = STATE_BACKGROUND;
    } else if (surface_samples == texelFetch(tile_rounds, pixel / TILE_PX, 0).x && continues_to(pixel, pixel + ivec2(1, 0)) && continues_to(pixel, pixel + ivec2(0, 1))) {
        state = wholly_dark(sums) ? STATE_DARK : (wholly_lit(sums) ? STATE_LIT : STATE_MIXED);
    }
    imageStore(states, pixel, uvec4(state));
}
