// The source view of view-warped soft shadows: it stands behind an area light and contains the views of all its points.
#include "lib/face.glsl"
#include "lib/place_vertex.glsl"

void main() {
    p_fs = face_position(place_vertex(first_instance + gl_InstanceID, position_os));
    vec3 p = p_fs - source_eye;
    vec2 clip = 2.0 * (p.xy / source_texel - source_window.xy * p.z) / source_window.zw - p.z;
    float scale = 1.0 / (source_depths.y - source_depths.x);
    gl_Position = vec4(clip, ((source_depths.y + source_depths.x) * p.z - 2.0 * source_depths.y * source_depths.x) * scale, p.z);
}
