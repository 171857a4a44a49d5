// Looks every visible surface up in the depth maps of a batch and adds to the pass's running sums.
//
// The pass is sum(visible * delivered) / sum(delivered) over light samples and eye samples.
#include "lib/tiles.glsl"
#include "lib/octahedral.glsl"
#include "lib/view.glsl"
#include "lib/cube_faces.glsl"
#include "lib/delivered.glsl"
#include "lib/rounds.glsl"

// The light's point of a view, as lib/delivered.glsl wants it.
#ifdef ORTHOGRAPHIC
#define sampled_point(k) (samples[k])
#define ray_direction(k) (samples[k].xyz)
#else
#define sampled_point(k) (vec4(view_center(k), samples[k].w))
#endif

float stored_depth(ivec2 address) {
    return uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
}

// Of a texel of a view's map, or of the nearest one at its edge.
float depth_within(int k, ivec2 address) {
    ivec2 low = ivec2(0, batch_first_row(k));
    return stored_depth(clamp(address, low, low + map_size - 1));
}

// Whether a point wrote what a texel stores: then its outline reaches half a texel too far.
bool is_of_point(float depth) {
#ifdef MIXED_MAPS
    return (floatBitsToUint(depth) & 1u) != 0u;
#elif defined(POINT_MAPS)
    return true;
#else
    return false;
#endif
}

// How far before a receiver at depth z its own surface may be, if it is so many footprints. Those of coarse maps are as long as rooms.
float own_reach(float footprints, float z, float footprint) {
    float reach = footprints * footprint;
#ifdef ORTHOGRAPHIC
    return reach;
#else
    return min(reach, MAX_NEARER_SHARE * z);
#endif
}

// Whether a stored point lies in the tangent plane of a receiver at depth z or below it.
bool is_below(float depth, float height, float z, float footprint) {
    bool of_point = is_of_point(depth);
    float reach = own_reach(MAX_NEARER_FOOTPRINTS, z, footprint);
    float bias_footprints = of_point ? POINT_BIAS_FOOTPRINTS : RASTER_BIAS_FOOTPRINTS;
    float tolerance = bias_footprints * footprint + BIAS_ANGLE * min(abs(depth - z), reach);
    // What is nearer by more and above the plane is something else, or the receiver's surface that has risen into the light's way: folds
    // within a texel are at hand. Planes of large facets that points carry past the facets' edges may be anywhere.
#ifdef SMALL_FACETS
    bool is_far = depth < z - reach;
#else
    bool is_far = depth < z - reach && !of_point;
#endif
    return height <= (is_far ? COPLANAR_FOOTPRINTS * footprint : tolerance) + depth_rounding(z);
}

// Whether what a texel stores leaves a receiver at depth z in sight. height: of the stored point above the receiver's tangent plane; reach:
// how much nearer what is below that plane may be. It may be a wall that crosses the plane beside the texel's centre.
bool leaves_in_sight(float depth, float height, float z, float footprint, float reach) {
    return (depth >= z - reach && is_below(depth, height, z, footprint)) || depth >= z + MAX_DEEPER_FOOTPRINTS * footprint;
}

bool either_leaves_in_sight(vec2 depths, vec2 heights, float z, float footprint, float reach) {
    return leaves_in_sight(depths.x, heights.x, z, footprint, reach) || leaves_in_sight(depths.y, heights.y, z, footprint, reach);
}

const int SEEN = 0;
const int HIDDEN = 1;
const int UNDECIDED = 2;  // takes a look at the neighbouring texels
const int UNKNOWN = 3;    // no map reaches there

// Of its weight: it says nothing where other samples do, and otherwise that the pixel is lit. What surfaces of the same instance get tells
// more of it than that no map reaches there; of one that was not known at all, they tell nothing, and it is lit.
const float UNKNOWN_SHARE = 1.0e-8;

