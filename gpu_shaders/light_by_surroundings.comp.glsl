// What the world and surfaces that shine bring to those that rays met, along one direction of their lobes for every pixel and round.
#include "lib/surroundings.glsl"

void main() {
    ivec2 pixel;
    Sending sending;
    if (!find_pixel(pixel) || !find_sending(pixel, sending)) {
        return;
    }
    vec2 place = shifted(pixel, vec2(sample_x, sample_y), bounce);
    bool is_gloss = place.x < sending.gloss_share;
    place.x = is_gloss ? place.x / sending.gloss_share : (place.x - sending.gloss_share) / (1.0 - sending.gloss_share);
    float masked = 1.0;
    vec3 direction;
    if (is_gloss) {
        vec3 facet =
            sending.is_mirror ? sending.normal : facet_of(sending.normal, sending.to_eye, sending.gloss.width, place, masked);
        direction = reflect(-sending.to_eye, facet);
    } else {
        // directions distributed as their cosine: points of a sphere around the normal's end
        float height = 1.0 - 2.0 * place.x;
        float angle = TWO_PI * place.y;
        vec3 along = sending.normal + vec3(sqrt(max(1.0 - height * height, 0.0)) * vec2(cos(angle), sin(angle)), height);
        float squared = dot(along, along);
        direction = squared > 1.0e-8 ? along * inversesqrt(squared) : sending.normal;
    }
    float density;
    vec3 sent = sent_on(sending, direction, density);
    bool is_exact = is_gloss && sending.is_mirror;
    if (is_exact) {
        sent = gloss_fresnel(sending.gloss, clamp(dot(sending.to_eye, sending.normal), 0.0, 1.0));
        density = sending.gloss_share;
    }
    if (dot(direction, sending.geometric_ws) <= 0.0 || largest(sent) <= 0.0 || density <= 0.0) {
        return;
    }
    Found found = found_around(pixel, sending, direction, true);
    vec3 brought = vec3(0.0);
    if (is_empty(found.texel)) {
        brought = sent * world_radiance(direction) / density;
    }
#ifdef EMISSION
    else if (!is_exact) {  // mirrors show images of surfaces to rays that go on
        ivec2 number = ivec2(found.texel.zw);
        vec4 of_instance = emitter_row(number.x);
#ifdef BY_DIRECTION
        const bool is_met = true;
#else
        // what shines is where it is known to be, not where the map shows it from its centre
        bool is_met = found.how != REFLECTED_BY_DIRECTION;
#endif
        if (is_met) {
            InstanceData instance = load_instance(number.x);
            TriangleData triangle = load_triangle(instance, number.y);
            vec3 weights = weights_within(found.meeting);
            float distance_m = length(place_on(triangle, weights) - sending.position_ws);
            vec3 front = front_of(instance, triangle, direction);
            // no place is drawn on the inner side of a solid
            float per_m2 = of_instance.y > 0.5 && dot(front, direction) > 0.0 ? 0.0 : of_instance.x;
            vec3 of_surfaces = sent_of_surfaces(sending, direction, sent);
            brought = shone(number, instance, triangle, weights, front, direction, distance_m, of_surfaces, density, per_m2);
        }
    }
#endif
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(brought, 0.0));
}
