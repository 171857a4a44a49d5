// Copies the points that a well-distributed batch of views does not find far behind what it sees. What is hidden from all views
// of such a batch is hidden from nearly all others: back faces of open surfaces, inner walls, what stands behind a wall.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/view.glsl"

// Nearer than this behind the visible surface a point may be part of it, or come into sight between two views.
const float KEPT_DEPTH_FOOTPRINTS = 32.0;

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 point = texelFetch(points, linear_texel(index), 0);
    bool hidden = true;
    for (int k = 0; k < view_count; k++) {
        vec3 p = point.xyz - view_center(k);
        ivec2 texel = ivec2(floor(map_position(k, vec3(p.xy, max(p.z, near_m)))));
        bool outside = p.z <= near_m || any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, map_size));
        // a window that leaves the point out says nothing about the windows of other views
        ivec2 address = clamp(texel, ivec2(0), map_size - 1) + ivec2(0, view_first_row(k));
        float seen = uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
        hidden = hidden && !outside && p.z > seen + KEPT_DEPTH_FOOTPRINTS * footprint_at(p.z);
    }
    if (!hidden) {
        uint next = imageAtomicAdd(counters, ivec2(0, 0), 1u);
        imageStore(kept_points, linear_texel(int(next)), point);
    }
}