struct LookUp {
    ivec2 address;
    vec2 offset;       // of the point from the texel's centre, texels
    vec2 facing_step;  // what a texel to the right or up adds to ray_facing; ORTHOGRAPHIC: to heights
    float ray_facing;  // the normal's part along the ray through the texel's centre
    float bound;       // height = depth * ray_facing - bound
    float footprint;
    float depth;
    float height;
};

// Height above the tangent plane of what a texel stores. step: to the texel, sum of facing_step
float height_of(LookUp own, float depth, float step) {
#ifdef ORTHOGRAPHIC
    return depth * own.ray_facing - own.bound + step;
#else
    return depth * (own.ray_facing + step) - own.bound;
#endif
}

// The normal's part along the view's ray to p: negative where the surface faces the view.
float facing_of(int k, vec3 p, vec3 normal_fs) {
#ifdef ORTHOGRAPHIC
    return dot(normal_fs, ray_direction(k));
#else
    return dot(normal_fs, p);
#endif
}

// What the view's map has where a point lies, or at its edge. p: from the view's centre, face space.
float depth_at(int k, vec3 p) {
    ivec2 texel = clamp(ivec2(floor(map_position(k, p))), ivec2(0), map_size - 1);
    return stored_depth(texel + ivec2(0, batch_first_row(k)));
}

// Of a point that lies in the view's map. p: from the view's centre, face space; depth: what the map has there
LookUp look_up(int k, vec3 p, vec3 normal_fs, vec2 at, float depth) {
    LookUp own;
    ivec2 texel = ivec2(floor(at));
    own.address = texel + ivec2(0, batch_first_row(k));
    own.offset = at - vec2(texel) - 0.5;
    own.facing_step = normal_fs.xy * texel_tangent;
#ifdef ORTHOGRAPHIC
    own.ray_facing = dot(normal_fs, vec3(view_shear(k), 1.0));
    own.bound = p.z * own.ray_facing + dot(own.facing_step, own.offset);
#else
    own.bound = dot(normal_fs, p);
    own.ray_facing = own.bound * (1.0 / p.z) - dot(own.facing_step, own.offset);
#endif
    own.footprint = footprint_at(p.z);
    own.depth = depth;
    own.height = height_of(own, own.depth, 0.0);
    return own;
}

// Whether the light grazes the receiver's plane: it passes all depths at which others may touch it within a texel.
bool is_grazed(LookUp own) {
    float run = max(abs(own.facing_step.x), abs(own.facing_step.y));
    return run >= CONTACT_FOOTPRINTS * footprint_share * abs(own.ray_facing);
}

// Along which the receiver's plane rises, as whole texels and exactly.
vec2 slope_of(LookUp own) {
    return own.facing_step / max(max(abs(own.facing_step.x), abs(own.facing_step.y)), 1e-30);
}

// Where points have an outline, a texel with its centre beyond still stores the surface.
#if defined(POINT_MAPS) && !defined(MIXED_MAPS)
const bool HAS_CENTRES_BEYOND = false;
#else
const bool HAS_CENTRES_BEYOND = true;
#endif

const int UNTOLD = 0;
const int ABOVE = 1;
const int BELOW = 2;

// Which side of a receiver the outline of the surface before it passes, between the texels: how steeply the surface comes up to it tells.
// Where its crest is as deep as the receiver, a round surface comes up to it as a parabola does, and `share` is 1; it is 0 where
// the crest is much nearer, as that of something else is.
int outline_of(int k, LookUp own, float z, bool is_round) {
    if (!is_round) {
        return UNTOLD;  // surfaces fall away from the edges of large facets as they may
    }
    vec2 slope = slope_of(own);
    ivec2 up = ivec2(round(slope));
    float step_up = dot(vec2(up), slope);
    float above = dot(own.offset, slope);  // the receiver, of the centre of the nearest texel below it
    ivec2 texel = own.address;
    if (above <= 0.0) {
        texel -= up;
        above += step_up;
    }
    float nearer = z - depth_within(k, texel);
    float below = z - depth_within(k, texel - up);
    float rise = below - nearer;
    float rise_below = z - depth_within(k, texel - 2 * up) - below;
    float share = above * rise * (nearer + below) / (step_up * nearer * nearer);
    // planes rise evenly or not at all, and different surfaces have nothing in common
    bool bends = rise > depth_rounding(z) && rise_below <= OUTLINE_MAX_BEND * rise;
    is_round = nearer > own_reach(MAX_NEARER_FOOTPRINTS, z, own.footprint) && bends;
    if (is_round && share < OUTLINE_ABOVE_SHARE && rise_below >= OUTLINE_MIN_BEND * rise) {
        return ABOVE;
    }
    return is_round && share > OUTLINE_BELOW_SHARE && rise_below >= 0.5 * OUTLINE_MIN_BEND * rise ? BELOW : UNTOLD;
}

