// The list of small triangles: corners prepared so that a view places them with few operations (see gather_triangles.comp.glsl).
#include "lib/view.glsl"

// In texels from the map's corner. linear: what is linear on the map, 1 / depth or, of suns, depth.
vec2 place_corner(int k, vec3 corner, out float linear) {
#ifdef ORTHOGRAPHIC
    linear = corner.z;
    return corner.xy - (view_center(k).xy + view_shear(k) * corner.z) * texels_per_tangent - view_window(k);
#else
#ifdef FRONT_FACE
    linear = corner.z;
    return corner.xy - (view_center(k).xy * texels_per_tangent) * corner.z - view_window(k);
#else
    vec3 p = corner - view_center(k);
    linear = 1.0 / p.z;
    return map_position(k, p);
#endif
#endif
}

#ifdef BLOCK_TEXELS
// Of the batch's first map, where a triangle's first corner is; beyond the map's edges the nearest.
int block_of(vec3 corner) {
    float linear;
    ivec2 block = ivec2(clamp(place_corner(0, corner, linear), vec2(0.0), vec2(map_size - 1))) / BLOCK_TEXELS;
    return block.y * ((map_size.x + BLOCK_TEXELS - 1) / BLOCK_TEXELS) + block.x;
}
#endif

float depth_of(float linear) {
#ifdef ORTHOGRAPHIC
    return linear;
#else
    return 1.0 / linear;
#endif
}
