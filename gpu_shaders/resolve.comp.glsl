// Looks every visible surface up in the depth maps of a batch and adds to the pass's running sums.
//
// The pass is sum(visible * delivered) / sum(delivered) over light samples and eye samples. What sample k would deliver:
// the shading normal's cosine, the light's cosine and spread, and 1 / distance^2; all without the light's strength.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/face.glsl"

#define view_sample(k) (views[2 * (k) + 1].zw)  // of the view's centre, light space
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
#ifdef POINT_MAPS
const float BIAS_FOOTPRINTS = 1.0 / 4.0;  // ... planes of facets that points carry past the facets' edges, half a texel
#else
const float BIAS_FOOTPRINTS = 1.0 / 12.0;  // ... facets of about a texel
#endif
const float DEPTH_ROUNDING = 4.0e-7;  // share of the depth that float32 does not tell apart after some operations

float delivered(vec3 p, float squared_distance, vec3 shading_fs) {
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

float stored_depth(ivec2 address) {
    return uintBitsToFloat(texelFetch(depth_maps, address, 0).x);
}

// Whether what a texel stores leaves a receiver at depth z in sight. height: of the stored point above the receiver's tangent plane.
bool leaves_in_sight(float depth, float height, float z, float footprint) {
    float reach = MAX_NEARER_FOOTPRINTS * footprint;
    float rounding = DEPTH_ROUNDING * z;
    float tolerance = BIAS_FOOTPRINTS * footprint + BIAS_ANGLE * min(abs(depth - z), reach) + rounding;
    bool is_plane = height <= tolerance && (depth >= z - reach || abs(height) <= COPLANAR_FOOTPRINTS * footprint + rounding);
    return is_plane || depth >= z + MAX_DEEPER_FOOTPRINTS * footprint;
}

const int SEEN = 0;
const int HIDDEN = 1;
const int UNDECIDED = 2;  // takes a look at the neighbouring texels

struct LookUp {
    ivec2 address;
    vec2 offset;       // of the point from the texel's centre, texels
    vec2 facing_step;  // by which ray_facing grows from texel to texel
    float ray_facing;  // the normal's part along the ray through the texel's centre
    float facing;      // the same along p: height = depth * ray_facing - facing
    float footprint;
    float depth;
    float height;
};

// Of a point that lies in the view's map. p: from the view's centre, face space.
LookUp look_up(int k, vec3 p, vec3 normal_fs, vec2 at) {
    LookUp own;
    ivec2 texel = ivec2(floor(at));
    own.address = texel + ivec2(0, view_first_row(k));
    own.offset = at - vec2(texel) - 0.5;
    own.facing = dot(normal_fs, p);
    own.facing_step = normal_fs.xy * texel_tangent;
    own.ray_facing = own.facing * (1.0 / p.z) - dot(own.facing_step, own.offset);
    own.footprint = p.z * footprint_share;
    own.depth = stored_depth(own.address);
    own.height = own.depth * own.ray_facing - own.facing;
    return own;
}

vec2 map_place(int k, vec3 p) {
    return p.xy * texels_per_tangent * (1.0 / p.z) - view_window(k);
}

// What the point's own texel says. p: from the view's centre, face space.
int sight(int k, vec3 p, vec3 normal_fs) {
    if (dot(normal_fs, p) >= 0.0) {
        return HIDDEN;  // the surface itself is in the way
    }
    vec2 at = map_place(k, p);
    // outside every caster's outline (windows have a margin), or so near that the light touches it
    if (p.z <= near_m || any(lessThan(at, vec2(1.0))) || any(greaterThanEqual(at, vec2(map_size - 1)))) {
        return SEEN;
    }
    LookUp own = look_up(k, p, normal_fs, at);
    if (leaves_in_sight(own.depth, own.height, p.z, own.footprint)) {
        return SEEN;
    }
#ifdef POINT_MAPS
    return UNDECIDED;
#else
    return own.depth > p.z - CONTACT_FOOTPRINTS * own.footprint ? UNDECIDED : HIDDEN;
#endif
}

// Whether a point is seen that its own texel left undecided.
bool seen_by_neighbours(int k, vec3 p, vec3 normal_fs) {
    LookUp own = look_up(k, p, normal_fs, map_place(k, p));
    ivec2 toward = ivec2(own.offset.x > 0.0 ? 1 : -1, own.offset.y > 0.0 ? 1 : -1);
    vec2 facing_step = own.facing_step * vec2(toward);
    float contact = CONTACT_FOOTPRINTS * own.footprint;
#ifdef POINT_MAPS
    // A texel is covered if a point lies anywhere in it, which enlarges outlines by half a texel all around. Asking all
    // four texels around the place shrinks them by as much.
    float depth_x = stored_depth(own.address + ivec2(toward.x, 0));
    float depth_y = stored_depth(own.address + ivec2(0, toward.y));
    float depth_xy = stored_depth(own.address + toward);
    vec3 heights = vec3(depth_x, depth_y, depth_xy) * (own.ray_facing + vec3(facing_step, facing_step.x + facing_step.y)) - own.facing;
    bool at_outline = leaves_in_sight(depth_x, heights.x, p.z, own.footprint) || leaves_in_sight(depth_y, heights.y, p.z, own.footprint) ||
                      leaves_in_sight(depth_xy, heights.z, p.z, own.footprint);
    if (own.depth <= p.z - contact) {
        return at_outline;
    }
#endif
    // What is so near may touch the receiver within the texel, or be the receiver itself, curved. How it rises away from the point tells
    // whether it has come down to the receiver's plane before it reaches the point.
    vec2 away = vec2(stored_depth(own.address - ivec2(toward.x, 0)), stored_depth(own.address - ivec2(0, toward.y)));
    vec2 rise = away * (own.ray_facing - facing_step) - own.facing - own.height;
    // beyond an outline is another surface, or nothing at an infinite height
    rise = mix(vec2(0.0), rise, lessThan(abs(away - own.depth), vec2(contact)));
    bool seen = own.height <= dot(abs(own.offset), rise);
#ifdef POINT_MAPS
    // only what comes down to the receiver between the texels touches it; other outlines are enlarged ones
    seen = seen || (at_outline && own.height >= rise.x + rise.y);
#endif
    return seen;
}

// Which face of the light's half cube a direction belongs to (light space: x, y in the light's plane, z along its axis).
int face_index(vec3 d) {
    vec2 side = abs(d.xy);
    if (d.z >= max(side.x, side.y)) {
        return 0;
    }
    return side.x >= side.y ? (d.x > 0.0 ? 1 : 2) : (d.y > 0.0 ? 3 : 4);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= width || pixel.y >= height) {
        return;
    }
    vec4 position = texelFetch(positions, pixel, 0);
    bool surface = position.w >= 0.0;
#ifdef RECEIVER_LINKING
    surface = surface && texelFetch(receivers, linear_texel(int(position.w)), 0).x > 0.5;
#endif
    vec2 sums = first_face != 0 ? vec2(0.0) : imageLoad(batch_sums, pixel).xy;
    if (surface) {
        vec4 normal = texelFetch(normals, pixel, 0);
        vec3 p_fs = face_position(position.xyz);
        vec3 normal_fs = face_direction(normal.xyz);
        vec3 shading_fs = face_direction(unpack_direction(normal.w));
#ifdef MANY_FACES
        vec3 p_ls = vec3(dot(face[8], vec4(position.xyz, 1.0)), dot(face[9], vec4(position.xyz, 1.0)), dot(face[10], vec4(position.xyz, 1.0)));
#endif
        uint undecided = 0u;
        for (int k = 0; k < view_count; k++) {
            vec3 p = p_fs - view_center(k);
            float squared_distance = dot(p, p);
            // a point on the light itself: the cosines have no direction
            if (!(squared_distance > 0.0)) {
                continue;
            }
#ifdef MANY_FACES
            int belongs_to = face_index(vec3(p_ls.xy - view_sample(k), p_ls.z));
            if ((face_mask & (1 << belongs_to)) == 0) {
                continue;
            }
            bool in_map = belongs_to == map_face;
#else
            const bool in_map = true;
#endif
            float weight = delivered(p, squared_distance, shading_fs);
            if (weight > 0.0) {
                // faces without casters have no map and are looked up together with the first that has one
                int found = in_map ? sight(k, p, normal_fs) : int(dot(normal_fs, p) >= 0.0);
                sums += weight * vec2(found == SEEN ? 1.0 : 0.0, 1.0);
                undecided |= found == UNDECIDED ? 1u << uint(k) : 0u;
            }
        }
        // few in most places: a loop of its own costs only where there are some, at most MAX_BATCH_VIEWS turns
        while (undecided != 0u) {
            int k = findLSB(undecided);
            undecided &= undecided - 1u;
            vec3 p = p_fs - view_center(k);
            sums.x += seen_by_neighbours(k, p, normal_fs) ? delivered(p, dot(p, p), shading_fs) : 0.0;
        }
    }
    if (last_face == 0) {
        imageStore(batch_sums, pixel, vec4(sums, 0.0, 0.0));
        return;
    }
    if (surface) {
        imageStore(moments, pixel, imageLoad(moments, pixel) + vec4(sums, sums.x * sums.x, sums.x * sums.y));
        imageStore(coverage, pixel, imageLoad(coverage, pixel) + vec4(sums.y * sums.y, 1.0, 0.0, 0.0));
    }
}
