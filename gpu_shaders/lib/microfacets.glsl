// GGX microfacets with Smith's height-correlated masking, and what each reflects.

const float LEAST_COSINE = 1e-3;

float smith(float width, float cosine) {
    return 0.5 * (sqrt(1.0 + width * width * (1.0 / (cosine * cosine) - 1.0)) - 1.0);
}

// Distribution and masking of a lobe over 4 cos cos. width: GGX alpha
float ggx(float width, float cos_half, float cos_eye, float cos_light) {
    float squared = width * width;
    float falloff = cos_half * cos_half * (squared - 1.0) + 1.0;
    float distribution = squared / (3.14159265 * falloff * falloff);
    return distribution / ((1.0 + smith(width, cos_eye) + smith(width, cos_light)) * 4.0 * cos_eye * cos_light);
}

float reflectance_straight_on(float ior) {
    float root = (ior - 1.0) / (ior + 1.0);
    return root * root;
}

// Of unpolarized light that meets a denser medium: between its value straight on and 1 at grazing angles, as a share of the way.
float dielectric_curve(float cosine, float ior) {
    float straight_on = reflectance_straight_on(ior);
    float g = sqrt(max(ior * ior - 1.0 + cosine * cosine, 0.0));
    float first = (g - cosine) / max(g + cosine, 1e-6);
    float second = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0);
    return clamp((0.5 * first * first * (1.0 + second * second) - straight_on) / (1.0 - straight_on), 0.0, 1.0);
}

// Schlick's (1994), of metals.
float fifth_power(float x) {
    return x * x * x * x * x;
}
