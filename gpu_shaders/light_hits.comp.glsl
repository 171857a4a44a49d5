// Adds what one light brings to the surfaces that rays met: what arrives, as RESOLVE has it with shadows, times what the surface sends on
// of it, the mean over points of the light of what it would send on without shadows.
#include "lib/tiles.glsl"
#include "lib/octahedral.glsl"
#include "lib/delivered.glsl"
#include "lib/gloss.glsl"

#ifdef ORTHOGRAPHIC
#define from_point(k, p_fs) (light_points[k].xyz)
#else
#define from_point(k, p_fs) (p_fs - light_points[k].xyz)
#endif

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
        for (int k = 0; k < point_count; k++) {
            vec3 from_light = from_point(k, p_fs);
            float weight = delivered(light_points[k], from_light, normal_fs);
            if (weight > 0.0) {
                float inverse = inversesqrt(dot(from_light, from_light));
#ifdef ORTHOGRAPHIC
                float least_width = point_spacing;
#else
                float least_width = point_spacing * inverse;
#endif
                sum += weight * gloss_brdf(gloss, normal_fs, to_eye, -inverse * from_light, clamp(least_width, LEAST_LIT_WIDTH, 1.0));
                weights += weight;
            }
        }
        sent += weights > 0.0 ? sum / weights : vec3(0.0);
    }
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(lit * light_rgb * sent, 0.0));
}
