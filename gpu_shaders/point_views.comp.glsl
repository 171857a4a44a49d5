// Which views, faces of a batch's cubes, see a point of the cloud: a bit each, FACES_PER_CHANNEL to a channel.
#include "lib/linear_invocation.glsl"
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
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
    ivec4 bits = ivec4(0);
    for (int k = 0; k < cube_count; k++) {
        vec3 p = place.xyz - cube_center(k);
        float spacing = sample_spacing(k, p, 0.0);
        bool is_shown = (int(mask.x) >> k & 1) == 0;
        bool is_kept = owner.random * culling_area * spacing * spacing < owned.w;
        bool is_front = dot(normal, p) < 0.0 || (int(mask.y) >> k & 1) == 0;
        int face;
        ivec2 texel;
        float depth;
        if (is_shown && is_kept && is_front && find_point_texel(k, place.xyz, normal, face, texel, depth)) {
            int view = 6 * k + face;
            bits[view / FACES_PER_CHANNEL] |= 1 << view % FACES_PER_CHANNEL;
        }
    }
    imageStore(point_views, linear_texel(index * view_texels + view_texel), vec4(bits));
}
