// One face of a light: an orientation shared by its views. Rows of the table `face` as core/passes/shadow_maps.py fills them.
// Face space (fs): origin at the light's centre, x right, y up, z forward: linear depth in metres.
vec3 face_position(vec3 p_ws) {
    vec4 p = vec4(p_ws, 1.0);
    return vec3(dot(face[0], p), dot(face[1], p), dot(face[2], p));
}

vec3 face_direction(vec3 d_ws) {
    return vec3(dot(face[0].xyz, d_ws), dot(face[1].xyz, d_ws), dot(face[2].xyz, d_ws));
}

#define texel_tangent (face[3].xy)
#define map_size (ivec2(face[3].zw))
#define texels_per_tangent (face[7].xy)
#define footprint_share (face[7].z)  // a texel's larger side over its depth
#define near_m (face[4].x)
#define far_m (face[4].y)

// Views of a batch: table `views`, two rows each.
#define view_center(k) (views[2 * (k)].xyz)
#define view_first_row(k) (int(views[2 * (k)].w))
#define view_window(k) (views[2 * (k) + 1].xy)
