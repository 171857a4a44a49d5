// Rasterizes small triangles into the maps of a batch, each for all views, by the rules of a hardware rasterizer: a texel is
// covered if its centre is, and its depth is the triangle's there.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/small_triangles.glsl"

// Corners are rounded to this part of a texel. Within SMALL_EXTENT_TEXELS edge functions are then exact in float32,
// so that triangles which share an edge leave no texel between them.
const float SUBTEXELS = 256.0;

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = texelFetch(gathered_triangles, linear_texel(3 * index + i), 0);
    }
    if (corners[0].w == skipped_facing) {
        return;
    }
    // Loops that test at their end: software rasterizers go through those that test at their beginning once more than needed.
    int k = -1;
    int first_row = -map_size.y;
    do {
        k++;
        first_row += map_size.y;
        vec2 at[3];
        vec3 linear;
        for (int i = 0; i < 3; i++) {
            at[i] = floor(place_corner(k, corners[i].xyz, linear[i]) * SUBTEXELS + 0.5);
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
        vec2 center = (low + 0.5) * SUBTEXELS - at[0];
        // barycentric weights of corners 1 and 2 times twice the area; they change by whole numbers from texel to texel
        vec2 first = vec2(center.x * edge_2.y - center.y * edge_2.x, edge_1.x * center.y - edge_1.y * center.x);
        vec2 step_x = SUBTEXELS * vec2(edge_2.y, -edge_1.y);
        vec2 step_y = SUBTEXELS * vec2(-edge_2.x, edge_1.x);
        vec2 rise = (linear.yz - linear.x) / twice_area;
        ivec2 texel = ivec2(low);
        ivec2 size = ivec2(high) - texel + 1;
        int count = size.x * size.y;
        texel.y += first_row;
        float per_row = 1.0 / float(size.x);
        vec2 row = first;
        vec2 weights = row;
        int x = 0;
        int begin = 0;
        // First which texels are covered, then their depths: software rasterizers go through the part with the memory as often as one of
        // several triangles has texels, and few of those around a triangle are covered.
        do {
            uint covered = 0u;
            int i = 0;
            do {
                bool is_covered = min(min(weights.x, weights.y), twice_area - weights.x - weights.y) >= 0.0;
                covered |= is_covered ? 1u << uint(i) : 0u;
                x++;
                weights += step_x;
                if (x == size.x) {
                    x = 0;
                    row += step_y;
                    weights = row;
                }
                i++;
            } while (i < 32 && begin + i < count);
            do {
                float number = float(begin + findLSB(covered));
                float y = floor((number + 0.5) * per_row);
                float column = number - y * float(size.x);
                if (covered != 0u) {
                    uint bits = floatBitsToUint(depth_of(linear.x + dot(rise, first + column * step_x + y * step_y)));
                    ivec2 address = texel + ivec2(column, y);
#ifdef LOOKS_FIRST
                    if (imageLoad(depth_maps, address).x > bits)
#endif
                    {
                        imageAtomicMin(depth_maps, address, bits);
                    }
                }
                covered &= covered - 1u;
            } while (covered != 0u);
            begin += 32;
        } while (begin < count);
    } while (k + 1 < view_count);
}
