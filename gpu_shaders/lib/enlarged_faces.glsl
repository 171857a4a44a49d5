// Which faces of a cube may see a triangle, by its corners (Gavane & Watson 2022 b, section 3.1): those of whose frusta, a fifth larger, any
// corner is in. Places are from the cube's centre, along its axes.
#include "lib/map_faces.glsl"

const float ENLARGED = 1.2;
const int ALL_FACES = 63;

int faces_around(vec3 p) {
    vec3 size = abs(p);
    vec3 others = vec3(max(size.y, size.z), max(size.z, size.x), max(size.x, size.y));
    bvec3 is_within = lessThanEqual(others, ENLARGED * size);
    return (is_within.x ? (p.x > 0.0 ? 1 : 2) : 0) | (is_within.y ? (p.y > 0.0 ? 4 : 8) : 0) | (is_within.z ? (p.z < 0.0 ? 32 : 16) : 0);
}

// A bit for each. Where q in a face is no farther than l from a corner, the corner is in the enlarged frustum if l is at most an eleventh of
// q's depth, which is at least the least corner's less l: of what is larger all faces may.
int faces_of_triangle(vec3 a, vec3 b, vec3 c) {
    int face = face_of_direction(a);
    if (face == face_of_direction(b) && face == face_of_direction(c)) {
        return 1 << face;
    }
    vec3 depths = vec3(max(abs(a.x), max(abs(a.y), abs(a.z))), max(abs(b.x), max(abs(b.y), abs(b.z))), max(abs(c.x), max(abs(c.y), abs(c.z))));
    float longest = sqrt(max(dot(b - a, b - a), max(dot(c - b, c - b), dot(a - c, a - c))));
    bool is_small = 12.0 * longest <= min(depths.x, min(depths.y, depths.z));
    return is_small ? faces_around(a) | faces_around(b) | faces_around(c) : ALL_FACES;
}
