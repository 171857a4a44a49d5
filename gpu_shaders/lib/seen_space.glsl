// What the views of a face see together, whatever their number: their centres lie in the hull's convex hull, and what any of them
// sees lies within six planes.
#include "lib/face.glsl"

// Linear in the view's centre: testing the hull's corners is exact for every view inside.
bool faces_any_view(vec3 normal_fs, vec3 point_fs) {
    for (int k = 0; k < hull_count; k++) {
        if (dot(normal_fs, hull[k].xyz - point_fs) > 0.0) {
            return true;
        }
    }
    return false;
}

// Whether a convex quadrilateral or triangle (its last corner twice) is on the outer side of one of the planes.
bool unseen(vec3 corners_fs[4]) {
    for (int i = 0; i < 6; i++) {
        bool all_outside = true;
        for (int k = 0; k < 4; k++) {
            all_outside = all_outside && dot(seen_space[i].xyz, corners_fs[k]) < seen_space[i].w;
        }
        if (all_outside) {
            return true;
        }
    }
    return false;
}
