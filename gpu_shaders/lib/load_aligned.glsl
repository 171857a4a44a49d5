// A triangle of the scene in a light's face, aligned with its plane.
#include "lib/scene_data.glsl"
#include "lib/face.glsl"
#include "lib/aligned_triangle.glsl"

AlignedTriangle load_aligned(InstanceData instance, TriangleData triangle) {
    vec3 a = face_position(triangle.position_ws[0]);
    vec3 b = face_position(triangle.position_ws[1]);
    vec3 c = face_position(triangle.position_ws[2]);
    // face space is left-handed and transforms may mirror: the order of the corners keeps n at the triangle's front
    return instance.orientation > 0.0 ? align_triangle(a, c, b) : align_triangle(a, b, c);
}
