// Sampling a triangle as in improved view-independent rasterization (Gavane & Watson 2022, section 3).
#include "lib/seen_space.glsl"
#include "lib/aligned_triangle.glsl"
#include "lib/lattice_cells.glsl"

const float SMALL_TRIANGLE_SHARE = 0.01;  // of its depth
const float TOUCHING_SHARE = 1.0 / 64.0;

// Ericson 2005, "Real-Time Collision Detection", section 5.1.5.
vec3 closest_point(vec3 p, vec3 a, vec3 b, vec3 c) {
    vec3 ab = b - a, ac = c - a, ap = p - a;
    float d1 = dot(ab, ap), d2 = dot(ac, ap);
    if (d1 <= 0.0 && d2 <= 0.0) return a;
    vec3 bp = p - b;
    float d3 = dot(ab, bp), d4 = dot(ac, bp);
    if (d3 >= 0.0 && d4 <= d3) return b;
    float vc = d1 * d4 - d3 * d2;
    if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return a + ab * (d1 / (d1 - d3));
    vec3 cp = p - c;
    float d5 = dot(ab, cp), d6 = dot(ac, cp);
    if (d6 >= 0.0 && d5 <= d6) return c;
    float vb = d5 * d2 - d1 * d6;
    if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return a + ac * (d2 / (d2 - d6));
    float va = d3 * d6 - d5 * d4;
    if (va <= 0.0 && (d4 - d3) >= 0.0 && (d5 - d6) >= 0.0) return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    float sum = va + vb + vc;
    return sum > 0.0 ? a + ab * (vb / sum) + ac * (vc / sum) : a;
}

#ifdef ORTHOGRAPHIC
// Of views of a sun densities depend on nothing but the plane; `hull` are corners around their directions (offset a metre of depth).
// x, y as below. Both are convex in the direction, so the corners stand for all views.
vec2 largest_density_of_plane(vec3 n) {
    vec2 density = vec2(0.0);
    vec2 texels = texels_per_tangent;
    for (int k = 0; k < hull_count; k++) {
        vec3 row_x = texels.x * vec3(1.0, 0.0, -hull[k].x);
        vec3 row_y = texels.y * vec3(0.0, 1.0, -hull[k].y);
        float along_x = dot(row_x, n), along_y = dot(row_y, n);
        float frobenius = dot(row_x, row_x) + dot(row_y, row_y) - along_x * along_x - along_y * along_y;
        density = max(density, vec2(abs(dot(vec3(hull[k].xy, 1.0), n)) * texels.x * texels.y, frobenius));
    }
    return density;
}

vec2 largest_density(AlignedTriangle t) {
    return largest_density_of_plane(t.n);
}

vec2 largest_density_of_rectangle(vec3 corners[4], vec3 n) {
    return largest_density_of_plane(n);
}
#else
// A view that has a point in its window is at least this deep before it: depth is distance over sqrt(1 + tangents^2), and no
// view is nearer than the hull. `slack`: how far the surface meant reaches around the point.
float least_visible_depth(vec3 p_fs, float slack) {
    vec3 outside = max(abs(p_fs - hull_box[0].xyz) - hull_box[1].xyz, 0.0);
    // surfaces that touch the light would ask for any density; the few views that are nearer than this share of the light's diameter
    // see holes in them
    return max((length(outside) - slack) * hull_box[0].w, max(near_m, TOUCHING_SHARE * blur_depth));
}

// Texels per square metre of the plane with normal n at p (relative to a view), which is at least `least_depth` deep.
// x: rho of the paper, one point for the area of a reverse-projected texel.
// y: the density that leaves no texel empty: a lattice of spacing h has an image whose covering radius is at most
//    h |J| / 2 with J the Jacobian from plane to map and |J| its Frobenius norm (Gram-Schmidt vectors are no longer
//    than the lattice's own), and a texel holds a disc of radius 1/2: h = 1 / |J|.
vec2 texel_density(vec3 p, vec3 n, float least_depth) {
    float z = max(p.z, least_depth);
    vec2 tangent = clamp(p.xy / z, window_bounds.xz, window_bounds.yw);
#ifdef EYE_DENSITY
    vec2 texels = texels_per_tangent / z;
#else
    vec2 texels = texels_per_tangent / sampled_depth(z);
#endif
    vec3 row_x = texels.x * vec3(1.0, 0.0, -tangent.x);
    vec3 row_y = texels.y * vec3(0.0, 1.0, -tangent.y);
    float along_x = dot(row_x, n), along_y = dot(row_y, n);
    float frobenius = dot(row_x, row_x) + dot(row_y, row_y) - along_x * along_x - along_y * along_y;
    return vec2(abs(dot(vec3(tangent, 1.0), n)) * texels.x * texels.y, frobenius);
}

#ifdef EYE_DENSITY
#define eye_position_fs (eye[0].xyz)
#define eye_pixel_angle (eye[1].x)  // of a perspective camera, 0 for others
#define eye_pixel_m (eye[1].y)      // of an orthographic one

const float MAX_SPLAT_LATTICES = 48.0;    // cells of the maps' own lattice along a splat's side
const float POINTS_PER_EYE_PIXEL = 0.5;  // rho_scale, which the paper found best

