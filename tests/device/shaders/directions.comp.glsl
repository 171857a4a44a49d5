// Two texels a direction: packed and unpacked here; packed by the host and unpacked here.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/octahedral.glsl"

void main() {
    int index = linear_invocation();
    if (index >= direction_count) {
        return;
    }
    vec4 given = texelFetch(directions, linear_texel(index), 0);
    float packed_here = pack_direction(given.xyz);
    imageStore(unpacked, linear_texel(2 * index), vec4(unpack_direction(packed_here), packed_here));
    imageStore(unpacked, linear_texel(2 * index + 1), vec4(unpack_direction(given.w), given.w));
}
