// How a Surface reflects (lib/material.glsl), as Blender's Principled BSDF does: GGX lobes with Smith's height-correlated masking, what
// bounces between microfacets given back, a diffuse lobe under the dielectric one, a clear coat over all.
// Means over lobes come from core/reflectance_table.py.
#include "lib/material.glsl"
#include "lib/gloss.glsl"

// What the table knows of a lobe, seen under a cosine.
struct Lobe {
    float albedo;       // without a Fresnel term
    float mean_albedo;  // of all directions
    float schlick;      // mean of (1 - c)^5
    float f82;          // mean of c (1 - c)^6
    vec4 curve;         // of the dielectric curve, as a cubic in z
};

Lobe lobe_of(float roughness, float cosine) {
    vec2 place = clamp(vec2(cosine, roughness), 0.0, 1.0) * vec2(COSINE_COUNT - 1, ROUGHNESS_COUNT - 1);
    ivec2 low = min(ivec2(place), ivec2(COSINE_COUNT - 2, ROUGHNESS_COUNT - 2));
    vec2 share = place - vec2(low);
    vec4 means = vec4(0.0);
    vec4 curve = vec4(0.0);
    for (int k = 0; k < 4; k++) {
        ivec2 corner = ivec2(k & 1, k >> 1);
        vec2 weights = mix(1.0 - share, share, vec2(corner));
        int texel = TABLE_TEXELS * ((low.y + corner.y) * COSINE_COUNT + low.x + corner.x);
        means += weights.x * weights.y * texelFetch(surface_data, linear_texel(texel), 0);
        curve += weights.x * weights.y * texelFetch(surface_data, linear_texel(texel + 1), 0);
    }
    return Lobe(means.x, means.w, means.y, means.z, curve);
}

// A surface's own and its coat's, which is anything where there is none. Asked for once: every look-up is compiled into its kernel.
struct Lobes {
    Lobe base;
    Lobe coat;
};

Lobes lobes_of(Surface s, float cosine) {
    Lobes lobes;
    lobes.base = lobe_of(s.roughness, cosine);
    lobes.coat = lobes.base;
    if (s.coat_weight > 0.0) {
        lobes.coat = lobe_of(s.coat_roughness, cosine);
    }
    return lobes;
}

float mean_dielectric_curve(Lobe lobe, float ior) {
    float z = sqrt((ior - 1.0) / (ior + 1.0));
    float at = clamp(z, LEAST_Z, LARGEST_Z);
    float mean = lobe.curve.x + at * (lobe.curve.y + at * (lobe.curve.z + at * lobe.curve.w));
    return clamp(mean * min(z / LEAST_Z, 1.0), 0.0, 1.0);
}

// What the F82 tint takes from Schlick's curve, to be multiplied with c (1 - c)^6: the curve is tinted where c = 1/7.
vec3 f82_dip(Surface s) {
    vec3 schlick = mix(s.metal, vec3(1.0), 0.46266436);  // (6/7)^5
    return schlick * 17.651328 * (1.0 - s.specular_tint);  // 7 / (6/7)^6
}

vec3 metal_fresnel(Surface s, float fifth, float sixth) {
    if (!s.metal_fresnel) {
        return s.metal;
    }
    return clamp(mix(s.metal, vec3(1.0), fifth) - f82_dip(s) * sixth, 0.0, 1.0);
}

vec3 dielectric_fresnel(Surface s, float curve) {
    return mix(s.specular_tint * reflectance_straight_on(s.ior), vec3(1.0), curve);
}

// Averages over all directions, of what bounces between microfacets (Kulla & Conty 2017).
vec3 mean_metal_fresnel(Surface s) {
    return metal_fresnel(s, 1.0 / 21.0, 1.0 / 126.0);
}

float mean_fresnel(float ior) {
    return (ior - 1.0) / (4.08567 + 1.00071 * ior);
}

vec3 mean_dielectric_fresnel(Surface s) {
    float straight_on = reflectance_straight_on(s.ior);
    return dielectric_fresnel(s, clamp((mean_fresnel(s.ior) - straight_on) / (1.0 - straight_on), 0.0, 1.0));
}

// By what a lobe is brighter than with one bounce alone.
vec3 multiple_bounces(Lobe lobe, vec3 mean_fresnel) {
    vec3 again = mean_fresnel * lobe.mean_albedo / max(1.0 - mean_fresnel * (1.0 - lobe.mean_albedo), vec3(1e-4));
    return 1.0 + again * (1.0 - lobe.albedo) / lobe.albedo;
}

vec3 dielectric_albedo(Surface s, Lobe lobe) {
    vec3 once = dielectric_fresnel(s, mean_dielectric_curve(lobe, s.ior));
    return s.dielectric_weight * lobe.albedo * once * multiple_bounces(lobe, mean_dielectric_fresnel(s));
}

vec3 metal_albedo(Surface s, Lobe lobe) {
    return s.metal_weight * lobe.albedo * metal_fresnel(s, lobe.schlick, lobe.f82) * multiple_bounces(lobe, mean_metal_fresnel(s));
}

float coat_albedo(Surface s, Lobes lobes) {
    if (s.coat_weight <= 0.0) {
        return 0.0;
    }
    float once = mix(reflectance_straight_on(s.coat_ior), 1.0, mean_dielectric_curve(lobes.coat, s.coat_ior));
    return s.coat_weight * lobes.coat.albedo * once * multiple_bounces(lobes.coat, vec3(mean_fresnel(s.coat_ior))).x;
}