// To the texels beside the own one that are on the receiver's side of its centre.
ivec2 toward_receiver(LookUp own) {
    return ivec2(own.offset.x > 0.0 ? 1 : -1, own.offset.y > 0.0 ? 1 : -1);
}

// Whether what the own texel stores leaves the receiver in sight without a look at others.
bool is_in_sight_of_centre(LookUp own, float z) {
    return leaves_in_sight(own.depth, own.height, z, own.footprint, own_reach(CERTAIN_FOOTPRINTS, z, own.footprint));
}

#ifdef THIN_WALLS
// Along a plane it changes by as much from texel to texel.
float nearness(float depth) {
#ifdef ORTHOGRAPHIC
    return -depth;
#else
    return 1.0 / depth;
#endif
}

float stored_nearness(int k, ivec2 address) {
    return nearness(depth_within(k, address));
}

// What is before the receiver for certain is nearer.
float receiver_nearness(LookUp own, float z) {
    return nearness(z - COPLANAR_FOOTPRINTS * own.footprint);
}

// Whether a texel, the own one or one beside it, has something above the receiver's plane that may stand on the plane.
bool may_stand_on_plane(LookUp own, float z, ivec2 beside) {
    float depth = stored_depth(own.address + beside);
    float height = height_of(own, depth, dot(own.facing_step, vec2(beside)));
    bool is_at_hand = depth < z && depth > z - own_reach(CONTACT_FOOTPRINTS, z, own.footprint);
    return is_at_hand && height > FOOT_FOOTPRINTS * own.footprint && !is_of_point(depth);
}

bool has_foot_at_hand(LookUp own, float z) {
    ivec2 toward = toward_receiver(own);
    return may_stand_on_plane(own, z, ivec2(0)) || may_stand_on_plane(own, z, ivec2(toward.x, 0)) ||
           may_stand_on_plane(own, z, ivec2(0, toward.y));
}

// How much farther what a texel shows is a texel on; whether it is a plane for three texels.
float fall_along(int k, ivec2 address, ivec2 on, float rounding, out bool is_plane) {
    float first = stored_nearness(k, address);
    float second = stored_nearness(k, address + on);
    float third = stored_nearness(k, address + 2 * on);
    is_plane = abs(first - 2.0 * second + third) <= PLANE_MAX_BEND * abs(first - second) + rounding;
    return first - second;
}

