// Which face of the light's cube a direction belongs to (light space: x, y in an area light's plane, z along its axis).
#include "lib/face.glsl"

int face_index(vec3 d) {
    vec2 side = abs(d.xy);
    if (abs(d.z) >= max(side.x, side.y)) {
        return d.z > 0.0 ? 0 : 5;
    }
    return side.x >= side.y ? (d.x > 0.0 ? 1 : 2) : (d.y > 0.0 ? 3 : 4);
}

vec3 light_position(vec3 p_ws) {
    vec4 p = vec4(p_ws, 1.0);
    return vec3(dot(face[8], p), dot(face[9], p), dot(face[10], p));
}
