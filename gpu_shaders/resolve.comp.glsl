// Looks every visible surface up in the depth maps of a batch and adds to the pass's running sums.
//
// The pass is sum(visible * delivered) / sum(delivered) over light samples and eye samples. What sample k would deliver:
// the shading normal's cosine, the light's cosine and spread or cone, and 1 / distance^2; all without the light's strength.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/view.glsl"

#define light_axis_fs (face[5].xyz)
#define tan_half_spread (face[5].w)
#define reference_squared_distance (face[4].z)  // keeps sums near 1 in scenes of any scale

// The receiver's tangent plane is followed to the texel's centre, at most this many footprints: at grazing angles the
// plane runs away along the ray while the surface does not.
const float MAX_PLANE_SHIFT_FOOTPRINTS = 8.0;

#ifdef ORTHOGRAPHIC
#define ray_direction(k) (samples[k].xyz)
#endif
#ifdef OMNI
#define light_radius_m (face[7].x)
#define soft_falloff (face[7].y > 0.5)
#define cos_half_cone (face[7].z)
#define per_blend_cosine (face[7].w)
#define cone_right_fs (face[11].xyz)
#define cone_up_fs (face[12].xyz)

// What a point is to the light as a whole. SPHERE: every sample is seen under the cosine to the sphere's normal. From outside a
// sphere only its near side shines, from inside all of it does. With a soft falloff it stands for a disc through its centre that
// faces the point: it is seen under the directions that meet the disc, twice from outside (the near side and the far side, which
// see the same as long as nothing casts within the sphere), once from inside.
struct Place {
    vec3 p_fs;
    bool inside;
    float gain;  // the disc's or sphere's irradiance is that of its centre, whatever counts
    float disc;  // share of squared cosines to the centre's direction that meet the disc, times squared distance of the point
};

Place place_of(vec3 p_fs) {
    Place place;
    float squared = dot(p_fs, p_fs);
    float squared_radius = light_radius_m * light_radius_m;
    place.p_fs = p_fs;
    place.inside = squared < squared_radius;
    place.gain = soft_falloff && !place.inside ? 2.0 : 4.0;
    place.disc = soft_falloff ? squared * (squared / (squared + squared_radius)) : 0.0;
    return place;
}

float delivered(int k, vec3 p, float squared_distance, vec3 shading_fs, Place place) {
    float receiver = -dot(shading_fs, p);
    if (receiver <= 0.0) {
        return 0.0;
    }
#ifdef SPHERE
    float emitter = dot(view_center(k), p) / light_radius_m;
    if (soft_falloff) {
        float ahead = dot(p, place.p_fs);
        emitter = ahead > 0.0 && ahead * ahead >= squared_distance * place.disc ? abs(emitter) : 0.0;
    } else {
        emitter = max(place.inside ? -emitter : emitter, 0.0);
    }
    emitter *= place.gain * samples[k].w;
#else
    float emitter = sqrt(squared_distance);
#endif
    float inverse = 1.0 / squared_distance;
    float weight = (receiver * inverse) * (emitter * inverse) * reference_squared_distance;
#ifdef CONE
    // Blender's spot: smooth in the cosine to the axis of the cone's own, scaled space
    vec3 local = vec3(dot(cone_right_fs, p), dot(cone_up_fs, p), dot(light_axis_fs, p));
    float fade = clamp((local.z * inversesqrt(dot(local, local)) - cos_half_cone) * per_blend_cosine, 0.0, 1.0);
    bool everywhere = place.inside && !soft_falloff;
    weight *= everywhere ? 1.0 : fade * fade * (3.0 - 2.0 * fade);
#endif
    return weight;
}
#else
float delivered(vec3 p, float squared_distance, vec3 shading_fs) {
    float receiver = -dot(shading_fs, p);
    float emitter = dot(light_axis_fs, p);
    if (receiver <= 0.0 || emitter <= 0.0) {
        return 0.0;
    }
    float inverse = 1.0 / squared_distance;
    float weight = (receiver * inverse) * (emitter * inverse) * reference_squared_distance;
    if (tan_half_spread > 0.0) {
        // Blender's area light spread: linear in the tangent of the angle to the light's axis
        float tangent = sqrt(max(squared_distance - emitter * emitter, 0.0)) / emitter;
        weight *= max(1.0 - tangent / tan_half_spread, 0.0);
    }
    return weight;
}
#endif

