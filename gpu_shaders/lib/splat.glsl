// Writes a point of a triangle into the depth maps of all views of the batch.
#include "lib/octahedral.glsl"
#include "lib/view.glsl"

// A point lies anywhere in its texel, the stored depth belongs to the texel's centre: the triangle's plane is followed
// to there, as a rasterizer would, within limits because beyond the triangle's edge the plane is a guess. Away from the light it
// may lead far: a steep surface's nearest point would otherwise stand for its whole texel and shadow the surface itself.
const float MAX_SHIFT_NEARER_FOOTPRINTS = 0.5;
const float MAX_SHIFT_DEEPER_FOOTPRINTS = 16.0;

uint depth_bits_at(int k, ivec2 texel, float z, vec3 normal_fs, float plane_offset, float footprint) {
    vec2 plane = plane_on_ray(k, vec2(texel) + 0.5, normal_fs, plane_offset);
    // edge-on triangles have no depth at the centre: the division is kept finite and the clamp decides
    float plane_depth = plane.x / (abs(plane.y) > 1e-6 ? plane.y : 1e-6);
    float nearest = max(z - MAX_SHIFT_NEARER_FOOTPRINTS * footprint, near_m);
    uint bits = floatBitsToUint(clamp(plane_depth, nearest, z + MAX_SHIFT_DEEPER_FOOTPRINTS * footprint));
#ifdef MIXED_MAPS
    bits |= 1u;
#endif
    return bits;
}

void write_bits(ivec2 address, uint bits) {
    // most points are hidden or repeat a texel: looking first is cheaper than an atomic
    if (imageLoad(depth_maps, address).x > bits) {
        imageAtomicMin(depth_maps, address, bits);
    }
}

void write_depth(int k, ivec2 texel, float z, vec3 normal_fs, float plane_offset, float footprint) {
    write_bits(ivec2(texel.x, texel.y + view_first_row(k)), depth_bits_at(k, texel, z, normal_fs, plane_offset, footprint));
}

#ifdef LOCAL_CULLING
const uint NOWHERE = 0xffffffffu;

// Where a view has a point, and the depth that it would write there; NOWHERE if the map does not show it.
uint place_point(int k, vec3 p_fs, vec3 normal_fs, out ivec2 address) {
    vec3 p = p_fs - view_center(k);
    ivec2 texel = ivec2(floor(map_position(k, vec3(p.xy, max(p.z, near_m)))));
    address = texel + ivec2(0, view_first_row(k));
    bool shown = p.z > near_m && all(greaterThanEqual(texel, ivec2(0))) && all(lessThan(texel, map_size));
    return shown ? depth_bits_at(k, texel, p.z, normal_fs, dot(normal_fs, p), footprint_at(p.z)) : NOWHERE;
}
#endif

void splat(vec3 p_fs, vec3 normal_fs) {
#ifdef INTO_MAPS
    // rounded as in the point buffer: both ways of storing points make the same maps
    normal_fs = unpack_direction(pack_direction(normal_fs));
#endif
#ifdef FRONT_FACE
    // all views lie in the plane that the face looks away from: a point is equally deep before each
    if (p_fs.z <= near_m) {
        return;
    }
    vec2 texels_per_metre = texels_per_tangent / p_fs.z;
    float plane_constant = dot(normal_fs, p_fs);
    float footprint = footprint_at(p_fs.z);
#endif
    for (int k = 0; k < view_count; k++) {
#ifdef FRONT_FACE
        vec4 view = views[2 * k + 1];
        float z = p_fs.z;
        ivec2 texel = ivec2(floor((p_fs.xy - view.zw) * texels_per_metre - view.xy));
        float plane_offset = plane_constant - dot(normal_fs.xy, view.zw);
#else
        vec3 p = p_fs - view_center(k);
        float z = p.z;
        if (z <= near_m) {
            continue;
        }
        ivec2 texel = ivec2(floor(map_position(k, p)));
        float plane_offset = dot(normal_fs, p);
        float footprint = footprint_at(z);
#endif
#ifdef NEAR_SURFACES
        float footprint_texels = sampled_depth(z) / z;
        int around = int(ceil(0.5 * (footprint_texels - 1.0)));
        ivec2 low = max(texel - around, ivec2(0));
        ivec2 high = min(texel + around, map_size - 1);
        for (int y = low.y; y <= high.y; y++) {
            for (int x = low.x; x <= high.x; x++) {
                write_depth(k, ivec2(x, y), z, normal_fs, plane_offset, footprint * footprint_texels);
            }
        }
#else
        if (all(greaterThanEqual(texel, ivec2(0))) && all(lessThan(texel, map_size))) {
            write_depth(k, texel, z, normal_fs, plane_offset, footprint);
        }
#endif
    }
}
