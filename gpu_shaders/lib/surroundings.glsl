// What lights the surfaces that rays met from around them: how they send it on to the eye, and what lies in a direction. What may be found
// in two ways is weighed by how likely each finds it (Veach & Guibas 1995, "Optimally Combining Sampling Techniques"). Each way is a kernel:
// within a loop over both, programs of materials took more than twice as long to compile as in either.
#include "lib/brdf.glsl"
#include "lib/facets.glsl"
#include "lib/march.glsl"
#include "lib/pixel_shift.glsl"
#include "lib/tiles.glsl"

const float PI = 3.14159265;

// How a surface sends light to the eye: an even lobe and a gloss, and which share of directions is drawn of the latter.
struct Sending {
    vec3 position_ws;
    vec3 geometric_ws;
    vec3 diffuse;  // radiance for an irradiance of 1
    Gloss gloss;
    vec3 normal;
    vec3 to_eye;
    float gloss_share;
    bool is_mirror;       // the gloss sends on what comes along one direction alone
    bool shows_surfaces;  // the gloss, not the world alone
};

// Of what a pixel's ray met. false: it met nothing, or nothing that would send light on
bool find_sending(ivec2 pixel, out Sending sending) {
    vec4 diffuse = texelFetch(scatterings, pixel, 0);
    vec4 glossy = texelFetch(glosses, pixel, 0);
    vec4 position = texelFetch(positions, pixel, 0);
    vec4 normal = texelFetch(normals, pixel, 0);
    vec3 to_eye = -texelFetch(ray_directions, pixel, 0).xyz;
    sending.position_ws = position.xyz;
    sending.geometric_ws = normal.xyz;
    sending.diffuse = diffuse.rgb;
    sending.gloss = kept_gloss(diffuse.w, glossy);
    sending.normal = seen_normal(unpack_direction(normal.w), to_eye);
    sending.to_eye = to_eye;
    sending.is_mirror = sending.gloss.width <= MIRROR_WIDTH;
    // what the last ray meets shows the world in its gloss, as it shows lamps; images of surfaces are for rays that go on
    bool has_gloss = glossy.w > 0.0 || is_last > 0;
    sending.shows_surfaces = has_gloss && sending.gloss.width > LEAST_LIT_WIDTH;
    float by_gloss = has_gloss ? largest(gloss_fresnel(sending.gloss, clamp(dot(sending.normal, to_eye), 0.0, 1.0))) : 0.0;
    float by_both = by_gloss + PI * largest(diffuse.rgb);
    sending.gloss_share = by_gloss / by_both;
    return position.w >= 0.0 && by_both > 0.0;
}

// What is sent on for a radiance of 1 from a direction. density: of drawing that direction
vec3 sent_on(Sending sending, vec3 direction, out float density) {
    float cosine = max(dot(sending.normal, direction), 0.0);
    vec3 sent = cosine * sending.diffuse;
    density = (1.0 - sending.gloss_share) * cosine / PI;
    if (sending.gloss_share > 0.0 && !sending.is_mirror) {
        vec3 along_half = sending.to_eye + direction;
        along_half *= inversesqrt(max(dot(along_half, along_half), 1.0e-12));
        float cos_eye = max(dot(sending.normal, sending.to_eye), LEAST_COSINE);
        float cos_light = max(cosine, LEAST_COSINE);
        float shape = cosine * ggx(sending.gloss.width, clamp(dot(sending.normal, along_half), 0.0, 1.0), cos_eye, cos_light);
        sent += shape * gloss_fresnel(sending.gloss, clamp(dot(direction, along_half), 0.0, 1.0));
        float hidden = smith(sending.gloss.width, cos_eye);
        density += sending.gloss_share * shape * (1.0 + hidden + smith(sending.gloss.width, cos_light)) / (1.0 + hidden);
    }
    return sent;
}

// The share of that which surfaces, not the world, are shown with.
vec3 sent_of_surfaces(Sending sending, vec3 direction, vec3 sent) {
    return sending.shows_surfaces ? sent : max(dot(sending.normal, direction), 0.0) * sending.diffuse;
}

// The map of what the pixel's ray met, if that is a convex reflector, as what the ray came from is left out of its own. Otherwise that; a
// cube, if it has one.
int map_around(ivec2 pixel) {
    vec4 of_met = texelFetch(instance_maps, linear_texel(int(texelFetch(positions, pixel, 0).w)), 0);
    int around_met = int(of_met.z >= 0.0 ? of_met.z : of_met.x);
    if (around_met >= 0 && own_cube(around_met) < 0) {
        return around_met;
    }
    int beside = int(texelFetch(throughputs, pixel, 0).w) % MAP_NUMBERS - 1;
    return beside >= 0 ? beside : int(texelFetch(ray_origins, pixel, 0).w);
}

// What lies in a direction, in that map; where nothing does, in the mirrored view beside a flat reflector's cube, which sees what the cube
// sees edge-on or not at all.
Found found_around(ivec2 pixel, Sending sending, vec3 direction, bool counts_by_direction) {
    vec4 ray = texelFetch(ray_origins, pixel, 0);
    float first_m = FIRST_SHARE * max(length(sending.position_ws - ray.xyz), length(sending.position_ws));
    int number = map_around(pixel);
    Found found = follow(load_map(number), sending.position_ws, direction, first_m, FAR_ALONG, counts_by_direction);
#ifndef BY_DIRECTION
    bool is_beside = number == int(texelFetch(throughputs, pixel, 0).w) % MAP_NUMBERS - 1;
    if (is_empty(found.texel) && is_beside) {
        Found in_view = march(load_map(int(ray.w)), sending.position_ws, direction, first_m, FAR_ALONG);
        if (is_met_exactly(in_view.how) && in_view.meeting.inside) {
            found = in_view;
        }
    }
#endif
    return found;
}

vec4 emitter_row(int index) {
    return texelFetch(emitters, linear_texel(index), 0);
}

vec3 place_on(TriangleData triangle, vec3 weights) {
    return weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2];
}

vec3 front_of(InstanceData instance, TriangleData triangle, vec3 direction) {
    vec3 scaled = scaled_geometric_normal(instance, triangle);
    return dot(scaled, scaled) > 0.0 ? normalize(scaled) : -direction;
}

// What a triangle's place shines against a direction, times what is sent on of it, over how likely it is found. front: the triangle's
// normal; density: of drawing the direction; per_m2: of drawing the place, on a square metre
vec3 shone(
    ivec2 number, InstanceData instance, TriangleData triangle, vec3 weights, vec3 front, vec3 direction, float distance_m,
    vec3 sent, float density, float per_m2
) {
    float facing = -dot(front, direction);
    vec3 seen = facing < 0.0 ? -front : front;
    Surface surface = surface_at(number.x, instance, triangle, number.y, weights, seen, seen);
    vec3 radiance = emitted(surface, lobes_of(surface, max(-dot(surface.normal_ws, direction), LEAST_COSINE)));
    return sent * radiance / max(density + per_m2 * distance_m * distance_m / max(abs(facing), 1.0e-6), 1.0e-30);
}
