// Adds what one light brings to the surfaces that rays met: what arrives, as RESOLVE has it with shadows, times what the surface sends on
// of it without shadows: a mean over points of the light; of lobes too narrow for those, one of their directions that meets the light
// or does not.
#include "lib/tiles.glsl"
#include "lib/octahedral.glsl"
#include "lib/delivered.glsl"
#include "lib/gloss.glsl"
#include "lib/facets.glsl"
#include "lib/hash.glsl"
#include "lib/lamp.glsl"

#ifdef ORTHOGRAPHIC
#define from_point(k, p_fs) (light_points[k].xyz)
#else
#define from_point(k, p_fs) (p_fs - light_points[k].xyz)
#endif

const float LEAST_FACING = 0.1;

// Radiance of the light over the irradiance that it brings, where one of the lobe's directions meets it. arriving: mean weight of its
// points
vec3 seen_lamp(Gloss gloss, vec3 p_ws, vec3 normal_fs, vec3 to_eye, vec3 p_fs, float arriving) {
    float masked = 1.0;
    vec3 seen_fs = seen_normal(normal_fs, to_eye);
    vec3 facet = seen_fs;
    if (gloss.width > MIRROR_WIDTH) {
        uint random = hash_position(p_ws);
        vec2 place = vec2(unit_float(random), unit_float(pcg_hash(random)));
        facet = facet_of(seen_fs, to_eye, gloss.width, place, masked);
    }
    vec3 direction = reflect(-to_eye, facet);
    if (dot(direction, normal_fs) <= 0.0) {
        return vec3(0.0);
    }
    vec3 reflected = masked * gloss_fresnel(gloss, clamp(dot(to_eye, facet), 0.0, 1.0));
#ifdef OMNI
    if (place.inside && !soft_falloff) {
        return reflected / 3.14159265;  // the ball shines from all sides
    }
#endif
    if (!meets_lamp(p_ws, mat3(face[0].xyz, face[1].xyz, face[2].xyz) * direction)) {
        return vec3(0.0);
    }
#ifdef OMNI
    // a sphere's points may all look away in a round; a spot fades in what it brings, and so does what is seen of it
    float facing = max(-dot(p_fs, normal_fs) * inversesqrt(dot(p_fs, p_fs)), LEAST_FACING);
    return reflected * dot(p_fs, p_fs) / (lamp_area * facing);
#else
    float fading = 1.0;
#ifdef SPREAD
    float cosine = -dot(light_axis_fs, direction);
    fading = max(1.0 - sqrt(max(1.0 - cosine * cosine, 0.0)) / (cosine * tan_half_spread), 0.0);
#endif
    return reflected * fading * reference_squared_distance / (lamp_area * arriving);
#endif
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    float lit = texelFetch(batch_sums, pixel, 0).x;
    if (position.w < 0.0 || lit <= 0.0) {
        return;
    }
    vec4 scattered = texelFetch(scatterings, pixel, 0);
    vec4 glossy = texelFetch(glosses, pixel, 0);
    vec3 sent = scattered.rgb;
    if (dot(glossy.rgb, vec3(1.0)) > 0.0) {
        Gloss gloss = kept_gloss(scattered.w, glossy);
        vec3 p_fs = face_position(position.xyz);
        vec3 normal_fs = face_direction(unpack_direction(texelFetch(normals, pixel, 0).w));
        vec3 to_eye = face_direction(texelFetch(seen_from, pixel, 0).xyz - position.xyz);
        to_eye *= inversesqrt(max(dot(to_eye, to_eye), 1.0e-30));
#ifdef OMNI
        set_place(p_fs);
#endif
        vec3 sum = vec3(0.0);
        float weights = 0.0;
        float distances = 0.0;
        for (int k = 0; k < point_count; k++) {
            vec3 from_light = from_point(k, p_fs);
            float weight = delivered(light_points[k], from_light, normal_fs);
            if (weight > 0.0) {
                float distance = length(from_light);
                sum += weight * gloss_brdf(gloss, normal_fs, to_eye, -from_light / distance, LEAST_LIT_WIDTH);
                weights += weight;
                distances += weight * distance;
            }
        }
#ifdef ORTHOGRAPHIC
        float per_m = 1.0;
#else
        float per_m = weights / max(distances, 1.0e-30);
#endif
        // points would show lobes that are narrower than the lamp as wide as the least width
        float reach = max(point_reach * per_m, min(lamp_extent * per_m, LEAST_LIT_WIDTH));
        if (weights > 0.0) {
            sent += gloss.width < reach ? seen_lamp(gloss, position.xyz, normal_fs, to_eye, p_fs, weights / float(point_count)) : sum / weights;
        }
    }
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(lit * light_rgb * sent, 0.0));
}
