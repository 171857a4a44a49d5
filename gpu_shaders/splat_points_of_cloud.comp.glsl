// Splats points of the cloud into the cubes of a batch, a texel each.
#include "lib/linear_invocation.glsl"
#include "lib/octahedral.glsl"
#include "lib/splat_reflected.glsl"
#include "lib/pending_cubes.glsl"
#include "lib/point_texel.glsl"

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 place = texelFetch(points, linear_texel(2 * index), 0);
    vec4 owned = texelFetch(points, linear_texel(2 * index + 1), 0);
    Owner owner = unpack_owner(owned.xyz);
    vec4 mask = texelFetch(cube_masks, linear_texel(owner.instance), 0);
    vec3 normal = unpack_direction(place.w);
    int seen = 0;
    for (int rest = pending_cubes(index, mask); rest != 0; rest &= rest - 1) {
        int k = findLSB(rest);
        vec3 p = place.xyz - cube_center(k);
        float spacing = sample_spacing(k, p, 0.0);
        // what is far below a texel's area in this cube is left out at random, as it was for the nearest one
        bool is_kept = owner.random * culling_area * spacing * spacing < owned.w;
        seen |= is_kept && (dot(normal, p) < 0.0 || shows_back_faces(mask, k)) ? 1 << k : 0;
    }
    int cubes_before = 0;
    while (seen != 0) {
        int k = findLSB(seen);
        seen &= seen - 1;
        int face;
        ivec2 texel;
        float depth;
        if (find_point_texel(k, place.xyz, normal, face, texel, depth)) {
            cubes_before |= write_texel(k, face, texel, depth, owner.number) ? 1 << k : 0;
        }
    }
    finish(index, cubes_before);
}
