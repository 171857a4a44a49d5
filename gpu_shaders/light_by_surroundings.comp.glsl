// What the world and surfaces that shine bring to those that rays met: along one direction of their lobes for every pixel and round, and
// from one place on what shines, which that direction would meet too seldom. What both may find is weighed by how likely each finds it
// (Veach & Guibas 1995, "Optimally Combining Sampling Techniques").
#include "lib/brdf.glsl"
#include "lib/facets.glsl"
#include "lib/march.glsl"
#include "lib/pixel_shift.glsl"
#include "lib/tiles.glsl"

const float PI = 3.14159265;
const float REACHED_SHARE = 0.999;  // of the way to a place that shines: what is met before it hides it
const int EMITTER_DIMENSION = 64;   // of the sequence, apart from those of bounces

// How a surface sends light to the eye: an even lobe and a gloss, and which share of directions is drawn of the latter.
struct Sending {
    vec3 diffuse;  // radiance for an irradiance of 1
    Gloss gloss;
    vec3 normal;
    vec3 to_eye;
    float gloss_share;
    bool is_mirror;  // the gloss sends on what comes along one direction alone
};

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

vec4 emitter_row(int index) {
    return texelFetch(emitters, linear_texel(index), 0);
}

// The triangle that a number in [0, 1) draws; the number becomes one within what draws it.
vec4 drawn_emitter(inout float at) {
    int low = 0;
    int high = emitter_count - 1;
    while (low < high) {
        int middle = (low + high) / 2;
        if (emitter_row(instance_count + middle).z > at) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    vec4 drawn = emitter_row(instance_count + low);
    float before = low > 0 ? emitter_row(instance_count + low - 1).z : 0.0;
    at = clamp((at - before) / max(drawn.z - before, 1.0e-12), 0.0, 1.0);
    return drawn;
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    vec4 diffuse = texelFetch(scatterings, pixel, 0);
    vec4 glossy = texelFetch(glosses, pixel, 0);
    vec4 position = texelFetch(positions, pixel, 0);
    vec4 normal = texelFetch(normals, pixel, 0);
    vec3 to_eye = -texelFetch(ray_directions, pixel, 0).xyz;
    Sending sending;
    sending.diffuse = diffuse.rgb;
    sending.gloss = kept_gloss(diffuse.w, glossy);
    sending.normal = seen_normal(unpack_direction(normal.w), to_eye);
    sending.to_eye = to_eye;
    sending.is_mirror = sending.gloss.width <= MIRROR_WIDTH;
    // what the last ray meets shows the world in its gloss, as it shows lamps; images of surfaces are for rays that go on
    bool has_gloss = glossy.w > 0.0 || is_last > 0;
    bool shows_surfaces = glossy.w > 0.0 && sending.gloss.width > LEAST_LIT_WIDTH;
    float by_gloss = has_gloss ? largest(gloss_fresnel(sending.gloss, clamp(dot(sending.normal, to_eye), 0.0, 1.0))) : 0.0;
    float by_both = by_gloss + PI * largest(diffuse.rgb);
    if (position.w < 0.0 || by_both <= 0.0) {
        return;
    }
    sending.gloss_share = by_gloss / by_both;

    vec2 place = shifted(pixel, vec2(sample_x, sample_y), bounce);
    bool is_gloss = place.x < sending.gloss_share;
    place.x = is_gloss ? place.x / sending.gloss_share : (place.x - sending.gloss_share) / (1.0 - sending.gloss_share);
    float masked = 1.0;
    vec3 drawn;
    if (is_gloss) {
        vec3 facet = sending.is_mirror ? sending.normal : facet_of(sending.normal, to_eye, sending.gloss.width, place, masked);
        drawn = reflect(-to_eye, facet);
    } else {
        // directions distributed as their cosine: points of a sphere around the normal's end
        float height = 1.0 - 2.0 * place.x;
        float angle = TWO_PI * place.y;
        vec3 along = sending.normal + vec3(sqrt(max(1.0 - height * height, 0.0)) * vec2(cos(angle), sin(angle)), height);
        float squared = dot(along, along);
        drawn = squared > 1.0e-8 ? along * inversesqrt(squared) : sending.normal;
    }

    vec4 ray = texelFetch(ray_origins, pixel, 0);
    float first_m = FIRST_SHARE * max(length(position.xyz - ray.xyz), length(position.xyz));
    int beside = int(texelFetch(throughputs, pixel, 0).w) % MAP_NUMBERS - 1;
    ReflectionMap map = load_map(beside >= 0 ? beside : int(ray.w));
    vec3 sum = vec3(0.0);
    for (int k = 0; k < (emitter_count > 0 ? 2 : 1); k++) {
        bool is_emitter = k == 1;
        vec3 direction = drawn;
        vec4 emitter = vec4(0.0);
        vec3 weights;
        float distance_m = FAR_ALONG;
        if (is_emitter) {
            place = shifted(pixel, vec2(sample_x, sample_y), bounce + EMITTER_DIMENSION);
            emitter = drawn_emitter(place.x);
            float root = sqrt(place.x);
            weights = vec3(1.0 - root, root * (1.0 - place.y), root * place.y);
            TriangleData triangle = load_triangle(load_instance(int(emitter.x)), int(emitter.y));
            vec3 to_emitter = weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2] -
                              position.xyz;
            distance_m = length(to_emitter);
            direction = to_emitter / max(distance_m, 1.0e-30);
        }
        float density;
        vec3 sent = sent_on(sending, direction, density);
        bool is_exact = !is_emitter && is_gloss && sending.is_mirror;
        if (is_exact) {
            sent = gloss_fresnel(sending.gloss, clamp(dot(to_eye, sending.normal), 0.0, 1.0));
            density = sending.gloss_share;
        }
        vec3 of_surfaces = shows_surfaces ? sent : max(dot(sending.normal, direction), 0.0) * sending.diffuse;
        float most = largest(is_emitter ? of_surfaces : sent);
        if (dot(direction, normal.xyz) <= 0.0 || most <= 0.0 || (!is_emitter && density <= 0.0)) {
            continue;
        }
        Found found = follow(map, position.xyz, direction, first_m, !is_emitter);
        if (is_emitter && found.how == REFLECTED_SURFACE && found.meeting.along < REACHED_SHARE * distance_m) {
            continue;
        }
        vec4 texel = is_emitter ? vec4(0.0, 0.0, emitter.xy) : found.texel;
        if (is_empty(texel)) {
            sum += sent * world_radiance(direction) / density;
            continue;
        }
        InstanceData instance = load_instance(int(texel.z));
        TriangleData triangle = load_triangle(instance, int(texel.w));
        if (!is_emitter) {
            weights = weights_within(found.meeting);
            vec3 at = weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2];
            distance_m = length(at - position.xyz);
        }
        vec3 scaled = scaled_geometric_normal(instance, triangle);
        vec3 geometric = dot(scaled, scaled) > 0.0 ? normalize(scaled) : -direction;
        float facing = -dot(geometric, direction);
        vec4 of_instance = emitter_row(int(texel.z));
        bool is_inside = is_emitter && facing < 0.0 && of_instance.y > 0.5;  // of a solid
        // what shines is where it is known to be, not where the map shows it from its centre
        bool is_elsewhere = !is_emitter && found.how == REFLECTED_BY_DIRECTION && of_instance.x > 0.0;
        if (is_inside || is_elsewhere) {
            continue;
        }
        geometric *= facing < 0.0 ? -1.0 : 1.0;
        Surface surface = surface_at(int(texel.z), instance, triangle, int(texel.w), weights, geometric, geometric);
        float emitter_density = is_exact ? 0.0 : of_instance.x * distance_m * distance_m / max(abs(facing), 1.0e-6);
        vec3 radiance = emitted(surface, lobes_of(surface, max(-dot(surface.normal_ws, direction), LEAST_COSINE)));
        sum += of_surfaces * radiance / max(density + emitter_density, 1.0e-30);
    }
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(sum, 0.0));
}
