// A picture of COMBINE_PASSES over what Blender has drawn, which is display-referred.

// Shadowed and delivered light and the share of surfaces, linear between the centres of pixels: a picture may be coarser than the viewport.
vec3 sums_at(sampler2D sums, vec2 place) {
    ivec2 size = textureSize(sums, 0);
    vec2 corner = place * vec2(size) - 0.5;
    ivec2 first = ivec2(floor(corner));
    vec2 share = corner - vec2(first);
    ivec2 low = clamp(first, ivec2(0), size - 1);
    ivec2 high = clamp(first + 1, ivec2(0), size - 1);
    vec3 below = mix(texelFetch(sums, low, 0).xyz, texelFetch(sums, ivec2(high.x, low.y), 0).xyz, share.x);
    vec3 above = mix(texelFetch(sums, ivec2(low.x, high.y), 0).xyz, texelFetch(sums, high, 0).xyz, share.x);
    return mix(below, above, share.y);
}

float ratio_at(sampler2D sums, vec2 place) {
    vec3 found = sums_at(sums, place);
    return found.y > 0.0 ? clamp(found.x / found.y, 0.0, 1.0) : 1.0 - found.z;
}

void main() {
    vec2 place = (gl_FragCoord.xy - viewport_origin) / viewport_size;
    float ratio = ratio_at(picture, place);
    if (display == DISPLAY_MULTIPLY) {
        // a factor of light becomes one of display values, as if these were a power of light
        overlaid = vec4(0.0, 0.0, 0.0, 1.0 - pow(ratio, 1.0 / 2.2));
    } else if (display == DISPLAY_PASS) {
        // what Blender draws overlays into encodes what is written
        overlaid = vec4(vec3(ratio), 1.0);
    } else {
        float change = ratio - ratio_at(reference, place);
        overlaid = vec4(change > 0.0 ? vec3(1.0, 0.3, 0.02) : vec3(0.02, 0.2, 1.0), sqrt(abs(change)));
    }
}
