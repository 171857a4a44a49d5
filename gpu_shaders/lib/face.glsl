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
#define texels_per_tangent (face[6].xy)
#define footprint_share (face[6].z)  // a texel's larger side over its depth
#define near_m (face[4].x)
#define far_m (face[4].y)
#define blur_depth (face[4].w)

// The larger side of a texel in metres, and how far depths may be rounded.
#ifdef ORTHOGRAPHIC
float footprint_at(float depth) {
    return footprint_share;
}

float depth_rounding(float depth) {
    return 1.0e-6 * far_m;
}
#else
float footprint_at(float depth) {
    return depth * footprint_share;
}

float depth_rounding(float depth) {
    return 4.0e-7 * depth;
}
#endif

// Surfaces nearer to the light than its own diameter (`blur_depth`) are sampled as if they stood there, and their points cover
// as many more texels. Each view sees another part of them, so sampling them fully takes many times the texels of a map; but
// their penumbra is the light's diameter over their depth times as wide as the receiver's depth, so an outline that
// grows by blur_depth / depth texels changes it by less than a texel's tangent, a five-hundredth of its width.
const float MAX_FOOTPRINT_TEXELS = 16.0;

float sampled_depth(float depth) {
    return max(depth, min(blur_depth, MAX_FOOTPRINT_TEXELS * depth));
}
