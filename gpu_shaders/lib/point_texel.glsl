// The texel of a cube that a point of the cloud falls into.
#include "lib/cubes.glsl"

const float MAX_SHIFT_TEXELS = 0.5;

// depth: of the point's plane where the texel's centre sees it, within limits: beyond the triangle's edge it is a guess
bool find_point_texel(int k, vec3 position, vec3 normal, out int face, out ivec2 texel, out float depth) {
    vec3 p = position - cube_center(k);
    face = face_of_direction(p);
    vec3 f = in_face(face, p);
    texel = clamp(ivec2(floor((f.xy / f.z + 1.0) / texel_tangent(k))), ivec2(0), ivec2(cube_side(k) - 1));
    float along = dot(in_face(face, normal), vec3((vec2(texel) + 0.5) * texel_tangent(k) - 1.0, 1.0));
    float shift = MAX_SHIFT_TEXELS * f.z * texel_tangent(k);
    depth = clamp(along != 0.0 ? dot(normal, p) / along : f.z, f.z - shift, f.z + shift);
    return f.z > cube_near_m(k);
}
