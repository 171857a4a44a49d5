// Looks every visible surface up in the depth maps of a batch and adds to the pass's running sums.
//
// The pass is sum(visible * delivered) / sum(delivered) over light samples and eye samples. What sample k would deliver:
// the shading normal's cosine, the light's cosine and spread or cone, and 1 / distance^2; all without the light's strength.
#include "lib/tiles.glsl"
#include "lib/octahedral.glsl"
#include "lib/view.glsl"
#include "lib/cube_faces.glsl"
#include "lib/pass_states.glsl"

#define light_axis_fs (face[5].xyz)
#define tan_half_spread (face[5].w)
#define reference_squared_distance (face[4].z)  // keeps sums near 1 in scenes of any scale

// What is stored deeper than the receiver by more does not hide it: beyond a silhouette the tangent plane runs away along the ray while
// the surface ends.
const float MAX_DEEPER_FOOTPRINTS = 8.0;
// What stands nearer than the receiver by more is not the receiver, although the plane of one seen edge-on may pass before it: there
// only what lies in the plane is.
const float MAX_NEARER_FOOTPRINTS = 8.0;
// What stands before the receiver by less may touch it within a texel: so steep are walls that are told from outlines.
const float CONTACT_FOOTPRINTS = 16.0;
const float COPLANAR_FOOTPRINTS = 1.0 / 64.0;  // several times what the rasterizer's snapping of corners to 1/256 texel moves a plane
// How high above the tangent plane a stored point may lie and still be the receiver: curvature within a texel, as an angle, and ...
const float BIAS_ANGLE = 1.0 / 48.0;
const float POINT_BIAS_FOOTPRINTS = 1.0 / 4.0;  // ... planes of facets that points carry past the facets' edges, half a texel
const float RASTER_BIAS_FOOTPRINTS = 1.0 / 12.0;  // ... facets of about a texel

#ifdef ORTHOGRAPHIC
#define ray_direction(k) (samples[k].xyz)
#endif
#ifdef OMNI
#define light_radius_m (face[7].x)
#define soft_falloff (face[7].y > 0.5)
#define cos_half_cone (face[7].z)
#define per_blend_cosine (face[7].w)
#define cone_right_fs (face[11].xyz)
#define cone_up_fs (face[12].xyz)

// What a point is to the light as a whole. SPHERE: every sample is seen under the cosine to the sphere's normal. From outside a
// sphere only its near side shines, from inside all of it does. With a soft falloff it stands for a disc through its centre that
// faces the point: it is seen under the directions that meet the disc, twice from outside (the near side and the far side, which
// see the same as long as nothing casts within the sphere), once from inside.
struct Place {
    vec3 p_fs;
    bool inside;
    float gain;  // the disc's or sphere's irradiance is that of its centre, whatever counts
    float disc;  // share of squared cosines to the centre's direction that meet the disc, times squared distance of the point
};

Place place;  // of the receiver that this invocation looks up

void set_place(vec3 p_fs) {
    float squared = dot(p_fs, p_fs);
    float squared_radius = light_radius_m * light_radius_m;
    place.p_fs = p_fs;
    place.inside = squared < squared_radius;
    place.gain = soft_falloff && !place.inside ? 2.0 : 4.0;
    place.disc = soft_falloff ? squared * (squared / (squared + squared_radius)) : 0.0;
}

float delivered(int k, vec3 p, vec3 shading_fs) {
    float squared_distance = dot(p, p);
    float receiver = -dot(shading_fs, p);
    if (receiver <= 0.0) {
        return 0.0;
    }
#ifdef SPHERE
    float emitter = dot(view_center(k), p) / light_radius_m;
    if (soft_falloff) {
        float ahead = dot(p, place.p_fs);
        emitter = ahead > 0.0 && ahead * ahead >= squared_distance * place.disc ? abs(emitter) : 0.0;
    } else {
        emitter = max(place.inside ? -emitter : emitter, 0.0);
    }
    emitter *= place.gain * samples[k].w;
#else
    float emitter = sqrt(squared_distance);
#endif
    float inverse = 1.0 / squared_distance;
    float weight = (receiver * inverse) * (emitter * inverse) * reference_squared_distance;
#ifdef CONE
    // Blender's spot: smooth in the cosine to the axis of the cone's own, scaled space
    vec3 local = vec3(dot(cone_right_fs, p), dot(cone_up_fs, p), dot(light_axis_fs, p));
    float fade = clamp((local.z * inversesqrt(dot(local, local)) - cos_half_cone) * per_blend_cosine, 0.0, 1.0);
    bool everywhere = place.inside && !soft_falloff;
    weight *= everywhere ? 1.0 : fade * fade * (3.0 - 2.0 * fade);
#endif
    return weight;
}
#else
#ifdef ORTHOGRAPHIC
float delivered(int k, vec3 p, vec3 shading_fs) {
    return max(-dot(shading_fs, ray_direction(k)), 0.0);
}
#else
float delivered(int k, vec3 p, vec3 shading_fs) {
    float squared_distance = dot(p, p);
    float receiver = -dot(shading_fs, p);
    float emitter = dot(light_axis_fs, p);
    if (receiver <= 0.0 || emitter <= 0.0) {
        return 0.0;
    }
    float inverse = 1.0 / squared_distance;
    float weight = (receiver * inverse) * (emitter * inverse) * reference_squared_distance;
    if (tan_half_spread > 0.0) {
        // Blender's area light spread: linear in the tangent of the angle to the light's axis
        float tangent = sqrt(max(squared_distance - emitter * emitter, 0.0)) / emitter;
        weight *= max(1.0 - tangent / tan_half_spread, 0.0);
    }
    return weight;
}
#endif
#endif

