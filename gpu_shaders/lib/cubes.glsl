// Cubes of reflectors that share one cloud of triangles and points: table `cubes`, two rows each (core/passes/reflected_points.py).
// Their axes are the world's.
#include "lib/map_faces.glsl"

#define cube_center(k) (cubes[2 * (k)].xyz)
#define texel_tangent(k) (cubes[2 * (k)].w)
#define cube_near_m(k) (cubes[2 * (k) + 1].x)
#define eye_pixel_m(k) (cubes[2 * (k) + 1].y)  // of the eye, at the reflector
#define first_texel(k) (int(cubes[2 * (k) + 1].z))
#define cube_side(k) (int(cubes[2 * (k) + 1].w))

// Linear depth in the face that sees it; p: from the cube's centre.
float face_depth(vec3 p) {
    vec3 size = abs(p);
    return max(size.x, max(size.y, size.z));
}

const float MAX_POINT_TEXELS = 8.0;  // that a sample covers each way: farther apart, samples would leave holes

// How far apart samples of a surface may be, and of what it is at least `radius` nearer: a texel's width or, with EYE_DENSITY, that of
// the eye's pixel at the end of the way by the reflector (Gavane & Watson 2022 b, eq. 2 and 3), where that is larger.
float sample_spacing(int k, vec3 p, float radius) {
    float texel_m = max(face_depth(p) - radius, cube_near_m(k)) * texel_tangent(k);
#ifdef EYE_DENSITY
    return clamp(eye_pixel_m(k) + eye_pixel_angle * max(length(p) - radius, 0.0), texel_m, MAX_POINT_TEXELS * texel_m);
#else
    return texel_m;
#endif
}

// What the kernels say of a triangle or point in the spare places of its texels: its number among all triangles of the work table, 16 random bits and its instance.
struct Owner {
    uint number;
    float random;  // below 1
    int instance;
};

vec3 pack_owner(Owner owner) {
    uint random = uint(owner.random * 65536.0);
    uvec2 halves = uvec2(owner.number & 0xffffu, owner.number >> 16u);
    return vec3(halves | uvec2(random & 0xffu, random >> 8u) << 16u, float(owner.instance));
}

Owner unpack_owner(vec3 bits) {
    uvec2 halves = uvec2(bits.xy);
    float random = float((halves.x >> 16u) | (halves.y >> 16u) << 8u) / 65536.0;
    return Owner((halves.x & 0xffffu) | (halves.y & 0xffffu) << 16u, random, int(bits.z));
}