float largest(vec3 v) {
    return max(v.x, max(v.y, v.z));
}

// Which share of light from everywhere the lobes (not the diffuse one) send to the eye: what a reflection is multiplied by.
// lobes: under the cosine of the direction to the eye, here and below
vec3 reflection_color(Surface s, Lobes lobes) {
    float coat = coat_albedo(s, lobes);
    return coat + (1.0 - coat) * (dielectric_albedo(s, lobes.base) + metal_albedo(s, lobes.base));
}

// The dielectric and the metallic lobe's Fresnel reflectances for light under a cosine to the microfacet, with their weights.
vec3 lobe_fresnel(Surface s, Lobe lobe, float to_half) {
    vec3 reflected = vec3(0.0);
    if (s.dielectric_weight > 0.0) {
        vec3 fresnel = dielectric_fresnel(s, dielectric_curve(to_half, s.ior));
        reflected += s.dielectric_weight * fresnel * multiple_bounces(lobe, mean_dielectric_fresnel(s));
    }
    if (s.metal_weight > 0.0) {
        float rest = 1.0 - to_half;
        float fifth = rest * rest * rest * rest * rest;
        reflected += s.metal_weight * metal_fresnel(s, fifth, to_half * fifth * rest) * multiple_bounces(lobe, mean_metal_fresnel(s));
    }
    return reflected;
}

// Of the lobe that reflects most: where there is a coat, that over a rough surface is what shows mirror images.
float reflection_roughness(Surface s, Lobes lobes) {
    float coat = coat_albedo(s, lobes);
    vec3 below = (1.0 - coat) * (dielectric_albedo(s, lobes.base) + metal_albedo(s, lobes.base));
    return coat > largest(below) ? s.coat_roughness : s.roughness;
}

// Radiance towards the eye over irradiance from a direction. Unit vectors; the normal is the surface's.
// least_width: GGX alpha that lobes have at least. A light that is sampled at few points would otherwise leave each of them as a spark.
vec3 brdf(Surface s, vec3 to_eye, vec3 to_light, float least_width) {
    float cos_light = dot(s.normal_ws, to_light);
    if (cos_light <= 0.0) {
        return vec3(0.0);
    }
    // shading normals may turn away from an eye that sees the surface
    float cos_eye = max(dot(s.normal_ws, to_eye), LEAST_COSINE);
    cos_light = max(cos_light, LEAST_COSINE);
    vec3 along_half = to_eye + to_light;
    along_half *= inversesqrt(max(dot(along_half, along_half), 1e-12));
    float cos_half = clamp(dot(s.normal_ws, along_half), 0.0, 1.0);
    float to_half = clamp(dot(to_light, along_half), 0.0, 1.0);

    Lobes lobes = lobes_of(s, cos_eye);
    float base = ggx(max(s.roughness * s.roughness, least_width), cos_half, cos_eye, cos_light);
    vec3 reflected = base * lobe_fresnel(s, lobes.base, to_half);
    vec3 under = s.dielectric_weight > 0.0 ? vec3(1.0 - largest(dielectric_albedo(s, lobes.base))) : vec3(1.0);
    reflected += max(under, 0.0) * s.diffuse / 3.14159265;
    if (s.coat_weight > 0.0) {
        float width = max(s.coat_roughness * s.coat_roughness, least_width);
        float fresnel = mix(reflectance_straight_on(s.coat_ior), 1.0, dielectric_curve(to_half, s.coat_ior));
        fresnel *= multiple_bounces(lobes.coat, vec3(mean_fresnel(s.coat_ior))).x;
        reflected = (1.0 - coat_albedo(s, lobes)) * reflected + s.coat_weight * fresnel * ggx(width, cos_half, cos_eye, cos_light);
    }
    return reflected;
}

// throughput: what light from the surface is multiplied by
Gloss gloss_of(Surface s, vec3 throughput, Lobes lobes) {
    Lobe lobe = lobes.base;
    float coat = coat_albedo(s, lobes);
    vec3 dielectric = (1.0 - coat) * dielectric_albedo(s, lobe);
    vec3 metal = (1.0 - coat) * metal_albedo(s, lobe);
    vec3 straight_on = (1.0 - coat) * lobe_fresnel(s, lobe, 1.0);
    vec3 grazing = (1.0 - coat) * lobe_fresnel(s, lobe, 0.0);
    bool is_metal = largest(metal) > largest(dielectric);
    if (coat > largest(dielectric + metal)) {
        float brighter = s.coat_weight * multiple_bounces(lobes.coat, vec3(mean_fresnel(s.coat_ior))).x;
        straight_on = vec3(brighter * reflectance_straight_on(s.coat_ior));
        grazing = vec3(brighter);
        is_metal = false;
    }
    float roughness = reflection_roughness(s, lobes);
    return Gloss(throughput * straight_on, dot(throughput * grazing, vec3(1.0 / 3.0)), roughness * roughness, is_metal);
}

// What a surface sends to the eye of its own.
vec3 emitted(Surface s, Lobes lobes) {
    return (1.0 - coat_albedo(s, lobes)) * s.emission;
}