// A lower bound of the distance from the eye to what a ball may shadow, whichever of the light's points shines. Behind the ball, its
// shadow is a ball's that grows by `widening` a metre; it ends with the farthest receiver.
float distance_to_shadow_volume(vec3 center, float radius) {
    vec3 from_light = center - hull_box[0].xyz;
    float away = length(from_light);
    float widening = (radius + length(hull_box[1].xyz)) / max(away, 1e-30);
    if (widening >= 1.0) {
        return 0.0;  // it may be anywhere
    }
    vec3 direction = from_light / away;
    vec3 to_eye = eye_position_fs - center;
    float along = dot(to_eye, direction);
    float aside = sqrt(max(dot(to_eye, to_eye) - along * along, 0.0));
    float deepest = far_m + hull_box[0].z + hull_box[1].z - center.z + radius;
    float sinking = direction.z - widening;
    float length_m = sinking > 0.0 ? max(deepest, 0.0) / sinking : 3.0e38;
    float nearest = clamp(along + aside * widening * inversesqrt(1.0 - widening * widening), 0.0, length_m);
    return max(length(vec2(nearest - along, aside)) - radius - widening * nearest, 0.0);
}

// How many times coarser than for the maps a lattice may be. rho_mv (Gavane & Watson 2022 b, eq. 5): d_lt / d_ev is how many pixels of
// the eye a texel of a map takes, if both have the same tangent; the maps' own density, s_ortho, is the most that is of use. Surfaces
// nearer to the light than its diameter need no more than if they stood there.
float lattice_coarseness(vec3 center, float radius) {
    float pixel_m = eye_pixel_angle * distance_to_shadow_volume(center, radius) + eye_pixel_m;
    float depth = least_visible_depth(center, radius);
    float wanted = max(pixel_m * inversesqrt(POINTS_PER_EYE_PIXEL) / footprint_at(depth), blur_depth / depth);
    return clamp(wanted, 1.0, MAX_SPLAT_LATTICES);
}
#endif

#ifdef GLOBAL_RATE
// Marrs et al. 2017: the distance of the nearest view, and under which angle whatever triangle may be seen at the windows' farthest
// corner. x, y as above. At distance r, where depth is c r, the Jacobian stretches by at most 1 / (c^2 r) away from the axis and
// 1 / (c r) around it; a plane's share of that is no larger.
vec2 largest_density(AlignedTriangle t) {
    float radius = max(max(length(t.corner_uv[0]), length(t.corner_uv[1])), length(t.corner_uv[2]));
    vec3 outside = max(abs(t.centroid_fs - hull_box[0].xyz) - hull_box[1].xyz, 0.0);
    float depth = min(min(t.corner_fs[0].z, t.corner_fs[1].z), t.corner_fs[2].z) - hull_box[0].z - hull_box[1].z;
    // both are lower bounds: the first is close for small triangles, the second for large level ones
    float nearest = max(max(length(outside) - radius, depth), max(near_m, TOUCHING_SHARE * blur_depth));
    float c = hull_box[0].w;
    float around = max(texels_per_tangent.x, texels_per_tangent.y) / (sampled_depth(nearest) * c);
    float away = around / c;
    return vec2(away * away, away * away + around * around);
}
#else
// rho_mv (eq. 2): the largest density that any view needs, at the point of the triangle closest to it. The views lie in the
// hull of `hull_count` corners.
vec2 largest_density(AlignedTriangle t) {
    vec2 density = vec2(0.0);
    float radius = max(max(length(t.corner_uv[0]), length(t.corner_uv[1])), length(t.corner_uv[2]));
    float least_depth = least_visible_depth(t.centroid_fs, radius);
    if (radius < SMALL_TRIANGLE_SHARE * least_depth) {
        // too small for its closest point to matter: the centroid moved nearer by the triangle's radius is as safe
        for (int k = 0; k < hull_count; k++) {
            density = max(density, texel_density(t.centroid_fs - vec3(0.0, 0.0, radius) - hull[k].xyz, t.n, least_depth));
        }
        return density;
    }
    for (int k = 0; k < hull_count; k++) {
        vec3 nearest = closest_point(hull[k].xyz, t.corner_fs[0], t.corner_fs[1], t.corner_fs[2]);
        density = max(density, texel_density(nearest - hull[k].xyz, t.n, least_depth));
    }
    return density;
}
#endif

// The same for a rectangle of a triangle's plane.
vec2 largest_density_of_rectangle(vec3 corners[4], vec3 n) {
    vec3 center = 0.5 * (corners[0] + corners[3]);
    float least_depth = least_visible_depth(center, 0.5 * length(corners[3] - corners[0]));
    float depth = min(min(corners[0].z, corners[1].z), min(corners[2].z, corners[3].z));
    vec2 density = vec2(0.0);
    for (int k = 0; k < hull_count; k++) {
        for (int i = 0; i < 4; i++) {
            density = max(density, texel_density(vec3(corners[i].xy, depth) - hull[k].xyz, n, least_depth));
        }
    }
    return density;
}

#endif
