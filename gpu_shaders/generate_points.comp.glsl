// View-independent rasterization of triangles into points: a point for every cell of a lattice in the triangle's plane
// that the triangle touches. FROM_TRIANGLES walks the scene and leaves what has many cells as parts; FROM_PARTS cuts parts into
// smaller ones, as often as it takes, and into tiles for FROM_TILES. With LIST_LARGE what takes many points is listed for the rasterizer.
// INTO_BUFFER appends points, INTO_MAPS splats them as they come; with BY_RASTERIZER fragments do (generate_points.geom.glsl).
#include "lib/load_aligned.glsl"
#include "lib/hash.glsl"
#include "lib/triangle_sampling.glsl"

const int TILE_CELLS = 8;
const int MAX_SMALL_CELLS = 32;          // what a mask of 32 bits holds
const int MAX_QUADTREE_STEPS = 128;  // never reached; a loop on a GPU must end whatever the numbers are
const float GENERATION_VIEW_PX = 4096.0;  // of vir's generation view; without a limit a wall that reaches the light takes all memory

#ifdef INTO_MAPS
#include "lib/splat.glsl"
#ifdef EYE_DENSITY
#include "lib/splat_cell.glsl"
#endif
#endif

#ifdef BY_RASTERIZER
int linear_invocation() {
    return gl_PrimitiveIDIn;
}
#else
#include "lib/linear_invocation.glsl"
#endif

#ifndef FROM_PARTS
struct Cells {
    vec2 first_center;
    vec2 size;
    int count_x;
    int count_y;
};

#ifdef BY_RASTERIZER
#include "lib/lattice_strip.glsl"
#else
// A bit for every cell that the triangle touches, row by row.
uint touched_cells(AlignedTriangle t, Cells cells, float half_share) {
    vec2 half_size = half_share * cells.size;
    uint touched = 0u;
    uint bit = 1u;
    for (int j = 0; j < cells.count_y; j++) {
        for (int i = 0; i < cells.count_x; i++) {
            if (rectangle_overlaps(t, cells.first_center + cells.size * vec2(i, j), half_size)) {
                touched |= bit;
            }
            bit <<= 1u;
        }
    }
    return touched;
}

void emit_points(AlignedTriangle t, Cells cells, uint touched) {
    uint count = uint(bitCount(touched));
    if (count == 0u) {
        return;
    }
    uint next = imageAtomicAdd(counters, ivec2(0, 0), count);
#ifdef INTO_BUFFER
    // counted all the same: the host learns how much room is missing
    if (next + count > uint(texel_capacity)) {
        return;
    }
    float packed_normal = pack_direction(t.n);
#endif
    for (int j = 0; j < cells.count_y; j++) {
        for (int i = 0; i < cells.count_x; i++) {
            if ((touched & 1u) != 0u) {
                vec3 p_fs = point_at(t, nearest_in_triangle(t, cells.first_center + cells.size * vec2(i, j)));
#ifdef INTO_BUFFER
                imageStore(points, linear_texel(int(next)), vec4(p_fs, packed_normal));
                next++;
#else
                splat(p_fs, t.n);
#endif
            }
            touched >>= 1u;
        }
    }
}

#ifdef EYE_DENSITY
// Cells that are larger than texels: two texels of the buffer each, which they fill from its end.
void emit_splats(AlignedTriangle t, Cells cells, uint touched, int instance, int triangle) {
    uint count = uint(bitCount(touched));
    if (count == 0u) {
        return;
    }
    uint next = imageAtomicAdd(counters, ivec2(4, 0), count);
#ifdef INTO_BUFFER
    if (2u * (next + count) > uint(texel_capacity)) {
        return;
    }
    int place = texel_capacity - 2 * int(next);
#endif
    for (int j = 0; j < cells.count_y; j++) {
        for (int i = 0; i < cells.count_x; i++) {
            if ((touched & 1u) != 0u) {
                vec2 center = cells.first_center + cells.size * vec2(i, j);
#ifdef INTO_BUFFER
                place -= 2;
                imageStore(points, linear_texel(place), vec4(float(instance), float(triangle), center));
                imageStore(points, linear_texel(place + 1), vec4(0.5 * cells.size, 0.0, 0.0));
#else
                splat_cell(t, center, 0.5 * cells.size);
#endif
            }
            touched >>= 1u;
        }
    }
}
#endif
#endif