// Whether the plane that a texel shows, carried on, is before a receiver which the own texel's centre says is in sight, and has come down
// to the receiver's plane before it is at that centre, or is what the centre shows: then the receiver lies behind a wall's foot.
// beside: to the texel, 0 if it is the own one
bool is_behind_foot(int k, LookUp own, float z, ivec2 beside) {
    ivec2 toward = toward_receiver(own);
    ivec2 address = own.address + beside;
    float rounding = 0.25 * (receiver_nearness(own, z) - nearness(z));
    vec2 gain;  // of nearness, a texel on toward the receiver's side
    bool is_plane = true;
    for (int axis = 0; axis < 2; axis++) {
        ivec2 on = axis == 0 ? ivec2(toward.x, 0) : ivec2(0, toward.y);
        bool is_behind;
        bool is_ahead;
        float from_behind = fall_along(k, address, -on, rounding, is_behind);
        float to_ahead = -fall_along(k, address, on, rounding, is_ahead);
        // between a texel beside and the own one is where it ends
        is_behind = is_behind && beside[axis] == 0;
        gain[axis] = is_behind ? from_behind : to_ahead;
        is_plane = is_plane && (is_behind || is_ahead);
    }
    float at = stored_nearness(k, address);
    float at_centre = at - dot(vec2(abs(beside)), gain);
    float at_receiver = at + dot(abs(own.offset) - vec2(abs(beside)), gain) - FOOT_ROUNDING_TEXELS * (abs(gain.x) + abs(gain.y));
    float plane_at_centre = nearness(own.bound / own.ray_facing);
#ifdef ORTHOGRAPHIC
    vec2 tilt = abs(gain - own.facing_step * vec2(toward) / own.ray_facing);
#else
    vec2 tilt = abs(gain - own.facing_step * vec2(toward) / own.bound);
#endif
    // what hovers along the receiver's plane has no foot within a texel
    bool comes_down = at_centre <= max(plane_at_centre, nearness(own.depth - COPLANAR_FOOTPRINTS * own.footprint)) &&
                      at_centre - plane_at_centre <= tilt.x + tilt.y;
    return is_plane && comes_down && at_receiver > receiver_nearness(own, z);
}

bool is_behind_any_foot(int k, LookUp own, float z) {
    ivec2 toward = toward_receiver(own);
    bool found = false;
    for (int i = 0; i < 3; i++) {
        ivec2 beside = i == 0 ? ivec2(0) : i == 1 ? ivec2(toward.x, 0) : ivec2(0, toward.y);
        found = found || (may_stand_on_plane(own, z, beside) && is_behind_foot(k, own, z, beside));
    }
    return found;
}
#endif

// Whether a receiver that its own texel's centre says is in sight, as nothing is stored as near, may be behind a grazed outline.
bool may_be_behind_outline(LookUp own, float z) {
    bool is_beyond = HAS_CENTRES_BEYOND && own.depth >= z + MAX_DEEPER_FOOTPRINTS * own.footprint;
    return is_beyond && dot(own.offset, own.facing_step) < 0.0 && is_grazed(own);
}

// What is known of a point that the view's map does not have: it is so near that the light touches it, or beyond the window. Windows end
// where casters' outlines do, with an empty margin, and then all is lit beyond; or with the receivers that were known when they were
// fitted. at, depth: where the map would have it, and what the map has at its edge
int sight_beyond(int k, vec3 p, vec3 normal_fs, vec2 at, float depth) {
#ifdef LIT_BEYOND
    return SEEN;
#else
    if (p.z <= near_m) {
#ifdef OMNI
        return any(greaterThan(abs(p.xy), vec2(2.0 * near_m))) ? UNKNOWN : SEEN;
#else
        return SEEN;
#endif
    }
    if (abs(at.x) > FAR_TEXELS) {
        return at.x > 0.0 ? SEEN : UNKNOWN;
    }
    if (depth >= p.z) {
        return SEEN;
    }
    // nearer at the edge, and not before the receiver's plane, is its own surface
    vec2 edge = clamp(floor(at), vec2(0.0), vec2(map_size - 1)) + 0.5;
    vec2 plane = plane_on_ray(k, edge, normal_fs, dot(normal_fs, p));
    return is_below(depth, depth * plane.y - plane.x, p.z, footprint_at(p.z)) ? SEEN : UNKNOWN;
#endif
}

