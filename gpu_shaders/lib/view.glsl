// What differs between the views of a face: perspective ones of a lamp, and ORTHOGRAPHIC ones of a sun, in which `texel_tangent` is
// metres. A sun's view looks along the face's axis at a scene sheared by its direction: (x, y) moves by `view_shear` a metre of depth.
// p: from a view's centre.
#include "lib/face.glsl"

// Views of a batch: table `views`, two rows each.
#define view_center(k) (views[2 * (k)].xyz)
#define view_first_row(k) (int(views[2 * (k)].w))
// The same for kernels that have all views of a batch. Software rasterizers look a table up lane by lane, float by float.
#define batch_first_row(k) ((k) * map_size.y)
#define view_window(k) (views[2 * (k) + 1].xy)

#ifdef ORTHOGRAPHIC
#define view_shear(k) (views[2 * (k) + 1].zw)

// In texels from the map's corner.
vec2 map_position(int k, vec3 p) {
    return (p.xy - view_shear(k) * p.z) * texels_per_tangent - view_window(k);
}

// The plane dot(normal_fs, p) = offset on the ray through a place of the map: x / y is its depth, and y is negative where it faces the view.
vec2 plane_on_ray(int k, vec2 place, vec3 normal_fs, float offset) {
    vec2 start = (place + view_window(k)) * texel_tangent;
    return vec2(offset - dot(normal_fs.xy, start), dot(normal_fs, vec3(view_shear(k), 1.0)));
}
#else
vec2 map_position(int k, vec3 p) {
    return p.xy * (texels_per_tangent / p.z) - view_window(k);
}

vec2 plane_on_ray(int k, vec2 place, vec3 normal_fs, float offset) {
    return vec2(offset, dot(normal_fs, vec3((place + view_window(k)) * texel_tangent, 1.0)));
}
#endif
