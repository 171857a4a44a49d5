// A picture of passes over what Blender has drawn. What is written is light as the display shows it: Blender lays it over what the view
// transform has made of the scene before it encodes both. Alpha says what it covers, and colours are multiplied with it.

// Linear between the centres of pixels: a picture may be coarser than the viewport.
vec4 texel_at(sampler2D image, vec2 place) {
    ivec2 size = textureSize(image, 0);
    vec2 corner = place * vec2(size) - 0.5;
    ivec2 first = ivec2(floor(corner));
    vec2 share = corner - vec2(first);
    ivec2 low = clamp(first, ivec2(0), size - 1);
    ivec2 high = clamp(first + 1, ivec2(0), size - 1);
    vec4 below = mix(texelFetch(image, low, 0), texelFetch(image, ivec2(high.x, low.y), 0), share.x);
    vec4 above = mix(texelFetch(image, ivec2(low.x, high.y), 0), texelFetch(image, high, 0), share.x);
    return mix(below, above, share.y);
}

// Of light that is not shadowed: shadowed and delivered light, and the share of surfaces.
float ratio_at(sampler2D sums, vec2 place) {
    if (has_shadows == 0) {
        return 1.0;
    }
    vec4 found = texel_at(sums, place);
    return found.y > 0.0 ? clamp(found.x / found.y, 0.0, 1.0) : 1.0 - found.z;
}

vec4 reflection_at(sampler2D image, vec2 place) {
    return has_reflections != 0 ? max(texel_at(image, place), vec4(0.0)) : vec4(0.0);
}

// Both as one picture that is looked at alone: shadows in grey.
vec3 pass_of(float ratio, vec4 reflection) {
    return (has_shadows != 0 ? vec3(ratio) : vec3(0.0)) + reflection.rgb;
}

void main() {
    vec2 place = (gl_FragCoord.xy - viewport_origin) / viewport_size;
    float ratio = ratio_at(shadows, place);
    vec4 reflection = reflection_at(reflections, place);
    if (display == DISPLAY_MULTIPLY) {
        overlaid = vec4(reflection.rgb, 1.0 - ratio * (1.0 - reflection.a));
    } else if (display == DISPLAY_PASS) {
        overlaid = vec4(pass_of(ratio, reflection), 1.0);
    } else {
        vec3 before = pass_of(ratio_at(reference_shadows, place), reflection_at(reference_reflections, place));
        float change = dot(pass_of(ratio, reflection) - before, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE));
        float strength = min(sqrt(abs(change)), 1.0);
        overlaid = vec4((change > 0.0 ? vec3(1.0, 0.3, 0.02) : vec3(0.02, 0.2, 1.0)) * strength, strength);
    }
}
