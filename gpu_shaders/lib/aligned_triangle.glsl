// A triangle and its plane.
struct AlignedTriangle {
    vec3 corner_fs[3];
    vec3 centroid_fs;
    vec3 u;  // T_align (eq. 1): u, v span the triangle's plane, n is its unit normal
    vec3 v;
    vec3 n;
    vec2 corner_uv[3];  // metres from the centroid, counter-clockwise
    float area;
};

AlignedTriangle align_triangle(vec3 a, vec3 b, vec3 c) {
    AlignedTriangle t;
    t.corner_fs[0] = a;
    t.corner_fs[1] = b;
    t.corner_fs[2] = c;
    t.centroid_fs = (a + b + c) / 3.0;
    vec3 scaled = cross(b - a, c - a);
    float twice_area = length(scaled);
    t.area = 0.5 * twice_area;
    t.n = twice_area > 0.0 ? scaled / twice_area : vec3(0.0);
    // along the longest edge the triangle's bounds are smallest, and so is the number of cells that it does not fill; of two that are
    // almost equally long the first, so that rounding does not choose between those of isosceles triangles
    vec3 ab = b - a, bc = c - b, ca = a - c;
    float squared_ab = dot(ab, ab), squared_bc = dot(bc, bc), squared_ca = dot(ca, ca);
    float squared = max(max(squared_ab, squared_bc), squared_ca);
    float almost = 0.99 * squared;
    vec3 longest = squared_ab >= almost ? ab : (squared_bc >= almost ? bc : ca);
    t.u = squared > 0.0 ? longest * inversesqrt(dot(longest, longest)) : vec3(1.0, 0.0, 0.0);
    t.v = cross(t.n, t.u);
    for (int k = 0; k < 3; k++) {
        vec3 d = t.corner_fs[k] - t.centroid_fs;
        t.corner_uv[k] = vec2(dot(d, t.u), dot(d, t.v));
    }
    return t;
}

vec3 point_at(AlignedTriangle t, vec2 uv) {
    return t.centroid_fs + uv.x * t.u + uv.y * t.v;
}

float cross_2d(vec2 a, vec2 b) {
    return a.x * b.y - a.y * b.x;
}
