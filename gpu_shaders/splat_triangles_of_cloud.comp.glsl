// Splats triangles of the cloud into the cubes of a batch. What is large in a cube is left as tiles, found while depths are.
#include "lib/linear_invocation.glsl"
#include "lib/splat_reflected.glsl"
#include "lib/pending_cubes.glsl"
#include "lib/face_triangle.glsl"
#include "lib/enlarged_faces.glsl"

const int MAX_SPLAT_TEXELS = 64;

// A triangle so small that others are left out for it, as a point: it takes the texels within half a spacing.
bool splat_point(int k, vec3 p, float spacing, uint number) {
    int face = face_of_direction(p);
    vec3 f = in_face(face, p);
    vec2 place = (f.xy / f.z + 1.0) / texel_tangent(k);
    float reach = 0.5 * clamp(spacing / (f.z * texel_tangent(k)), 1.0, MAX_POINT_TEXELS);
    ivec2 last = ivec2(cube_side(k) - 1);
    ivec2 low = clamp(ivec2(floor(place - reach + 0.5)), ivec2(0), last);
    ivec2 high = clamp(ivec2(ceil(place + reach - 0.5)) - 1, low, last);
    bool is_first = false;
    if (f.z > cube_near_m(k)) {
        for (int y = low.y; y <= high.y; y++) {
            for (int x = low.x; x <= high.x; x++) {
                is_first = write_texel(k, face, ivec2(x, y), f.z, number) || is_first;
            }
        }
    }
    return is_first;
}

bool is_outside(int k, vec3 edge, vec2 corner) {
    // where the tile is farthest inside
    vec2 inner = corner + float(TILE_TEXELS) * vec2(greaterThan(edge.xy, vec2(0.0)));
    return dot(edge, texel_direction(k, inner)) < 0.0;
}

void append_tiles(int k, int face, FaceTriangle t, FaceEdges e, int index) {
    ivec2 low = t.low / TILE_TEXELS;
    ivec2 high = t.high / TILE_TEXELS;
    for (int y = low.y; y <= high.y; y++) {
        for (int x = low.x; x <= high.x; x++) {
            vec2 corner = vec2(x, y) * float(TILE_TEXELS);
            if (!(is_outside(k, e.edge_a, corner) || is_outside(k, e.edge_b, corner) || is_outside(k, e.edge_c, corner))) {
                int next = int(imageAtomicAdd(counters, ivec2(2, 0), 1u));
                if (next < tile_capacity) {
                    imageStore(tiles, linear_texel(next), vec4(float(index), float(8 * k + face), float(x), float(y)));
                }
            }
        }
    }
}

bool splat_triangle(int k, int face, vec3 a, vec3 b, vec3 c, int index, uint number) {
    FaceTriangle t = on_face(k, face, a, b, c);
    ivec2 size = t.high - t.low + 1;
    if (min(size.x, size.y) <= 0) {
        return false;
    }
    FaceEdges e = edges_of(t);
    int count = size.x * size.y;
    if (count > MAX_SPLAT_TEXELS) {
        if (is_numbering == 0) {
            append_tiles(k, face, t, e, index);
        }
        return false;
    }
    bool is_first = false;
    ivec2 texel = t.low;
    int i = 0;
    do {
        float depth = depth_at(k, t, e, texel);
        if (depth > 0.0) {
            is_first = write_texel(k, face, texel, depth, number) || is_first;
        }
        texel.x++;
        if (texel.x > t.high.x) {
            texel = ivec2(t.low.x, texel.y + 1);
        }
    } while (++i < count);
    return is_first;
}

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec4 a = texelFetch(cloud_triangles, linear_texel(3 * index), 0);
    vec4 b = texelFetch(cloud_triangles, linear_texel(3 * index + 1), 0);
    vec4 c = texelFetch(cloud_triangles, linear_texel(3 * index + 2), 0);
    Owner owner = unpack_owner(vec3(a.w, b.w, c.w));
    vec4 mask = texelFetch(cube_masks, linear_texel(owner.instance), 0);
    vec3 center = (a.xyz + b.xyz + c.xyz) / 3.0;
    vec3 normal = cross(b.xyz - a.xyz, c.xyz - a.xyz);
    float area = 0.5 * length(normal);
    int pending = pending_cubes(index, mask);
    // sorted first: invocations side by side then go through few cubes each, not all of them through all
    int as_point = 0;
    int as_triangle = 0;
    for (int rest = pending; rest != 0; rest &= rest - 1) {
        int k = findLSB(rest);
        vec3 p = center - cube_center(k);
        // in cubes farther away more are left out; others take their part
        float spacing = sample_spacing(k, p, 0.0);
        float culled_area = culling_area * spacing * spacing;
        bool is_seen = owner.random * culled_area < area && (dot(normal, p) < 0.0 || shows_back_faces(mask, k));
        as_point |= is_seen && area < culled_area ? 1 << k : 0;
        as_triangle |= is_seen && area >= culled_area ? 1 << k : 0;
    }
    int cubes_before = 0;
    while (as_point != 0) {
        int k = findLSB(as_point);
        as_point &= as_point - 1;
        vec3 p = center - cube_center(k);
        cubes_before |= splat_point(k, p, sample_spacing(k, p, 0.0), owner.number) ? 1 << k : 0;
    }
    while (as_triangle != 0) {
        int k = findLSB(as_triangle);
        as_triangle &= as_triangle - 1;
        vec3 corner_a = a.xyz - cube_center(k);
        vec3 corner_b = b.xyz - cube_center(k);
        vec3 corner_c = c.xyz - cube_center(k);
        int faces = faces_of_triangle(corner_a, corner_b, corner_c);
        do {
            int face = findLSB(faces);
            cubes_before |= splat_triangle(k, face, corner_a, corner_b, corner_c, index, owner.number) ? 1 << k : 0;
            faces &= faces - 1;
        } while (faces != 0);
    }
    finish(index, cubes_before);
}
