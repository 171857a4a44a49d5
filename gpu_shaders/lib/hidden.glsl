// Whether a view of a finished batch finds a place far behind what it sees. A batch is spread over the whole light: what is hidden from
// all of its views is hidden from nearly all others, too. Back faces of open surfaces, inner walls, what stands behind a wall.
#include "lib/view.glsl"

// Nearer than this behind the visible surface something may be part of it, or come into sight between two views.
const float KEPT_DEPTH_FOOTPRINTS = 32.0;

// at: texels from the map's corner
bool hidden_from(int k, vec2 at, float depth, float kept_depth_footprints) {
    ivec2 texel = ivec2(floor(at));
    // a window that leaves it out says nothing about the windows of other views
    bool outside = depth <= near_m || any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, map_size));
    ivec2 address = clamp(texel, ivec2(0), map_size - 1) + ivec2(0, batch_first_row(k));
    float seen = uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
    return !outside && depth > seen + kept_depth_footprints * footprint_at(depth);
}
