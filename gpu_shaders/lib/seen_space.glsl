// What the views of a face see together, whatever their number: their centres (of suns, directions) lie in the hull of `hull_count` corners, and what any of them
// sees lies within six planes.
#include "lib/face.glsl"

// Linear in the view's centre or, of suns, direction: testing the hull's corners is exact for every view inside.
bool faces_any_view(vec3 normal_fs, vec3 point_fs) {
    bool faces = false;
    int k = -1;
    do {
        k++;
#ifdef ORTHOGRAPHIC
        vec3 towards_light = -vec3(hull[k].xy, 1.0);
#else
        vec3 towards_light = hull[k].xyz - point_fs;
#endif
        faces = faces || dot(normal_fs, towards_light) > 0.0;
    } while (k + 1 < hull_count);
    return faces;
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