// What the point's own texel says. p: from the view's centre, face space; depth: what the map has there
int sight(int k, vec3 p, vec3 normal_fs, float depth) {
#ifdef SEALED
    return HIDDEN;
#endif
    if (facing_of(k, p, normal_fs) >= 0.0) {
        return HIDDEN;  // the surface itself is in the way
    }
    vec2 at = map_position(k, p);
    if (p.z <= near_m || any(lessThan(at, vec2(1.0))) || any(greaterThanEqual(at, vec2(map_size - 1)))) {
        return sight_beyond(k, p, normal_fs, at, depth);
    }
    LookUp own = look_up(k, p, normal_fs, at, depth);
    if (is_in_sight_of_centre(own, p.z)) {
        bool is_certain = !may_be_behind_outline(own, p.z);
#ifdef THIN_WALLS
        is_certain = is_certain && !has_foot_at_hand(own, p.z);
#endif
        return is_certain ? SEEN : UNDECIDED;
    }
    bool is_far = own.depth <= p.z - own_reach(CONTACT_FOOTPRINTS, p.z, own.footprint);
    return is_of_point(own.depth) || !is_far || is_below(own.depth, own.height, p.z, own.footprint) ? UNDECIDED : HIDDEN;
}

// Whether the surface is flat from a pixel to one of its neighbours.
bool is_flat_around(ivec2 pixel, vec3 normal) {
    bool flat_around = false;
    for (int i = 0; i < 4; i++) {
        ivec2 neighbour = pixel + ((i & 1) == 0 ? ivec2(i - 1, 0) : ivec2(0, i - 2));
        ivec2 within = clamp(neighbour, ivec2(0), ivec2(width, height) - 1);
        // beyond the picture's edge is nothing, and where nothing is seen the normal is 0
        vec3 other = texelFetch(normals, within, 0).xyz;
        flat_around = flat_around || (neighbour == within && all(lessThan(abs(other - normal), vec3(FLAT_NORMAL_DIFFERENCE))));
    }
    return flat_around;
}

