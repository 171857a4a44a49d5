// Splats the tiles of large triangles into the cubes of a batch, an invocation a row.
#include "lib/linear_invocation.glsl"
#include "lib/splat_reflected.glsl"
#include "lib/face_triangle.glsl"

void main() {
    int invocation = linear_invocation();
    if (invocation >= TILE_TEXELS * tile_count) {
        return;
    }
    vec4 tile = texelFetch(tiles, linear_texel(invocation / TILE_TEXELS), 0);
    int index = int(tile.x);
    int k = int(tile.y) >> 3;
    int face = int(tile.y) & 7;
    vec4 a = texelFetch(cloud_triangles, linear_texel(3 * index), 0);
    vec4 b = texelFetch(cloud_triangles, linear_texel(3 * index + 1), 0);
    vec4 c = texelFetch(cloud_triangles, linear_texel(3 * index + 2), 0);
    Owner owner = unpack_owner(vec3(a.w, b.w, c.w));
    FaceTriangle t = on_face(k, face, a.xyz - cube_center(k), b.xyz - cube_center(k), c.xyz - cube_center(k));
    ivec2 first = TILE_TEXELS * ivec2(tile.zw) + ivec2(0, invocation % TILE_TEXELS);
    if (first.y < t.low.y || first.y > t.high.y) {
        return;
    }
    FaceEdges e = edges_of(t);
    int end = min(first.x + TILE_TEXELS - 1, t.high.x);
    for (int x = max(first.x, t.low.x); x <= end; x++) {
        float depth = depth_at(k, t, e, ivec2(x, first.y));
        if (depth > 0.0) {
            write_texel(k, face, ivec2(x, first.y), depth, owner.number);
        }
    }
}
