// What shaded, mip-mapped cubes show in rays' directions, filtered over as much as lies between rays of neighbouring pixels.
#include "lib/reflection_map.glsl"
#include "lib/tiles.glsl"

vec3 shaded_texel(ReflectionMap map, int level, int face, ivec2 cell) {
    ivec2 within = clamp(cell, ivec2(0), (map.size >> level) - 1);
    return texelFetch(shaded, linear_texel(map_index(map, level, face, within)), 0).rgb;
}

vec3 between_texels(ReflectionMap map, int level, int face, vec2 tangent) {
    vec2 place = (tangent - map.corner) / (map.texel * float(1 << level)) - 0.5;
    ivec2 cell = ivec2(floor(place));
    vec2 share = place - vec2(cell);
    vec3 low = mix(shaded_texel(map, level, face, cell), shaded_texel(map, level, face, cell + ivec2(1, 0)), share.x);
    vec3 high = mix(shaded_texel(map, level, face, cell + ivec2(0, 1)), shaded_texel(map, level, face, cell + ivec2(1, 1)), share.x);
    return mix(low, high, share.y);
}

// Of the rays of two neighbours on opposite sides, how far the nearer one is turned away; nothing where neither is of the same map.
float turned_away(ivec2 pixel, ivec2 side, vec4 origin, vec3 direction) {
    float least = 2.0;
    for (int k = -1; k <= 1; k += 2) {
        ivec2 other = clamp(pixel + k * side, ivec2(0), ivec2(width, height) - 1);
        if (other != pixel && texelFetch(ray_origins, other, 0).w == origin.w) {
            least = min(least, length(texelFetch(ray_directions, other, 0).xyz - direction));
        }
    }
    return least < 2.0 ? least : 0.0;
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 origin = texelFetch(ray_origins, pixel, 0);
    vec3 found = vec3(0.0);
    if (origin.w >= 0.0) {
        ReflectionMap map = load_map(int(origin.w));
        vec3 direction = texelFetch(ray_directions, pixel, 0).xyz;
        vec3 p = map_direction(map, direction);
        int face = face_of(map, p);
        vec3 f = in_face(face, p);
        float angle = max(turned_away(pixel, ivec2(1, 0), origin, direction), turned_away(pixel, ivec2(0, 1), origin, direction));
        float level = clamp(log2(max(angle / (f.z * f.z * map.texel.x), 1.0)), 0.0, float(MAP_LEVELS - 1));
        int finer = min(int(level), MAP_LEVELS - 2);
        vec2 tangent = f.xy / f.z;
        found = mix(between_texels(map, finer, face, tangent), between_texels(map, finer + 1, face, tangent), level - float(finer));
        found *= texelFetch(throughputs, pixel, 0).rgb;
    }
    imageStore(radiances, pixel, vec4(found, 0.0));
}