// Whether a point is seen that its own texel left undecided. is_round: whether the surface is curved as far as the picture shows
bool seen_by_neighbours(int k, vec3 p, vec3 normal_fs, bool is_round) {
    LookUp own = look_up(k, p, normal_fs, map_position(k, p), depth_at(k, p));
#ifdef THIN_WALLS
    if (is_in_sight_of_centre(own, p.z)) {
        bool is_behind = is_behind_any_foot(k, own, p.z);
        if (is_behind || !may_be_behind_outline(own, p.z)) {
            return !is_behind;
        }
    }
#endif
    // once for all that ask: software rasterizers run every branch
    int outline = outline_of(k, own, p.z, is_round);
    if (own.depth >= p.z + MAX_DEEPER_FOOTPRINTS * own.footprint) {
        return outline != ABOVE;
    }
    ivec2 toward = toward_receiver(own);
    vec2 facing_step = own.facing_step * vec2(toward);
    float contact = own_reach(CONTACT_FOOTPRINTS, p.z, own.footprint);
    bool of_point = is_of_point(own.depth);
    bool is_far = own.depth <= p.z - contact;
    bool is_above_centre = dot(own.offset, own.facing_step) > 0.0;
    bool at_outline = false;
    bool is_own_or_crosses = is_below(own.depth, own.height, p.z, own.footprint);
    float certain = own_reach(CERTAIN_FOOTPRINTS, p.z, own.footprint);
    float at_hand = own_reach(MAX_NEARER_FOOTPRINTS, p.z, own.footprint);
    float highest = own.height;  // of the texels around the place
#ifdef POINT_MAPS
    // A texel is covered if a point lies anywhere in it, which enlarges outlines by half a texel all around, less what the points lie
    // within them. Asking all four texels around the place, but for those about whose middle it lies, shrinks them by as much.
    ivec2 beyond = toward * ivec2(greaterThan(abs(own.offset), vec2(POINT_MARGIN_TEXELS)));
    vec2 beyond_step = own.facing_step * vec2(beyond);
    vec3 depths = vec3(stored_depth(own.address + ivec2(beyond.x, 0)), stored_depth(own.address + ivec2(0, beyond.y)),
                       stored_depth(own.address + beyond));
    vec3 heights = vec3(height_of(own, depths.x, beyond_step.x), height_of(own, depths.y, beyond_step.y),
                        height_of(own, depths.z, beyond_step.x + beyond_step.y));
    // what crosses the plane in one texel does so in the next ones
    float reach = is_own_or_crosses ? certain : at_hand;
    at_outline = of_point && (either_leaves_in_sight(depths.xy, heights.xy, p.z, own.footprint, reach) ||
                              leaves_in_sight(depths.z, heights.z, p.z, own.footprint, reach));
    vec3 nearer = mix(vec3(own.height), heights, lessThan(depths, vec3(p.z)));
    highest = max(highest, max(nearer.x, max(nearer.y, nearer.z)));
#endif
    if (is_own_or_crosses) {
        // Nearer by much and yet not above the plane: that is how a surface goes on before a receiver that the light grazes, as well as any
        // place of what stands before it. Only the latter reaches to the plane's upper side.
        ivec2 up = ivec2(round(slope_of(own)));
        float depth_up = stored_depth(own.address + up);
        float height_up = height_of(own, depth_up, dot(own.facing_step, vec2(up)));
        bool ends = at_outline || leaves_in_sight(depth_up, height_up, p.z, own.footprint, certain);
        if (own.depth >= p.z - at_hand) {
            // so near the receiver's surface has folds; a wall goes on where it was
            return ends || abs(depth_up - own.depth) > certain;
        }
        // above the plane are points' planes, too, that were carried past facets' edges, but not by so much
        ends = ends && !(of_point && highest > POINT_MAX_RISE_FOOTPRINTS * own.footprint);
        bool tells = !of_point || !is_above_centre || (is_far && highest > POINT_MIN_RISE_FOOTPRINTS * own.footprint);
        return ends && !(tells && outline == ABOVE);
    }
#ifdef POINT_MAPS
    if (is_far) {
        return at_outline && !(is_grazed(own) && !is_above_centre && outline == ABOVE);
    }
#endif
    // What is so near may touch the receiver within the texel, or be the receiver itself, curved. How it rises away from the point tells
    // whether it has come down to the receiver's plane before it reaches the point.
    vec2 away = vec2(stored_depth(own.address - ivec2(toward.x, 0)), stored_depth(own.address - ivec2(0, toward.y)));
    vec2 height_away = vec2(height_of(own, away.x, -facing_step.x), height_of(own, away.y, -facing_step.y));
    vec2 rise = height_away - own.height;
    // beyond an outline is another surface, or nothing at an infinite height
    rise = mix(vec2(0.0), rise, lessThan(abs(away - own.depth), vec2(contact)));
    // what stands well above the plane in the next texel as well comes down no faster than it does on the way there: a floor of something
    // hollow, whose wall rises on the other side
    vec2 on = vec2(stored_depth(own.address + ivec2(toward.x, 0)), stored_depth(own.address + ivec2(0, toward.y)));
    vec2 height_on = vec2(height_of(own, on.x, facing_step.x), height_of(own, on.y, facing_step.y));
    bvec2 goes_on = bvec2(on.x < p.z && height_on.x > GOES_ON_FOOTPRINTS * own.footprint,
                          on.y < p.z && height_on.y > GOES_ON_FOOTPRINTS * own.footprint);
    vec2 fall = mix(rise, min(rise, max(own.height - height_on, vec2(0.0))), goes_on);
    bool seen = own.height <= dot(abs(own.offset), fall);
#ifdef POINT_MAPS
    // only what comes down to the receiver between the texels touches it; other outlines are enlarged ones
    seen = seen || (at_outline && own.height >= rise.x + rise.y);
    // What is low all around and ends beside the receiver is the surface that meets the receiver's at an edge, carried past it: rims of
    // tables, on their sides. A wall rises more within a texel.
    vec2 beside = max(height_away, height_on);
    bool is_low = max(own.height, max(beside.x, beside.y)) <= POINT_MAX_RISE_FOOTPRINTS * own.footprint;
    bool ends_beside = either_leaves_in_sight(away, height_away, p.z, own.footprint, certain) ||
                       either_leaves_in_sight(on, height_on, p.z, own.footprint, certain);
    seen = seen || (of_point && is_low && ends_beside);
#endif
    // a texel whose centre is on the plane's upper side has the surface only if it was enlarged
    bool may_pass = is_grazed(own) && (of_point || is_above_centre);
    return seen || (may_pass && outline == BELOW);
}

