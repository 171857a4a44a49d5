// Rasterizes small triangles into the maps of a batch, each for all views, by the rules of a hardware rasterizer: a texel is
// covered if its centre is, and its depth is the triangle's there.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/face.glsl"

// Corners are rounded to this part of a texel. Within SMALL_EXTENT_TEXELS edge functions are then exact in float32,
// so that triangles which share an edge leave no texel between them.
const float SUBTEXELS = 256.0;

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec3 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(gathered_triangles, linear_texel(3 * index + i), 0).xyz;
    }
    for (int k = 0; k < view_count; k++) {
        vec2 at[3];
        vec3 inverse_depth;
        for (int i = 0; i < 3; i++) {
#ifdef FRONT_FACE
            inverse_depth[i] = corners[i].z;
            vec2 texels = corners[i].xy - (view_center(k).xy * texels_per_tangent) * corners[i].z;
#else
            vec3 p = corners[i] - view_center(k);
            inverse_depth[i] = 1.0 / p.z;
            vec2 texels = p.xy * texels_per_tangent * inverse_depth[i];
#endif
            at[i] = floor((texels - view_window(k)) * SUBTEXELS + 0.5);
        }
        vec2 low = max(ceil(min(min(at[0], at[1]), at[2]) / SUBTEXELS - 0.5), 0.0);
        vec2 high = min(floor(max(max(at[0], at[1]), at[2]) / SUBTEXELS - 0.5), vec2(map_size - 1));
        vec2 edge_1 = at[1] - at[0];
        vec2 edge_2 = at[2] - at[0];
        float twice_area = edge_1.x * edge_2.y - edge_1.y * edge_2.x;
        if (any(greaterThan(low, high)) || twice_area == 0.0) {
            continue;
        }
        // either side of a triangle casts: both windings count
        float winding = sign(twice_area);
        edge_1 *= winding;
        edge_2 *= winding;
        twice_area *= winding;
        vec2 first = (low + 0.5) * SUBTEXELS - at[0];
        // barycentric weights of corners 1 and 2 times twice the area; they change by whole numbers from texel to texel
        vec2 row = vec2(first.x * edge_2.y - first.y * edge_2.x, edge_1.x * first.y - edge_1.y * first.x);
        vec2 step_x = SUBTEXELS * vec2(edge_2.y, -edge_1.y);
        vec2 step_y = SUBTEXELS * vec2(-edge_2.x, edge_1.x);
        vec2 depth_rise = (inverse_depth.yz - inverse_depth.x) / twice_area;
        ivec2 texel = ivec2(low);
        ivec2 size = ivec2(high) - texel + 1;
        vec2 weights = row;
        int x = 0;
        int count = size.x * size.y;
        texel.y += view_first_row(k);
        for (int i = 0; i < count; i++) {
            if (min(weights.x, weights.y) >= 0.0 && weights.x + weights.y <= twice_area) {
                uint bits = floatBitsToUint(1.0 / (inverse_depth.x + dot(depth_rise, weights)));
                ivec2 address = ivec2(texel.x + x, texel.y);
                // much is hidden: looking first is cheaper than an atomic
                if (imageLoad(depth_maps, address).x > bits) {
                    imageAtomicMin(depth_maps, address, bits);
                }
            }
            x++;
            weights += step_x;
            if (x == size.x) {
                x = 0;
                row += step_y;
                weights = row;
                texel.y++;
            }
        }
    }
}
