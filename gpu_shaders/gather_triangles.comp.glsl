// Collects the triangles that cast into the maps of a face: culled, placed and projected once, for all views.
// What covers few texels in every view is small and fills the list from its start, the rest from its end.
#include "lib/scene_data.glsl"
#include "lib/work_table.glsl"
#include "lib/seen_space.glsl"

bool is_small(vec3 corners_fs[4]) {
    bool small = true;
    int k = -1;
    do {
        k++;
        vec2 low = vec2(3.0e38);
        vec2 high = vec2(-3.0e38);
        for (int i = 0; i < 3; i++) {
#ifdef ORTHOGRAPHIC
            vec3 p = corners_fs[i];
            vec2 at = (p.xy - hull[k].xy * p.z) * texels_per_tangent;
#else
            vec3 p = corners_fs[i] - hull[k].xyz;
            vec2 at = p.xy * (texels_per_tangent / p.z);
#endif
            // what reaches a view's near plane has to be clipped
            small = small && p.z > near_m;
            low = min(low, at);
            high = max(high, at);
        }
        vec2 extent = high - low;
        small = small && max(extent.x, extent.y) <= SMALL_EXTENT_TEXELS;
    } while (k + 1 < hull_count);
    return small;
}

void main() {
    int group, triangle_index;
    vec4 work;
    if (!find_work(group, work, triangle_index)) {
        return;
    }
    InstanceData instance = load_instance(int(work.x));
    TriangleData triangle = load_triangle(instance, triangle_index);
    vec3 corners_fs[4];
    corners_fs[0] = face_position(triangle.position_ws[0]);
    // transforms may mirror: the order of the corners keeps the front where it is
    corners_fs[1] = face_position(triangle.position_ws[instance.orientation > 0.0 ? 1 : 2]);
    corners_fs[2] = face_position(triangle.position_ws[instance.orientation > 0.0 ? 2 : 1]);
    corners_fs[3] = corners_fs[2];
    // face space is left-handed
    vec3 scaled_normal = -cross(corners_fs[1] - corners_fs[0], corners_fs[2] - corners_fs[0]);
    bool two_sided = work.w > 0.5;
    bool faces_light = faces_any_view(scaled_normal, corners_fs[0]);
    // a triangle without area is seen by no view
    if (dot(scaled_normal, scaled_normal) == 0.0 || !(two_sided || faces_light) || unseen(corners_fs)) {
        return;
    }
    bool small = is_small(corners_fs);
    // counted all the same: the host learns how much room is missing
    int index = int(imageAtomicAdd(counters, ivec2(small ? 0 : 1, 0), 1u));
    if (index >= triangle_capacity) {
        return;
    }
    int place = small ? index : triangle_capacity - 1 - index;
    for (int i = 0; i < 3; i++) {
        vec3 p = corners_fs[i];
        // moving a view in the plane z = 0 shifts the corner in its map by an amount proportional to 1/z, shearing a sun's by one
        // proportional to z
#ifdef ORTHOGRAPHIC
        p.xy = small ? p.xy * texels_per_tangent : p.xy;
#endif
#ifdef FRONT_FACE
        p = small ? vec3(p.xy * (texels_per_tangent / p.z), 1.0 / p.z) : p;
#endif
        imageStore(gathered_triangles, linear_texel(3 * place + i), vec4(p, small ? float(faces_light) : work.x));
    }
}