// 1 if the view sees the point, 0 if something is before it. p: from the view's centre, face space.
// tolerance: in footprints, what the tangent plane does not explain.
float visible_from(int k, vec3 p, vec3 normal_fs, float tolerance) {
    float offset = dot(normal_fs, p);
#ifdef ORTHOGRAPHIC
    float facing = dot(normal_fs, ray_direction(k));
#else
    float facing = offset;
#endif
    if (facing >= 0.0) {
        return 0.0;  // the surface itself is in the way
    }
    vec2 at = map_position(k, p);
#ifdef POINT_MAPS
    // A texel is covered if a point lies anywhere in it, which enlarges outlines by half a texel all around. Taking the deepest
    // of the four texels around the look-up, as if it stood at their common corner, shrinks them by as much.
    ivec2 texel = ivec2(floor(at - 0.5));
    vec2 place = vec2(texel) + 1.0;
    const int last = 1;
#else
    ivec2 texel = ivec2(floor(at));
    vec2 place = vec2(texel) + 0.5;
    const int last = 0;
#endif
    // outside every caster's outline, or so near that the light touches it
    if (p.z <= near_m || any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel + last, map_size))) {
        return 1.0;
    }
    float footprint = footprint_at(p.z);
    vec2 plane = plane_on_ray(k, place, normal_fs, offset);
    // a plane that turns away before that place has no depth there; the clamp then decides
    float plane_depth = plane.y < 0.0 ? plane.x / plane.y : 3.0e38;
    float reach = MAX_PLANE_SHIFT_FOOTPRINTS * footprint;
    float receiver_depth = clamp(plane_depth, p.z - reach, p.z + reach);
    ivec2 address = texel + ivec2(0, view_first_row(k));
    uint bits = texelFetch(depth_maps, address, 0).x;
#ifdef POINT_MAPS
    bits = max(bits, texelFetch(depth_maps, address + ivec2(1, 0), 0).x);
    bits = max(bits, texelFetch(depth_maps, address + ivec2(0, 1), 0).x);
    bits = max(bits, texelFetch(depth_maps, address + ivec2(1, 1), 0).x);
#endif
    return uintBitsToFloat(bits) >= receiver_depth - footprint * tolerance - depth_rounding(p.z) ? 1.0 : 0.0;
}

// Which face of the light's cube a direction belongs to (light space: x, y in an area light's plane, z along its axis).
int face_index(vec3 d) {
    vec2 side = abs(d.xy);
    if (abs(d.z) >= max(side.x, side.y)) {
        return d.z > 0.0 ? 0 : 5;
    }
    return side.x >= side.y ? (d.x > 0.0 ? 1 : 2) : (d.y > 0.0 ? 3 : 4);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    bool surface = position.w >= 0.0 && texelFetch(settled, pixel, 0).x == 0u;
#ifdef RECEIVER_LINKING
    surface = surface && texelFetch(receivers, linear_texel(int(position.w)), 0).x > 0.5;
#endif
    vec2 sums = first_face != 0 ? vec2(0.0) : imageLoad(batch_sums, pixel).xy;
    if (surface) {
        vec4 normal = texelFetch(normals, pixel, 0);
        vec3 p_fs = face_position(position.xyz);
        vec3 normal_fs = face_direction(normal.xyz);
        vec3 shading_fs = face_direction(unpack_direction(normal.w));
#ifdef MANY_FACES
        vec3 p_ls = vec3(dot(face[8], vec4(position.xyz, 1.0)), dot(face[9], vec4(position.xyz, 1.0)), dot(face[10], vec4(position.xyz, 1.0)));
#endif
        // curvature and facets within a texel move depths by more the steeper the surface stands to the light
#ifdef ORTHOGRAPHIC
        const vec3 ray = vec3(0.0, 0.0, 1.0);
#else
        vec3 ray = p_fs;
#endif
        float facing = min(dot(normal_fs, ray), 0.0);
        float slope = sqrt(max(dot(ray, ray) - facing * facing, 0.0)) / max(-facing, 1e-20);
        float tolerance = BIAS_FOOTPRINTS + BIAS_SLOPE_FOOTPRINTS * min(slope, BIAS_MAX_SLOPE);
#ifdef OMNI
        Place place = place_of(p_fs);
#endif
        for (int k = 0; k < view_count; k++) {
            vec3 p = p_fs - view_center(k);
#ifdef ORTHOGRAPHIC
            const bool in_map = true;
            float weight = max(-dot(shading_fs, ray_direction(k)), 0.0);
#else
            float squared_distance = dot(p, p);
            // a point on the light itself: the cosines have no direction
            if (!(squared_distance > 0.0)) {
                continue;
            }
#ifdef MANY_FACES
            int belongs_to = face_index(p_ls - samples[k].xyz);
            if ((face_mask & (1 << belongs_to)) == 0) {
                continue;
            }
            bool in_map = belongs_to == map_face;
#else
            const bool in_map = true;
#endif
#ifdef OMNI
            float weight = delivered(k, p, squared_distance, shading_fs, place);
#else
            float weight = delivered(p, squared_distance, shading_fs);
#endif
#endif
            if (weight > 0.0) {
                // faces without casters have no map and are looked up together with the first that has one
                sums += weight * vec2(in_map ? visible_from(k, p, normal_fs, tolerance) : float(dot(normal_fs, p) < 0.0), 1.0);
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