float stored_depth(ivec2 address) {
    return uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
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

// Whether what a texel stores leaves a receiver at depth z in sight. height: of the stored point above the receiver's tangent plane.
bool leaves_in_sight(float depth, float height, float z, float footprint) {
    float reach = MAX_NEARER_FOOTPRINTS * footprint;
    float rounding = depth_rounding(z);
    float bias_footprints = is_of_point(depth) ? POINT_BIAS_FOOTPRINTS : RASTER_BIAS_FOOTPRINTS;
    float tolerance = bias_footprints * footprint + BIAS_ANGLE * min(abs(depth - z), reach) + rounding;
    bool is_plane = height <= tolerance && (depth >= z - reach || abs(height) <= COPLANAR_FOOTPRINTS * footprint + rounding);
    return is_plane || depth >= z + MAX_DEEPER_FOOTPRINTS * footprint;
}

const int SEEN = 0;
const int HIDDEN = 1;
const int UNDECIDED = 2;  // takes a look at the neighbouring texels

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

// Of a point that lies in the view's map. p: from the view's centre, face space.
LookUp look_up(int k, vec3 p, vec3 normal_fs, vec2 at) {
    LookUp own;
    ivec2 texel = ivec2(floor(at));
    own.address = texel + ivec2(0, view_first_row(k));
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
    own.depth = stored_depth(own.address);
    own.height = height_of(own, own.depth, 0.0);
    return own;
}

// What the point's own texel says. p: from the view's centre, face space.
int sight(int k, vec3 p, vec3 normal_fs) {
    if (facing_of(k, p, normal_fs) >= 0.0) {
        return HIDDEN;  // the surface itself is in the way
    }
    vec2 at = map_position(k, p);
    // outside every caster's outline (windows have a margin), or so near that the light touches it
    if (p.z <= near_m || any(lessThan(at, vec2(1.0))) || any(greaterThanEqual(at, vec2(map_size - 1)))) {
        return SEEN;
    }
    LookUp own = look_up(k, p, normal_fs, at);
    if (leaves_in_sight(own.depth, own.height, p.z, own.footprint)) {
        return SEEN;
    }
    return is_of_point(own.depth) || own.depth > p.z - CONTACT_FOOTPRINTS * own.footprint ? UNDECIDED : HIDDEN;
}

// Whether a point is seen that its own texel left undecided.
bool seen_by_neighbours(int k, vec3 p, vec3 normal_fs) {
    LookUp own = look_up(k, p, normal_fs, map_position(k, p));
    ivec2 toward = ivec2(own.offset.x > 0.0 ? 1 : -1, own.offset.y > 0.0 ? 1 : -1);
    vec2 facing_step = own.facing_step * vec2(toward);
    float contact = CONTACT_FOOTPRINTS * own.footprint;
#ifdef POINT_MAPS
    // A texel is covered if a point lies anywhere in it, which enlarges outlines by half a texel all around. Asking all
    // four texels around the place shrinks them by as much.
    float depth_x = stored_depth(own.address + ivec2(toward.x, 0));
    float depth_y = stored_depth(own.address + ivec2(0, toward.y));
    float depth_xy = stored_depth(own.address + toward);
    bool at_outline = is_of_point(own.depth) &&
                      (leaves_in_sight(depth_x, height_of(own, depth_x, facing_step.x), p.z, own.footprint) ||
                       leaves_in_sight(depth_y, height_of(own, depth_y, facing_step.y), p.z, own.footprint) ||
                       leaves_in_sight(depth_xy, height_of(own, depth_xy, facing_step.x + facing_step.y), p.z, own.footprint));
    if (own.depth <= p.z - contact) {
        return at_outline;
    }
#endif
    // What is so near may touch the receiver within the texel, or be the receiver itself, curved. How it rises away from the point tells
    // whether it has come down to the receiver's plane before it reaches the point.
    vec2 away = vec2(stored_depth(own.address - ivec2(toward.x, 0)), stored_depth(own.address - ivec2(0, toward.y)));
    vec2 rise = vec2(height_of(own, away.x, -facing_step.x), height_of(own, away.y, -facing_step.y)) - own.height;
    // beyond an outline is another surface, or nothing at an infinite height
    rise = mix(vec2(0.0), rise, lessThan(abs(away - own.depth), vec2(contact)));
    bool seen = own.height <= dot(abs(own.offset), rise);
#ifdef POINT_MAPS
    // only what comes down to the receiver between the texels touches it; other outlines are enlarged ones
    seen = seen || (at_outline && own.height >= rise.x + rise.y);
#endif
    return seen;
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    bool surface = position.w >= 0.0;
#ifdef RECEIVER_LINKING
    surface = surface && texelFetch(receivers, linear_texel(int(position.w)), 0).x > 0.5;
#endif
#ifdef PROBES
    const int late_faces = 0;
    const bool was_lit = false;
    vec2 sums = vec2(0.0);
#else
    int turn = int(own_tile().z);
    // of a tile that is looked up again from this face on: what the batch's faces before it found goes on as it was
    int late_faces = turn & LATE_FACES;
    bool was_lit = (turn & WAS_LIT) != 0;
    vec2 sums = (turn & FIRST_FACE) != 0 ? vec2(0.0) : imageLoad(batch_sums, pixel).xy;
#endif
    if (surface && view_count > 0) {
        vec4 normal = texelFetch(normals, pixel, 0);
        vec3 p_fs = face_position(position.xyz);
        vec3 normal_fs = face_direction(normal.xyz);
        vec3 shading_fs = face_direction(unpack_direction(normal.w));
#ifdef MANY_FACES
        vec3 p_ls = light_position(position.xyz);
#endif
#ifdef OMNI
        set_place(p_fs);
#endif
        uint undecided = 0u;
        // loops that test at their end: software rasterizers go through those that test at their beginning once more than needed
        int k = first_view - 1;
        do {
            k++;
            vec3 p = p_fs - view_center(k);
#ifndef ORTHOGRAPHIC
            // a point on the light itself: the cosines have no direction
            if (!(dot(p, p) > 0.0)) {
                continue;
            }
#endif
#ifdef MANY_FACES
            int belongs_to = face_index(p_ls - samples[k].xyz);
            if (((face_mask | late_faces) & (1 << belongs_to)) == 0) {
                continue;
            }
            bool in_map = belongs_to == map_face;
            bool is_late = (late_faces & (1 << belongs_to)) != 0;
#else
            const bool in_map = true;
            const bool is_late = false;
#endif
            float weight = delivered(k, p, shading_fs);
            if (weight > 0.0) {
                // faces without casters have no map and are looked up together with the first that has one
                int found = in_map ? sight(k, p, normal_fs) : int(is_late ? !was_lit : facing_of(k, p, normal_fs) >= 0.0);
                sums += weight * vec2(found == SEEN ? 1.0 : 0.0, 1.0);
                undecided |= found == UNDECIDED ? 1u << uint(k) : 0u;
            }
        } while (k + 1 < first_view + view_count);
        // few in most places: a loop of its own costs only where there are some, at most MAX_BATCH_VIEWS turns
        if (undecided != 0u) {
            do {
                int view = findLSB(undecided);
                undecided &= undecided - 1u;
                vec3 p = p_fs - view_center(view);
                sums.x += seen_by_neighbours(view, p, normal_fs) ? delivered(view, p, shading_fs) : 0.0;
            } while (undecided != 0u);
        }
    }
#ifdef PROBES
    vec4 tile = own_tile();
    uint state = uint(tile.z);
    bool is_lit = state == STATE_LIT && wholly_lit(sums);
    bool is_dark = state == STATE_DARK && sums.x == 0.0;
    if (surface ? !is_lit && !is_dark : state != STATE_BACKGROUND) {
        imageStore(disagreeing, ivec2(tile.xy), uvec4(1u));
    }
#else
    if ((turn & LAST_FACE) == 0) {
        imageStore(batch_sums, pixel, vec4(sums, 0.0, 0.0));
        return;
    }
    // rounds that the tile was left out of count as those before them
    float repeats = own_tile().w;
    if (surface || repeats != 1.0) {
        imageStore(moments, pixel, repeats * imageLoad(moments, pixel) + vec4(sums, sums.x * sums.x, sums.x * sums.y));
        imageStore(coverage, pixel, repeats * imageLoad(coverage, pixel) + vec4(sums.y * sums.y, surface ? 1.0 : 0.0, 0.0, 0.0));
    }
#endif
}