#endif

#ifndef FROM_TILES
float spacing_for(vec2 density) {
#ifdef WATERTIGHT
    return inversesqrt(density.y);
#else
    // edge-on triangles have no area in the map but may still be hit: at least a hundredth of the watertight density
    return inversesqrt(max(density.x, 0.01 * density.y));
#endif
}

#ifdef EYE_DENSITY
// The lattice may be coarser than the maps, by how much the eye says. What it makes of texels is bounded.
float coarser_spacing(vec2 density, float coarseness) {
    return min(spacing_for(density) * coarseness, MAX_SPLAT_LATTICES * inversesqrt(density.y));
}

// Whether a cell may take more than the texel that its point lies in.
bool takes_texels(vec2 cell, vec2 density) {
    return max(cell.x, cell.y) > 1.0001 * inversesqrt(density.y);
}
#endif

#ifdef GLOBAL_RATE
// A triangle has one spacing. What does not fit into the generation view at its rate stands farther away: it is sampled too sparsely.
float spacing_of(AlignedTriangle t) {
    vec2 low = min(min(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 high = max(max(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    return max(spacing_for(largest_density(t)), max(high.x - low.x, high.y - low.y) / GENERATION_VIEW_PX);
}
#endif

#ifndef LIST_LARGE
void append_part(int instance, int triangle, vec2 low, vec2 size) {
    int index = int(imageAtomicAdd(counters, ivec2(3, 0), 1u)) - counted_parts;
    if (index < part_capacity) {
        imageStore(parts, linear_texel(2 * index), vec4(float(instance), float(triangle), 0.0, 0.0));
        imageStore(parts, linear_texel(2 * index + 1), vec4(low, size));
    }
}
#endif
#endif

#ifdef FROM_PARTS
// Whether any view sees a part of a rectangle of the triangle's plane; `corners` are its corners in face space.
bool wanted(AlignedTriangle t, vec2 center, vec2 half_size, out vec3 corners[4]) {
    for (int k = 0; k < 4; k++) {
        corners[k] = point_at(t, center + half_size * vec2((k & 1) == 0 ? -1.0 : 1.0, (k & 2) == 0 ? -1.0 : 1.0));
    }
    return rectangle_overlaps(t, center, half_size) && !unseen(corners);
}

// of_splats: a negative number of columns says so
void append_tile(int instance, int triangle, vec2 low, vec2 size, vec2 cell_counts, bool of_splats) {
    int index = int(imageAtomicAdd(counters, ivec2(1, 0), 1u)) - counted_tiles;
    vec2 counts = of_splats ? vec2(-cell_counts.x, cell_counts.y) : cell_counts;
    imageStore(tiles, linear_texel(2 * index), vec4(float(instance), float(triangle), counts));
    imageStore(tiles, linear_texel(2 * index + 1), vec4(low, size / cell_counts));
}

// Cuts a part into tiles of at most TILE_CELLS^2 cells, each sampled at the density that it needs itself: one density for all of
// a floor that reaches under the light would multiply its points. Walks a quadtree without a stack: `node` counts nodes of
// its level in x and y. What is too large even at the last level becomes a part again.
void main() {
    int index = linear_invocation();
    if (index >= part_count) {
        return;
    }
    vec4 owner = imageLoad(parts, linear_texel(2 * (first_part + index)));
    vec4 place = imageLoad(parts, linear_texel(2 * (first_part + index) + 1));
    int instance_index = int(owner.x);
    int triangle_index = int(owner.y);
    InstanceData instance = load_instance(instance_index);
    AlignedTriangle t = load_aligned(instance, load_triangle(instance, triangle_index));
    ivec2 node = ivec2(0);
    int level = 0;
    vec3 corners[4];
    for (int step = 0; step < MAX_QUADTREE_STEPS; step++) {
        vec2 node_size = place.zw / float(1 << level);
        vec2 node_low = place.xy + node_size * vec2(node);
        if (wanted(t, node_low + 0.5 * node_size, 0.5 * node_size, corners)) {
#ifdef GLOBAL_RATE
            float spacing = spacing_of(t);
#else
            vec2 density = largest_density_of_rectangle(corners, t.n);
#ifdef EYE_DENSITY
            float spacing = coarser_spacing(density, lattice_coarseness(0.5 * (corners[0] + corners[3]), 0.5 * length(node_size)));
#else
            float spacing = spacing_for(density);
#endif
#endif
            vec2 cell_counts = max(ceil(node_size / spacing), 1.0);
            bool of_splats = false;
#ifdef EYE_DENSITY
            of_splats = takes_texels(node_size / min(cell_counts, float(TILE_CELLS)), density);
#endif
            if (max(cell_counts.x, cell_counts.y) <= float(TILE_CELLS)) {
                append_tile(instance_index, triangle_index, node_low, node_size, cell_counts, of_splats);
            } else if (level < QUADTREE_LEVELS) {
                level++;
                node *= 2;
                continue;
            } else if (may_leave_parts != 0) {
                append_part(instance_index, triangle_index, node_low, node_size);
            } else {
                append_tile(instance_index, triangle_index, node_low, node_size, vec2(TILE_CELLS), of_splats);
            }
        }
        while (level > 0 && (node.x & node.y & 1) == 1) {
            level--;
            node /= 2;
        }
        if (level == 0) {
            return;
        }
        node = (node.x & 1) == 0 ? node + ivec2(1, 0) : node + ivec2(-1, 1);
    }
}
#endif

#ifdef FROM_TRIANGLES
#ifdef LIST_LARGE
void append_large(AlignedTriangle t, int instance) {
    int index = int(imageAtomicAdd(counters, ivec2(3, 0), 1u));
    if (index < large_capacity) {
        for (int i = 0; i < 3; i++) {
            // the other way round, as a rasterizer wants them
            imageStore(large_triangles, linear_texel(3 * index + i), vec4(t.corner_fs[i == 0 ? 0 : 3 - i], float(instance)));
        }
    }
}
#else
void append_parts(AlignedTriangle t, int instance, int triangle, vec2 low, vec2 high) {
    // u runs along the longest edge: square parts lie side by side. Halves of squares are twice as long as high, and rounding does not
    // decide whether two parts do.
    vec2 extent = high - low;
    int count = int(clamp(ceil(0.99 * extent.x / max(extent.y, 1e-30)), 1.0, float(PARTS_OF_A_SLIVER)));
    vec2 size = vec2(extent.x / float(count), extent.y);
    for (int k = 0; k < count; k++) {
        append_part(instance, triangle, low + vec2(size.x * float(k), 0.0), size);
    }
}
#endif

void main() {
    int invocation = linear_invocation();
    int group = invocation / WORK_GROUP_SIZE;
    if (group >= group_count) {
        return;
    }
    vec4 work = texelFetch(work_table, linear_texel(group + first_group), 0);
    int instance_index = int(work.x);
    int triangle_index = int(work.y) + invocation % WORK_GROUP_SIZE;
    if (triangle_index >= int(work.z)) {
        return;
    }
    InstanceData instance = load_instance(instance_index);
    TriangleData triangle = load_triangle(instance, triangle_index);
    AlignedTriangle t = load_aligned(instance, triangle);
    bool two_sided = work.w > 0.5;
    // a triangle without area is seen by no view, and its plane is undefined
    if (t.area <= 0.0 || !(two_sided || faces_any_view(t.n, t.centroid_fs))) {
        return;
    }
    vec3 bounds[4];
    bounds[0] = t.corner_fs[0];
    bounds[1] = t.corner_fs[1];
    bounds[2] = t.corner_fs[2];
    bounds[3] = t.corner_fs[2];
    if (unseen(bounds)) {
        return;
    }
    vec2 low = min(min(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 high = max(max(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    bool of_splats = false;
#ifdef GLOBAL_RATE
    float spacing = spacing_of(t);
#else
    vec2 density = largest_density(t);
    float spacing = spacing_for(density);
#ifdef EYE_DENSITY
    float radius = max(max(length(t.corner_uv[0]), length(t.corner_uv[1])), length(t.corner_uv[2]));
    spacing = coarser_spacing(density, lattice_coarseness(t.centroid_fs, radius));
    of_splats = takes_texels((high - low) / max(ceil((high - low) / spacing), 1.0), density);
#endif
#ifdef STOCHASTIC_CULLING
    // section 3.2: below a tenth of a texel (in the preprint an eighth) a triangle is culled with probability 1 - 10 A (1 - 8 A). Not
    // what is splatted: a splat covers texels whose centres its triangle covers, so others cannot stand for it.
    float area_texels = t.area * density.x;
    if (area_texels < culling_area_texels && !of_splats) {
        uint identity = hash_position(triangle.position_os[0]) + hash_position(triangle.position_os[1]) + hash_position(triangle.position_os[2]);
        if (unit_float(pcg_hash(identity + instance.stable_id)) * culling_area_texels >= area_texels) {
            imageAtomicAdd(counters, ivec2(2, 0), 1u);
            return;
        }
    }
#endif
#endif
    // the lattice starts at the triangle's bounds and divides them evenly: no cells that stick out, and a triangle smaller than a
    // cell becomes one point
    vec2 counts = max(ceil((high - low) / spacing), 1.0);
    if (counts.x * counts.y <= float(MAX_SMALL_CELLS)) {
        vec2 cell = (high - low) / counts;
        Cells cells = Cells(low + 0.5 * cell, cell, int(counts.x), int(counts.y));
#ifdef BY_RASTERIZER
        emit_triangle(t, cells);
        return;
#else
#ifdef EYE_DENSITY
        uint touched = touched_cells(t, cells, of_splats ? 0.5 : TOUCHED_HALF);
#else
        uint touched = touched_cells(t, cells, TOUCHED_HALF);
#endif
#ifdef LIST_LARGE
        if (bitCount(touched) <= points_of_small) {
            emit_points(t, cells, touched);
            return;
        }
#else
#ifdef EYE_DENSITY
        if (of_splats) {
            emit_splats(t, cells, touched, instance_index, triangle_index);
            return;
        }
#endif
        emit_points(t, cells, touched);
        return;
#endif
#endif
    }
#ifdef LIST_LARGE
    append_large(t, instance_index);
#else
    append_parts(t, instance_index, triangle_index, low, high);
#endif
}
#endif

#ifdef FROM_TILES
#ifdef BY_RASTERIZER
const int INVOCATIONS_PER_TILE = 1;
#else
const int INVOCATIONS_PER_TILE = TILE_CELLS;  // rows
#endif

void main() {
    int invocation = linear_invocation();
    int tile = invocation / INVOCATIONS_PER_TILE;
    if (tile >= tile_count) {
        return;
    }
    vec4 owner = texelFetch(tile_list, linear_texel(2 * tile), 0);
    vec4 place = texelFetch(tile_list, linear_texel(2 * tile + 1), 0);
    int row = invocation % INVOCATIONS_PER_TILE;
    if (row >= int(owner.w)) {
        return;
    }
    InstanceData instance = load_instance(int(owner.x));
    AlignedTriangle t = load_aligned(instance, load_triangle(instance, int(owner.y)));
    vec2 first_center = place.xy + 0.5 * place.zw + place.zw * vec2(0.0, row);
#ifdef BY_RASTERIZER
    emit_rectangle(t, Cells(first_center, place.zw, int(owner.z), int(owner.w)));
#else
    Cells cells = Cells(first_center, place.zw, int(abs(owner.z)), 1);
#ifdef EYE_DENSITY
    if (owner.z < 0.0) {
        emit_splats(t, cells, touched_cells(t, cells, 0.5), int(owner.x), int(owner.y));
        return;
    }
#endif
    emit_points(t, cells, touched_cells(t, cells, TOUCHED_HALF));
#endif
}
#endif
