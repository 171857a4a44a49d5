// What a point of the light would deliver to a receiver without anything in between: the shading normal's cosine, the light's cosine and
// spread or cone, and 1 / distance^2; all without the light's strength.
// light_point: in face space, ORTHOGRAPHIC: the unit direction of its rays, and what it counts; p: the receiver from that point.
#include "lib/face.glsl"

#define light_axis_fs (face[5].xyz)
#define tan_half_spread (face[5].w)
#define sample_patch_m (face[6].w)  // no place of the light is farther from the nearest sample
#define reference_squared_distance (face[4].z)  // keeps sums near 1 in scenes of any scale

#ifdef SPREAD
// Beyond its spread a sample still says something of its patch of the light: of narrow spreads a receiver may be within that of places
// between samples only. It counts next to nothing where any other counts, and less by far than a nearer one.
const float FAINT_SHARE = 1.0e-4;

float share_of_spread(float tangent, float distance_m) {
    float share = 1.0 - tangent / tan_half_spread;
    if (share > 0.0) {
        return share;
    }
    float nearness = tan_half_spread / tangent;
    nearness *= nearness;
    nearness *= nearness;
    return (tangent - tan_half_spread) * distance_m <= sample_patch_m ? FAINT_SHARE * nearness * nearness : 0.0;
}
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

Place place;  // of the receiver that this invocation looks up

void set_place(vec3 p_fs) {
    float squared = dot(p_fs, p_fs);
    float squared_radius = light_radius_m * light_radius_m;
    place.p_fs = p_fs;
    place.inside = squared < squared_radius;
    place.gain = soft_falloff && !place.inside ? 2.0 : 4.0;
    place.disc = soft_falloff ? squared * (squared / (squared + squared_radius)) : 0.0;
}

float delivered(vec4 light_point, vec3 p, vec3 shading_fs) {
    float squared_distance = dot(p, p);
    float receiver = -dot(shading_fs, p);
    if (receiver <= 0.0) {
        return 0.0;
    }
#ifdef SPHERE
    float emitter = dot(light_point.xyz, p) / light_radius_m;
    if (soft_falloff) {
        float ahead = dot(p, place.p_fs);
        emitter = ahead > 0.0 && ahead * ahead >= squared_distance * place.disc ? abs(emitter) : 0.0;
    } else {
        emitter = max(place.inside ? -emitter : emitter, 0.0);
    }
    emitter *= place.gain * light_point.w;
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
#ifdef ORTHOGRAPHIC
float delivered(vec4 light_point, vec3 p, vec3 shading_fs) {
    return max(-dot(shading_fs, light_point.xyz), 0.0);
}
#else
float delivered(vec4 light_point, vec3 p, vec3 shading_fs) {
    float squared_distance = dot(p, p);
    float receiver = -dot(shading_fs, p);
    float emitter = dot(light_axis_fs, p);
    if (receiver <= 0.0 || emitter <= 0.0) {
        return 0.0;
    }
    float inverse = 1.0 / squared_distance;
    float weight = (receiver * inverse) * (emitter * inverse) * reference_squared_distance;
#ifdef SPREAD
    // Blender's area light spread: linear in the tangent of the angle to the light's axis
    float tangent = sqrt(max(squared_distance - emitter * emitter, 0.0)) / emitter;
    weight *= share_of_spread(tangent, emitter);
#endif
    return weight;
}
#endif
#endif
