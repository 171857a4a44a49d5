// Looks every visible surface up in the depth maps of a batch and adds to the pass's running sums.
//
// The pass is sum(visible * delivered) / sum(delivered) over light samples and eye samples. What sample k would deliver:
// the shading normal's cosine, the light's cosine and spread, and 1 / distance^2; all without the light's strength.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/face.glsl"

#define face_limits (face[5])
#define light_axis_fs (face[6].xyz)
#define tan_half_spread (face[6].w)
#define reference_squared_distance (face[4].z)  // keeps sums near 1 in scenes of any scale

// The receiver's tangent plane is followed to the texel's centre, at most this many footprints: at grazing angles the
// plane runs away along the ray while the surface does not.
const float MAX_PLANE_SHIFT_FOOTPRINTS = 8.0;

float delivered(vec3 to_view, float squared_distance, vec3 shading_fs) {
    float inverse_distance = inversesqrt(squared_distance);
    float cosine_receiver = dot(shading_fs, to_view) * inverse_distance;
    float cosine_light = -dot(light_axis_fs, to_view) * inverse_distance;
    if (cosine_receiver <= 0.0 || cosine_light <= 0.0) {
        return 0.0;
    }
    float spread = 1.0;
    if (tan_half_spread > 0.0) {
        // Blender's area light spread: linear in the tangent of the angle to the light's axis
        float tangent = sqrt(max(1.0 - cosine_light * cosine_light, 0.0)) / cosine_light;
        spread = max(tan_half_spread - tangent, 0.0) / tan_half_spread;
    }
    return cosine_receiver * cosine_light * spread * (reference_squared_distance / squared_distance);
}

// 1 if the view sees the point, 0 if something is before it. p: from the view's centre, face space.
float visible_from(int k, vec3 p, vec3 normal_fs) {
    float facing = dot(normal_fs, p);
    if (facing >= 0.0) {
        return 0.0;  // the surface itself is in the way
    }
    if (p.z <= near_m) {
        return 1.0;  // the light touches it
    }
    vec2 at = p.xy / (p.z * texel_tangent) - view_window(k);
    ivec2 texel = ivec2(floor(at));
    if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, map_size))) {
        return 1.0;  // outside every caster's outline
    }
    float footprint = p.z * max(texel_tangent.x, texel_tangent.y);
    vec3 ray = vec3((vec2(texel) + 0.5 + view_window(k)) * texel_tangent, 1.0);
    float ray_facing = dot(normal_fs, ray);
    // a plane that turns away before the texel's centre has no depth there; the clamp then decides
    float plane_depth = ray_facing < 0.0 ? facing / ray_facing : 3.0e38;
    float reach = MAX_PLANE_SHIFT_FOOTPRINTS * footprint;
    float receiver_depth = clamp(plane_depth, p.z - reach, p.z + reach);
    // what the plane does not explain: curvature and facets within a texel, and the rounding of depth itself
    float slope = min(sqrt(max(dot(p, p) * dot(normal_fs, normal_fs) - facing * facing, 0.0)) / -facing, BIAS_MAX_SLOPE);
    float bias = footprint * (BIAS_FOOTPRINTS + BIAS_SLOPE_FOOTPRINTS * slope) + 4.0e-7 * p.z;
    float stored = uintBitsToFloat(texelFetch(depth_maps, texel + ivec2(0, view_first_row(k)), 0).x);
    return stored >= receiver_depth - bias ? 1.0 : 0.0;
}

bool in_face(vec3 p) {
    // faces meet at planes through the view's centre; each pixel-view pair belongs to exactly one
    vec2 low = face_limits.xz * p.z;
    vec2 high = face_limits.yw * p.z;
    return p.z > 0.0 && all(greaterThanEqual(p.xy, low)) && all(lessThan(p.xy, high));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    bool surface = position.w >= 0.0;
#ifdef RECEIVER_LINKING
    surface = surface && texelFetch(receivers, linear_texel(int(position.w)), 0).x > 0.5;
#endif
    vec2 sums = first_face != 0 ? vec2(0.0) : imageLoad(batch_sums, pixel).xy;
    if (surface) {
        vec4 normal = texelFetch(normals, pixel, 0);
        vec3 p_fs = face_position(position.xyz);
        vec3 normal_fs = face_direction(normal.xyz);
        vec3 shading_fs = face_direction(unpack_direction(normal.w));
        for (int k = 0; k < view_count; k++) {
            vec3 p = p_fs - view_center(k);
            float squared_distance = dot(p, p);
            // a point on the light itself: the cosines have no direction
            if (!(squared_distance > 0.0)) {
                continue;
            }
#ifdef MANY_FACES
            if (!in_face(p)) {
                continue;
            }
#endif
            float weight = delivered(-p, squared_distance, shading_fs);
            if (weight > 0.0) {
                sums += weight * vec2(visible_from(k, p, normal_fs), 1.0);
            }
        }
    }
    if (last_face == 0) {
        imageStore(batch_sums, pixel, vec4(sums, 0.0, 0.0));
        return;
    }
    if (surface) {
        imageStore(moments, pixel, imageLoad(moments, pixel) + vec4(sums, sums.x * sums.x, sums.x * sums.y));
        imageStore(coverage, pixel, imageLoad(coverage, pixel) + vec4(sums.y * sums.y, 1.0, 0.0, 0.0));
    }
}
