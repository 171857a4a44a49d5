// One view of a face for the rasterizer: off-axis perspective, or sheared for a sun, whose window is the map's place on the texel lattice.
#include "lib/view.glsl"
#ifndef PLACED
#include "lib/place_vertex.glsl"
#endif
#ifdef CUT_OUT
#include "lib/cut_out_vertex.glsl"
#endif

void main() {
#ifdef CUT_OUT
    place_in_opacity_map(first_instance + gl_InstanceID);
#endif
#ifdef PLACED
    vec3 p = position_os - view_center(view_index);
#else
    vec3 p = face_position(place_vertex(first_instance + gl_InstanceID, position_os)) - view_center(view_index);
#endif
    float scale = 1.0 / (far_m - near_m);
#ifdef ORTHOGRAPHIC
    gl_Position = vec4(2.0 * map_position(view_index, p) / vec2(map_size) - 1.0, (2.0 * p.z - far_m - near_m) * scale, 1.0);
#else
    vec2 scaled_position = p.xy / texel_tangent - view_window(view_index) * p.z;
    vec2 clip = 2.0 * scaled_position / vec2(map_size) - p.z;
    gl_Position = vec4(clip, ((far_m + near_m) * p.z - 2.0 * far_m * near_m) * scale, p.z);
#endif
}
