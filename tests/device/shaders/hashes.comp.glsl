#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/hash.glsl"

void main() {
    int index = linear_invocation();
    if (index >= hash_count) {
        return;
    }
    uint hash = pcg_hash(uint(index));
    // a lattice of positions: its bits differ in few places
    vec3 position = vec3(index & 127, (index >> 7) & 127, index >> 14) * 0.25 - 8.0;
    imageStore(integer_hashes, linear_texel(index), uvec4(hash));
    imageStore(position_hashes, linear_texel(index), uvec4(hash_position(position)));
    imageStore(unit_floats, linear_texel(index), vec4(unit_float(hash)));
}
