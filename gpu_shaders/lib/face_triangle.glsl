// A triangle as a face of a cube sees it, in homogeneous coordinates (Olano & Greer 1997, "Triangle Scan Conversion using 2D Homogeneous
// Coordinates"): what crosses the face's plane needs no clipping.
#include "lib/linear_texel.glsl"
#include "lib/cubes.glsl"

const float BOUNDS_SLACK_TEXELS = 1.0 / 64.0;  // what rounding may move a corner by

struct FaceTriangle {
    vec3 corners[3];
    vec2 depths;  // nearest and farthest
    ivec2 low;    // texels that it may cover; none where high is smaller
    ivec2 high;
};

struct FaceEdges {
    vec3 edge_a;  // a direction is inside where its products with all three are positive
    vec3 edge_b;
    vec3 edge_c;
    vec3 normal;
    float offset;  // of the plane along its normal
};

// Neighbours take the same product for their common edge, whichever way they go along it: between them nothing is left.
vec3 ordered_cross(vec3 p, vec3 q) {
    bool is_ordered = p.x < q.x || (p.x == q.x && (p.y < q.y || (p.y == q.y && p.z < q.z)));
    vec3 product = cross(is_ordered ? p : q, is_ordered ? q : p);
    return is_ordered ? product : -product;
}

// a, b, c: from the cube's centre
FaceTriangle on_face(int k, int face, vec3 a, vec3 b, vec3 c) {
    FaceTriangle t;
    t.corners[0] = a = in_face(face, a);
    t.corners[1] = b = in_face(face, b);
    t.corners[2] = c = in_face(face, c);
    t.depths = vec2(min(a.z, min(b.z, c.z)), max(a.z, max(b.z, c.z)));
    float half_side = 0.5 * float(cube_side(k));
    int last = cube_side(k) - 1;
    t.low = ivec2(0);
    t.high = ivec2(t.depths.y > cube_near_m(k) ? last : -1);
    if (t.depths.x > cube_near_m(k)) {
        vec2 at_a = a.xy / a.z;
        vec2 at_b = b.xy / b.z;
        vec2 at_c = c.xy / c.z;
        vec2 low = (clamp(min(at_a, min(at_b, at_c)), -1.5, 1.5) + 1.0) * half_side;
        vec2 high = (clamp(max(at_a, max(at_b, at_c)), -1.5, 1.5) + 1.0) * half_side;
        t.low = max(ivec2(ceil(low - 0.5 - BOUNDS_SLACK_TEXELS)), 0);
        t.high = min(ivec2(floor(high - 0.5 + BOUNDS_SLACK_TEXELS)), last);
    }
    return t;
}

FaceEdges edges_of(FaceTriangle t) {
    FaceEdges e;
    vec3 a = t.corners[0];
    vec3 b = t.corners[1];
    vec3 c = t.corners[2];
    e.normal = cross(b - a, c - a);
    e.offset = dot(e.normal, a);
    float winding = e.offset > 0.0 ? 1.0 : -1.0;
    e.edge_a = winding * ordered_cross(b, c);
    e.edge_b = winding * ordered_cross(c, a);
    e.edge_c = winding * ordered_cross(a, b);
    return e;
}

vec3 texel_direction(int k, vec2 place) {
    return vec3(place * texel_tangent(k) - 1.0, 1.0);
}

// Depth of the triangle where a texel's centre sees it, 0 where it does not.
float depth_at(int k, FaceTriangle t, FaceEdges e, ivec2 texel) {
    vec3 direction = texel_direction(k, vec2(texel) + 0.5);
    bool is_inside = min(dot(e.edge_a, direction), min(dot(e.edge_b, direction), dot(e.edge_c, direction))) >= 0.0;
    float along = dot(e.normal, direction);
    // seen edge-on a plane has any depth
    float depth = clamp(along != 0.0 ? e.offset / along : t.depths.x, t.depths.x, t.depths.y);
    return is_inside && e.offset != 0.0 && depth > cube_near_m(k) ? depth : 0.0;
}
