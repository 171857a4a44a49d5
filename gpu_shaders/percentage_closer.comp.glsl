// Percentage-closer soft shadows (Fernando 2005): one map, from the light's centre, tells how much of the light every visible surface sees.
//
// A tap stands for a point of the light and lies where the ray from the receiver to this point has a given depth. Taps of the search look
// for what blocks the light at depths between the receiver and the nearest caster; those of the filter all lie at the mean depth of what
// was found, as if all blockers did, and count what their points would deliver.
#include "lib/rounds.glsl"
#include "lib/octahedral.glsl"
#include "lib/view.glsl"
#include "lib/cube_faces.glsl"
#include "lib/delivered.glsl"

// Table `light_points`: the search's, then the filter's.
#define search_point(k) (vec4(light_points[k].xyz, 1.0))
#define search_share(k) (light_points[k].w)  // from the receiver to the nearest caster, of what the light's width grows by in the map
#define filter_point(k) (light_points[search_count + (k)])

// How high above the tangent plane what the map stores has to lie: it may be the receiver itself, of facets of about a texel, or curved.
const float BIAS_FOOTPRINTS = 1.0 / 12.0;
const float BIAS_ANGLE = 1.0 / 48.0;
const float MIN_SLOPE = 1.0e-6;  // of a ray to a point as deep as the receiver

struct Receiver {
    vec3 p_fs;
    vec3 normal_fs;
    vec3 shading_fs;
};

// What a point of the light would deliver; 0 where the surface itself is in the way.
float deliverable(vec4 point, Receiver r, out bool is_above) {
    vec3 p = r.p_fs - point.xyz;
#ifdef ORTHOGRAPHIC
    is_above = dot(r.normal_fs, point.xyz) < 0.0;
#else
    is_above = dot(r.normal_fs, p) < 0.0;
    if (!(dot(p, p) > 0.0)) {
        return 0.0;
    }
#endif
    return delivered(point, p, r.shading_fs);
}

// The map's texel of the place where the ray from a receiver to a point of the light has this depth.
ivec2 tap(vec4 point, Receiver r, float depth) {
#ifdef ORTHOGRAPHIC
    vec3 p = vec3(r.p_fs.xy - point.xy / point.z * (r.p_fs.z - depth), depth);
#else
    vec3 toward = point.xyz - r.p_fs;
    float share = clamp((r.p_fs.z - depth) / max(-toward.z, MIN_SLOPE * r.p_fs.z), 0.0, 1.0);
    vec3 p = r.p_fs + share * toward;
    p.z = max(p.z, near_m);
#endif
    return ivec2(floor(map_position(0, p)));
}

#ifdef ORTHOGRAPHIC
float searched_depth(int k, float receiver_depth) {
    return mix(receiver_depth, min(nearest_depth, receiver_depth), search_share(k));
}
#else
float searched_depth(int k, float receiver_depth) {
    return 1.0 / mix(1.0 / receiver_depth, 1.0 / min(nearest_depth, receiver_depth), search_share(k));
}
#endif

struct Blocker {
    float depth;  // 0: none
    bool is_before_light;  // the line from the receiver through it meets the light
};

const Blocker NO_BLOCKER = Blocker(0.0, false);

// What the map stores, if it hides anything from the receiver.
Blocker blocker(ivec2 texel, Receiver r) {
    // outside every caster's outline
    if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, map_size))) {
        return NO_BLOCKER;
    }
    float depth = uintBitsToFloat(texelFetch(depth_maps, texel + ivec2(0, view_first_row(0)), 0).x);
    if (depth >= r.p_fs.z) {
        return NO_BLOCKER;
    }
    vec2 centre = (vec2(texel) + 0.5 + view_window(0)) * texel_tangent;
#ifdef ORTHOGRAPHIC
    vec3 toward = vec3(centre, depth) - r.p_fs;
#else
    vec3 toward = vec3(centre * depth, depth) - r.p_fs;
#endif
    float distance_m = length(toward);
    float footprint = footprint_at(r.p_fs.z);
    if (dot(r.normal_fs, toward) <= BIAS_FOOTPRINTS * footprint + BIAS_ANGLE * distance_m + depth_rounding(r.p_fs.z)) {
        return NO_BLOCKER;
    }
#ifdef ORTHOGRAPHIC
    bool is_before_light = length(toward.xy) <= -reach * toward.z + footprint;
#else
    bool is_before_light = length(cross(r.p_fs, toward)) <= reach * distance_m + footprint * length(r.p_fs);
#endif
    return Blocker(depth, is_before_light);
}

// Mean depth of what may block the light, 0 if nothing may. A wall beside the receiver does not hide the lamp before both.
float blockers_depth(Receiver r) {
    float sum = 0.0;
    float found = 0.0;
    for (int k = 0; k < MAX_TAPS && k < search_count; k++) {
        bool is_above;
        if (deliverable(search_point(k), r, is_above) > 0.0 && is_above) {
            Blocker seen = blocker(tap(search_point(k), r, searched_depth(k, r.p_fs.z)), r);
            sum += seen.is_before_light ? seen.depth : 0.0;
            found += seen.is_before_light ? 1.0 : 0.0;
        }
    }
    return found > 0.0 ? sum / found : 0.0;
}

// s and d as the mean over the filter's taps
vec2 filtered(Receiver r, float depth) {
    vec2 sums = vec2(0.0);
    for (int k = 0; k < MAX_TAPS && k < filter_count; k++) {
        bool is_above;
        float weight = deliverable(filter_point(k), r, is_above);
        bool is_hidden = weight > 0.0 && is_above && depth > 0.0 && blocker(tap(filter_point(k), r, depth), r).depth > 0.0;
        sums += weight * vec2(is_above && !is_hidden ? 1.0 : 0.0, 1.0);
    }
    return sums / float(filter_count);
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 before = pass_before(pixel);
    vec4 position = texelFetch(positions, pixel, 0);
    bool surface = takes_light(position);
    int turn = own_turn();
    vec2 sums = sums_before(turn, pixel);
    if (surface && view_count > 0) {
        vec4 normal = texelFetch(normals, pixel, 0);
        Receiver r = Receiver(face_position(position.xyz), face_direction(normal.xyz), face_direction(unpack_direction(normal.w)));
#ifdef OMNI
        set_place(r.p_fs);
#endif
#ifdef MANY_FACES
        int belongs_to = 1 << face_index(light_position(position.xyz));
        if ((turn & LATE_FACES & belongs_to) != 0) {
            // a face before the one that this tile is looked up again from: as it was
            sums += filtered(r, 0.0) * vec2((turn & WAS_LIT) != 0 ? 1.0 : 0.0, 1.0);
        } else if ((face_mask & belongs_to) != 0) {
            sums += filtered(r, belongs_to == 1 << map_face ? blockers_depth(r) : 0.0);
        }
#else
        sums += filtered(r, blockers_depth(r));
#endif
    }
    add_to_pass(turn, pixel, surface, sums, before);
}
