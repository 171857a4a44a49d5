// A picture of COMBINE_PASSES over what Blender has drawn, which is display-referred.

// Between the centres of its pixels linear: the picture may be coarser than the viewport.
vec3 picture_at(vec2 place_px) {
    vec2 corner_px = place_px * picture_size / viewport_size - 0.5;
    ivec2 first = ivec2(floor(corner_px));
    vec2 share = corner_px - vec2(first);
    ivec2 last = ivec2(picture_size) - 1;
    vec3 low = mix(
        texelFetch(picture, clamp(first, ivec2(0), last), 0).xyz,
        texelFetch(picture, clamp(first + ivec2(1, 0), ivec2(0), last), 0).xyz, share.x);
    vec3 high = mix(
        texelFetch(picture, clamp(first + ivec2(0, 1), ivec2(0), last), 0).xyz,
        texelFetch(picture, clamp(first + ivec2(1, 1), ivec2(0), last), 0).xyz, share.x);
    return mix(low, high, share.y);
}

void main() {
    vec3 sums = picture_at(gl_FragCoord.xy - viewport_origin);
    float ratio = sums.y > 0.0 ? clamp(sums.x / sums.y, 0.0, 1.0) : 1.0 - sums.z;
    if (multiplies != 0) {
        // a factor of light becomes one of display values, as if these were a power of light
        overlaid = vec4(0.0, 0.0, 0.0, 1.0 - pow(ratio, 1.0 / 2.2));
    } else {
        // what Blender draws overlays into encodes what is written
        overlaid = vec4(vec3(ratio), 1.0);
    }
}
