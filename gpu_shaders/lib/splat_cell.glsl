// Splats a cell of a triangle's lattice that is larger than a texel into the depth maps of all views of the batch: in its bounds every
// texel whose centre sees the cell, clipped by the triangle's edges, at the plane's depth there. Neighbouring cells leave nothing
// between them and outlines are those of the triangle. Needs lib/splat.glsl.
#include "lib/aligned_triangle.glsl"

const float EDGE_TOLERANCE_FOOTPRINTS = 1.0 / 1024.0;  // what float32 may move a place by
const int MAX_SPLAT_TEXELS = 70;                       // each way: the diagonal of MAX_SPLAT_LATTICES and a texel

void splat_cell(AlignedTriangle t, vec2 center, vec2 half_size) {
    vec3 middle = point_at(t, center);
    vec3 half_u = half_size.x * t.u;
    vec3 half_v = half_size.y * t.v;
    mat3 to_plane = transpose(mat3(t.u, t.v, t.n));
    vec3 edges[3];  // inside where dot(xy, place in the cell) + z >= 0, in metres
    for (int i = 0; i < 3; i++) {
        vec2 edge = t.corner_uv[(i + 1) % 3] - t.corner_uv[i];
        edges[i] = vec3(-edge.y, edge.x, cross_2d(edge, center - t.corner_uv[i])) * inversesqrt(max(dot(edge, edge), 1e-38));
    }
    int k = -1;
    do {
        k++;
        vec3 p = middle - view_center(k);
        vec2 low = vec2(3.0e38);
        vec2 high = vec2(-3.0e38);
        float deepest = 0.0;
        for (int i = 0; i < 4; i++) {
            vec3 corner = p + ((i & 1) == 0 ? -half_u : half_u) + ((i & 2) == 0 ? -half_v : half_v);
            vec2 at = map_position(k, vec3(corner.xy, max(corner.z, near_m)));
            low = min(low, at);
            high = max(high, at);
            deepest = max(deepest, corner.z);
        }
        ivec2 first = ivec2(clamp(ceil(low - 0.5), vec2(0.0), vec2(map_size)));
        ivec2 last = ivec2(clamp(floor(high - 0.5), vec2(-1.0), vec2(map_size - 1)));
        ivec2 size = min(last - first + 1, MAX_SPLAT_TEXELS);
        if (deepest <= near_m || min(size.x, size.y) <= 0) {
            continue;
        }
        // of the view's ray through a texel's centre and of the cell's middle: along u, along v, along the normal
        vec3 row = to_plane * vec3((vec2(first) + 0.5 + view_window(k)) * texel_tangent, 1.0);
        vec3 step_x = to_plane[0] * texel_tangent.x;
        vec3 step_y = to_plane[1] * texel_tangent.y;
        vec3 offset = to_plane * p;
        float tolerance = EDGE_TOLERANCE_FOOTPRINTS * footprint_at(deepest);
        vec2 reach = half_size + tolerance;
        vec3 ray = row;
        ivec2 address = first + ivec2(0, view_first_row(k));
        int x = 0;
        int count = size.x * size.y;
        int done = 0;
        do {
            // seen edge-on the plane has no depth: the division is kept finite, and the place is outside
            float depth = offset.z / (abs(ray.z) > 1e-12 ? ray.z : 1e-12);
            vec2 place = depth * ray.xy - offset.xy;
            float outside = max(abs(place.x) - reach.x, abs(place.y) - reach.y);
            for (int i = 0; i < 3; i++) {
                outside = max(outside, -tolerance - edges[i].z - dot(edges[i].xy, place));
            }
            if (outside <= 0.0 && depth > near_m) {
                write_bits(ivec2(address.x + x, address.y), floatBitsToUint(depth) & ~1u);
            }
            x++;
            ray += step_x;
            if (x == size.x) {
                x = 0;
                row += step_y;
                ray = row;
                address.y++;
            }
        } while (++done < count);
    } while (k + 1 < view_count);
}
