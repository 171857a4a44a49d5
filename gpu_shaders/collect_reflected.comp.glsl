// What reflectors' cubes show of the scene, once for all of them: triangles and, with POINTS, points of the smaller ones. Of triangles
// far below the finest spacing that any cube asks for some are left out at random.
#include "lib/scene_data.glsl"
#include "lib/work_table.glsl"
#include "lib/hash.glsl"
#include "lib/lattice_cells.glsl"
#include "lib/cubes.glsl"

const int MAX_SMALL_CELLS = 32;  // what a mask of 32 bits holds

#ifdef POINTS
// The spacing that leaves no texel of a cube empty, as `texel_density` of lib/triangle_sampling.glsl has it.
float watertight_spacing(int k, vec3 p, vec3 n, float radius) {
    int face = face_of_direction(p);
    vec3 f = in_face(face, p);
    vec3 m = in_face(face, n);
    vec2 tangent = f.xy / max(f.z, 1.0e-30);
    vec3 row_x = vec3(1.0, 0.0, -tangent.x);
    vec3 row_y = vec3(0.0, 1.0, -tangent.y);
    float along_x = dot(row_x, m), along_y = dot(row_y, m);
    float frobenius = dot(row_x, row_x) + dot(row_y, row_y) - along_x * along_x - along_y * along_y;
    return max(f.z - radius, cube_near_m(k)) * texel_tangent(k) * inversesqrt(frobenius);
}

// Points of the lattice cells that the triangle touches; false where there are too many.
bool emit_points(AlignedTriangle t, float spacing, Owner owner) {
    vec2 low = min(min(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 high = max(max(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 counts = max(ceil((high - low) / spacing), 1.0);
    if (counts.x * counts.y > float(MAX_SMALL_CELLS)) {
        return false;
    }
    vec2 cell = (high - low) / counts;
    vec2 first = low + 0.5 * cell;
    int columns = int(counts.x);
    int cell_count = columns * int(counts.y);
    uint touched = 0u;
    for (int i = 0; i < cell_count; i++) {
        if (rectangle_overlaps(t, first + cell * vec2(i % columns, i / columns), 0.5 * cell)) {
            touched |= 1u << uint(i);
        }
    }
    int count = bitCount(touched);
    int next = int(imageAtomicAdd(counters, ivec2(1, 0), uint(count)));
    // counted all the same: the host learns how much room is missing and works in portions
    if (next + count > point_capacity) {
        return true;
    }
    float packed_normal = pack_direction(t.n);
    uint seed = uint(owner.random * 65536.0);
    for (int i = 0; i < cell_count; i++) {
        if ((touched >> uint(i) & 1u) != 0u) {
            vec3 p_ws = point_at(t, nearest_in_triangle(t, first + cell * vec2(i % columns, i / columns)));
            // a triangle of one point keeps its own number: cubes go on with what was begun here
            owner.random = count == 1 ? owner.random : unit_float(pcg_hash(seed + uint(i) * 65536u));
            vec3 bits = pack_owner(owner);
            imageStore(points, linear_texel(2 * next), vec4(p_ws, packed_normal));
            imageStore(points, linear_texel(2 * next + 1), vec4(bits, t.area / float(count)));
            next++;
        }
    }
    return true;
}
#endif

void main() {
    int group, triangle_index;
    vec4 work;
    if (!find_work(group, work, triangle_index)) {
        return;
    }
    InstanceData instance = load_instance(int(work.x));
    TriangleData triangle = load_triangle(instance, triangle_index);
    bool keeps_order = instance.orientation > 0.0;
    // transforms may mirror: the order of the corners keeps the front where it is
    AlignedTriangle t =
        align_triangle(triangle.position_ws[0], triangle.position_ws[keeps_order ? 1 : 2], triangle.position_ws[keeps_order ? 2 : 1]);
    // a triangle without area is seen by no cube
    if (t.area <= 0.0) {
        return;
    }
    float radius = max(max(length(t.corner_uv[0]), length(t.corner_uv[1])), length(t.corner_uv[2]));
    float spacing = 3.0e38;
#ifdef POINTS
    float lattice = 3.0e38;
#endif
    for (int k = 0; k < cube_count; k++) {
        vec3 p = t.centroid_fs - cube_center(k);
        spacing = min(spacing, sample_spacing(k, p, radius));
#ifdef POINTS
        lattice = min(lattice, watertight_spacing(k, p, t.n, radius));
#endif
    }
    uint identity = hash_position(triangle.position_os[0]) + hash_position(triangle.position_os[1]) + hash_position(triangle.position_os[2]);
    float random = float(pcg_hash(identity + instance.stable_id) >> 16u) / 65536.0;
    // section 3.2: of an area below a tenth of a sample's a triangle is culled with probability 1 - 10 A
    if (random * culling_area * spacing * spacing >= t.area) {
        return;
    }
    Owner owner = Owner(uint(group + first_group) * uint(WORK_GROUP_SIZE) + gl_LocalInvocationID.x, random, int(work.x));
#ifdef POINTS
    if (emit_points(t, lattice, owner)) {
        return;
    }
#endif
    int index = int(imageAtomicAdd(counters, ivec2(0, 0), 1u));
    if (index >= triangle_capacity) {
        return;
    }
    vec3 bits = pack_owner(owner);
    for (int i = 0; i < 3; i++) {
        imageStore(cloud_triangles, linear_texel(3 * index + i), vec4(t.corner_fs[i], bits[i]));
    }
}
