// What surfaces that shine bring to those that rays met, from one place on them for every pixel and round: directions of lobes meet small
// ones too seldom.
#include "lib/surroundings.glsl"

const float REACHED_SHARE = 0.999;  // of the way to a place that shines: what is met before it hides it
const int EMITTER_DIMENSION = 64;   // of the sequence, apart from those of bounces

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
    Sending sending;
    if (!find_pixel(pixel) || !find_sending(pixel, sending)) {
        return;
    }
    vec2 place = shifted(pixel, vec2(sample_x, sample_y), bounce + EMITTER_DIMENSION);
    ivec2 number = ivec2(drawn_emitter(place.x).xy);
    InstanceData instance = load_instance(number.x);
    TriangleData triangle = load_triangle(instance, number.y);
    float root = sqrt(place.x);
    vec3 weights = vec3(1.0 - root, root * (1.0 - place.y), root * place.y);
    vec3 to_emitter = place_on(triangle, weights) - sending.position_ws;
    float distance_m = length(to_emitter);
    vec3 direction = to_emitter / max(distance_m, 1.0e-30);

    vec4 of_instance = emitter_row(number.x);
    vec3 front = front_of(instance, triangle, direction);
    bool is_inside = dot(front, direction) > 0.0 && of_instance.y > 0.5;  // of a solid
    float density;
    vec3 sent = sent_on(sending, direction, density);
    vec3 of_surfaces = sent_of_surfaces(sending, direction, sent);
    if (dot(direction, sending.geometric_ws) <= 0.0 || largest(of_surfaces) <= 0.0 || is_inside) {
        return;
    }
    Found found = found_around(pixel, sending, direction, false);
    if (is_met_exactly(found.how) && found.meeting.along < REACHED_SHARE * distance_m) {
        return;
    }
    // what the map leaves out no ray meets by chance
    if (any(equal(of_instance.zw, vec2(map_around(pixel))))) {
        density = 0.0;
    }
    vec3 brought = shone(number, instance, triangle, weights, front, direction, distance_m, of_surfaces, density, of_instance.x);
    imageStore(radiances, pixel, imageLoad(radiances, pixel) + vec4(brought, 0.0));
}
