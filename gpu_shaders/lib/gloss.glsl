// What is kept of how a surface that rays met shines, until lights look it up: one lobe, the coat's or that below it, whichever reflects
// more. What it is multiplied by on its way to the eye is in it; where that is coloured, its rim at grazing angles is gray. The rest is
// lib/brdf.glsl's.
#include "lib/microfacets.glsl"

struct Gloss {
    vec3 straight_on;  // reflectance for light straight on, with what bounces between microfacets
    float grazing;     // the same at grazing angles
    float width;       // GGX alpha
    bool is_metal;     // how one becomes the other
};

const float USUAL_IOR = 1.5;

vec3 gloss_fresnel(Gloss gloss, float to_half) {
    float curve = gloss.is_metal ? fifth_power(1.0 - to_half) : dielectric_curve(to_half, USUAL_IOR);
    return mix(gloss.straight_on, vec3(gloss.grazing), curve);
}

// Radiance towards the eye over irradiance from a direction. Unit vectors in one space; least_width: as of brdf()
vec3 gloss_brdf(Gloss gloss, vec3 normal, vec3 to_eye, vec3 to_light, float least_width) {
    vec3 along_half = to_eye + to_light;
    along_half *= inversesqrt(max(dot(along_half, along_half), 1e-12));
    float cos_eye = max(dot(normal, to_eye), LEAST_COSINE);
    float cos_light = max(dot(normal, to_light), LEAST_COSINE);
    float shape = ggx(max(gloss.width, least_width), clamp(dot(normal, along_half), 0.0, 1.0), cos_eye, cos_light);
    return shape * gloss_fresnel(gloss, clamp(dot(to_light, along_half), 0.0, 1.0));
}

// Its two texels: rgb the diffuse lobe, with the grazing reflectance (negative: metal's); the gloss, with its width (negative: another ray
// follows).
const float LEAST_KEPT = 1.0e-6;  // signs say something

void keep_gloss(Gloss gloss, bool is_followed, out float grazing, out vec4 glossy) {
    grazing = max(gloss.grazing, LEAST_KEPT) * (gloss.is_metal ? -1.0 : 1.0);
    glossy = vec4(gloss.straight_on, max(gloss.width, LEAST_KEPT) * (is_followed ? -1.0 : 1.0));
}

Gloss kept_gloss(float grazing, vec4 glossy) {
    return Gloss(glossy.rgb, abs(grazing), abs(glossy.w), grazing < 0.0);
}
