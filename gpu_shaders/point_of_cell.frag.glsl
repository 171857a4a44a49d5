// A fragment is a cell of a triangle's lattice: the point that the triangle has there.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/triangle_sampling.glsl"
#ifdef INTO_MAPS
#include "lib/splat.glsl"
#endif

void main() {
    fragment = 1u;
    AlignedTriangle t;
    t.corner_uv[0] = corners_uv.xy;
    t.corner_uv[1] = corners_uv.zw;
    t.corner_uv[2] = third_corner_uv;
    t.centroid_fs = centroid_fs;
    t.u = along_u;
    t.v = along_v;
    t.n = normal_fs;
    vec2 cell = floor(gl_FragCoord.xy) - 1.0;
    vec2 center = first_cell.xy + first_cell.zw * cell;
    if (any(lessThan(cell, vec2(0.0))) || any(greaterThanEqual(cell, cell_counts)) || !rectangle_overlaps(t, center, TOUCHED_HALF * first_cell.zw)) {
        return;
    }
    vec3 p_fs = point_at(t, nearest_in_triangle(t, center));
    int index = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
#ifdef INTO_BUFFER
    // counted all the same: the host learns how much room is missing
    if (index < texel_capacity) {
        imageStore(points, linear_texel(index), vec4(p_fs, pack_direction(t.n)));
    }
#else
    splat(p_fs, t.n);
#endif
}
