// Copies the small triangles that a batch of views does not find far behind what it sees, all corners of them. A batch is spread over
// the whole light: what is hidden from all of it is hidden from nearly all other views.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/small_triangles.glsl"

// Nearer than this behind the visible surface a triangle may be part of it, or come into sight between two views.
const float KEPT_DEPTH_FOOTPRINTS = 32.0;

bool hidden_from(int k, vec3 corner) {
    float linear;
    ivec2 texel = ivec2(floor(place_corner(k, corner, linear)));
    float depth = depth_of(linear);
    // a window that leaves it out says nothing about the windows of other views
    bool outside = any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, map_size));
    ivec2 address = clamp(texel, ivec2(0), map_size - 1) + ivec2(0, view_first_row(k));
    float seen = uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
    return !outside && depth > seen + KEPT_DEPTH_FOOTPRINTS * footprint_at(depth);
}

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(gathered_triangles, linear_texel(3 * index + i), 0);
    }
    bool hidden = true;
    int k = -1;
    do {
        k++;
        hidden = hidden_from(k, corners[0].xyz) && hidden_from(k, corners[1].xyz) && hidden_from(k, corners[2].xyz);
    } while (hidden && k + 1 < view_count);
    if (hidden) {
        return;
    }
    // counted all the same: the host learns how much room is missing
    int place = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
    if (place >= triangle_capacity) {
        return;
    }
    for (int i = 0; i < 3; i++) {
        imageStore(kept_triangles, linear_texel(3 * place + i), corners[i]);
    }
}
