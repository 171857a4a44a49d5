// Cells of a lattice in a triangle's plane.
#include "lib/aligned_triangle.glsl"

// Half a cell's side, less what rounding decides: symmetric triangles touch cells with no more than a corner or an edge, and in another
// place or unit they would not. A point stands for a thousandth more of its surroundings.
const float TOUCHED_HALF = 0.4995;

// Whether a rectangle touches the triangle: conservative rasterization of a lattice cell (Akenine-Moeller & Aila 2005).
bool rectangle_overlaps(AlignedTriangle t, vec2 center, vec2 half_size) {
    for (int k = 0; k < 3; k++) {
        vec2 edge = t.corner_uv[(k + 1) % 3] - t.corner_uv[k];
        float reach = half_size.x * abs(edge.y) + half_size.y * abs(edge.x);
        if (cross_2d(edge, center - t.corner_uv[k]) + reach < 0.0) {
            return false;
        }
    }
    vec2 low = min(min(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 high = max(max(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    return all(lessThanEqual(low, center + half_size)) && all(greaterThanEqual(high, center - half_size));
}

// The triangle's point nearest to a cell's centre. Conservative cells reach beyond the triangle; a point left out there
// would exaggerate the silhouette, and projecting onto a convex set keeps every covered place within reach of its point.
vec2 nearest_in_triangle(AlignedTriangle t, vec2 p) {
    bool inside = true;
    float best = 3.4e38;
    vec2 nearest = p;
    for (int k = 0; k < 3; k++) {
        vec2 edge = t.corner_uv[(k + 1) % 3] - t.corner_uv[k];
        vec2 d = p - t.corner_uv[k];
        if (cross_2d(edge, d) < 0.0) {
            inside = false;
        }
        float squared = dot(edge, edge);
        vec2 candidate = t.corner_uv[k] + edge * (squared > 0.0 ? clamp(dot(d, edge) / squared, 0.0, 1.0) : 0.0);
        float distance_squared = dot(p - candidate, p - candidate);
        if (distance_squared < best) {
            best = distance_squared;
            nearest = candidate;
        }
    }
    return inside ? p : nearest;
}
