// Writes a point of a triangle into the depth maps of all views of the batch.
#include "lib/face.glsl"

// A point lies anywhere in its texel, the stored depth belongs to the texel's centre: the triangle's plane is followed
// to there, as a rasterizer would, within limits because beyond the triangle's edge the plane is a guess. Away from the light it
// may lead far: a steep surface's nearest point would otherwise stand for its whole texel and shadow the surface itself.
const float MAX_SHIFT_NEARER_FOOTPRINTS = 0.5;
const float MAX_SHIFT_DEEPER_FOOTPRINTS = 16.0;

void splat(vec3 p_fs, vec3 normal_fs) {
    float reach_share = footprint_share;
    for (int k = 0; k < view_count; k++) {
        vec3 p = p_fs - view_center(k);
        if (p.z <= near_m) {
            continue;
        }
        vec2 at = p.xy * (texels_per_tangent / p.z) - view_window(k);
        float footprint_texels = sampled_depth(p.z) / p.z;
        int around = int(ceil(0.5 * (footprint_texels - 1.0)));
        ivec2 texel = ivec2(floor(at));
        if (any(lessThan(texel + around, ivec2(0))) || any(greaterThanEqual(texel - around, map_size))) {
            continue;
        }
        ivec2 low = max(texel - around, ivec2(0));
        ivec2 high = min(texel + around, map_size - 1);
        float plane_offset = dot(normal_fs, p);
        float reach = reach_share * p.z * footprint_texels;
        for (int y = low.y; y <= high.y; y++) {
            for (int x = low.x; x <= high.x; x++) {
                vec3 ray = vec3((vec2(x, y) + 0.5 + view_window(k)) * texel_tangent, 1.0);
                float facing = dot(normal_fs, ray);
                // edge-on triangles have no depth at the centre: the division is kept finite and the clamp decides
                float plane_depth = plane_offset / (abs(facing) > 1e-6 ? facing : 1e-6);
                uint bits = floatBitsToUint(max(clamp(plane_depth, p.z - MAX_SHIFT_NEARER_FOOTPRINTS * reach, p.z + MAX_SHIFT_DEEPER_FOOTPRINTS * reach), near_m));
                ivec2 address = ivec2(x, y + view_first_row(k));
                // most points are hidden or repeat a texel: looking first is cheaper than an atomic
                if (imageLoad(depth_maps, address).x > bits) {
                    imageAtomicMin(depth_maps, address, bits);
                }
            }
        }
    }
}