struct Receiver {
    vec3 p_fs;
    vec3 normal_fs;
    vec3 shading_fs;
#ifdef MANY_FACES
    vec3 p_ls;
    int late_faces;  // of a tile that is looked up again from this face on: what the batch's faces before it found goes on as it was
    bool was_lit;
#endif
};

// What a view adds to the sums. depth: what its map has where the receiver lies; unknown: light of which no map knows whether it arrives
vec2 sums_of_view(int k, Receiver receiver, float depth, inout uint undecided, inout float unknown) {
    vec3 p = receiver.p_fs - view_center(k);
    float weight = delivered(sampled_point(k), p, receiver.shading_fs);
    int found = sight(k, p, receiver.normal_fs, depth);
    bool counts = weight > 0.0;
#ifndef ORTHOGRAPHIC
    // a point on the light itself: the cosines have no direction
    counts = counts && dot(p, p) > 0.0;
#endif
#ifdef MANY_FACES
    int belongs_to = 1 << face_index(receiver.p_ls - samples[k].xyz);
    if (belongs_to != 1 << map_face) {
        // faces without casters have no map and are looked up together with the first that has one
        bool is_late = (receiver.late_faces & belongs_to) != 0;
        found = int(is_late ? !receiver.was_lit : facing_of(k, p, receiver.normal_fs) >= 0.0);
    }
    counts = counts && ((face_mask | receiver.late_faces) & belongs_to) != 0;
#endif
    undecided |= counts && found == UNDECIDED ? 1u << uint(k) : 0u;
    unknown += counts && found == UNKNOWN ? weight : 0.0;
    return counts && found != UNKNOWN ? weight * vec2(found == SEEN ? 1.0 : 0.0, 1.0) : vec2(0.0);
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
        Receiver receiver;
        receiver.p_fs = face_position(position.xyz);
        receiver.normal_fs = face_direction(normal.xyz);
        receiver.shading_fs = face_direction(unpack_direction(normal.w));
#ifdef MANY_FACES
        receiver.p_ls = light_position(position.xyz);
        receiver.late_faces = turn & LATE_FACES;
        receiver.was_lit = (turn & WAS_LIT) != 0;
#endif
#ifdef OMNI
        set_place(receiver.p_fs);
#endif
        uint undecided = 0u;
        float unknown = 0.0;
        // two views a turn, their depths asked for before either is used: maps lie far apart, and software rasterizers wait for memory.
        // Loops that test at their end: they go through those that test at their beginning once more than needed.
        int last = first_view + view_count - 1;
        int k = first_view - 2;
        do {
            k += 2;
            int other = min(k + 1, last);
            float depth = depth_at(k, receiver.p_fs - view_center(k));
            float other_depth = depth_at(other, receiver.p_fs - view_center(other));
            sums += sums_of_view(k, receiver, depth, undecided, unknown);
            if (k < last) {
                sums += sums_of_view(other, receiver, other_depth, undecided, unknown);
            }
        } while (k + 1 < last);
        if (unknown > 0.0) {
            bool is_known = texelFetch(receivers, linear_texel(int(position.w)), 0).y > 0.5;
            sums += is_known ? UNKNOWN_SHARE * unknown : unknown;
        }
        // few in most places: a loop of its own costs only where there are some, at most MAX_BATCH_VIEWS turns
        if (undecided != 0u) {
            bool is_round = !is_flat_around(pixel, normal.xyz);
            do {
                int view = findLSB(undecided);
                undecided &= undecided - 1u;
                vec3 p = receiver.p_fs - view_center(view);
                bool seen = seen_by_neighbours(view, p, receiver.normal_fs, is_round);
                sums.x += seen ? delivered(sampled_point(view), p, receiver.shading_fs) : 0.0;
            } while (undecided != 0u);
        }
    }
    add_to_pass(turn, pixel, surface, sums, before);
}
