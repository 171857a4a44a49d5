// Faces of a cube around a centre: 0 and 1 look along the first axis, forwards and backwards, and so on. Places are along the cube's axes,
// from its centre.
int face_of_direction(vec3 p) {
    vec3 size = abs(p);
    if (size.z >= max(size.x, size.y)) {
        return p.z < 0.0 ? 5 : 4;
    }
    return size.x >= size.y ? (p.x > 0.0 ? 0 : 1) : (p.y > 0.0 ? 2 : 3);
}

// In the face: to the right, up, and depth.
vec3 in_face(int face, vec3 p) {
    float side = (face & 1) == 0 ? 1.0 : -1.0;
    int axis = face >> 1;
    return axis == 0 ? vec3(p.y, p.z, side * p.x) : axis == 1 ? vec3(p.z, p.x, side * p.y) : vec3(p.x, p.y, side * p.z);
}

// And back.
vec3 from_face(int face, vec3 p) {
    float side = (face & 1) == 0 ? 1.0 : -1.0;
    int axis = face >> 1;
    return axis == 0 ? vec3(side * p.z, p.x, p.y) : axis == 1 ? vec3(p.y, side * p.z, p.x) : vec3(p.x, p.y, side * p.z);
}
