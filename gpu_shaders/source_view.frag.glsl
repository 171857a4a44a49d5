// Every fragment of the source view is a point, whatever stands before it.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#ifdef INTO_MAPS
#include "lib/splat.glsl"
#endif

void main() {
    // positions are linear in the triangle's plane, so their differences lie in it exactly
    vec3 along = dFdx(p_fs);
    vec3 scaled = cross(along * inversesqrt(max(dot(along, along), 1e-30)), dFdy(p_fs));
    float squared = dot(scaled, scaled);
    vec3 normal_fs = squared > 1e-30 ? scaled * inversesqrt(squared) : vec3(0.0, 0.0, 1.0);
#ifdef INTO_BUFFER
    int index = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
    // counted all the same: the host learns how much room is missing
    if (index < texel_capacity) {
        imageStore(points, linear_texel(index), vec4(p_fs, pack_direction(normal_fs)));
    }
#else
    splat(p_fs, normal_fs);
#endif
    fragment = 1u;
}
