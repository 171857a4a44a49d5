// The shape of a light as rays meet it, in world space. Rows of the table `lamp`: its centre and kind; its axes with its half sizes, of
// spheres radii and of suns chords from middle to rim at a metre; where it shines, and its area as seen from there.
const int LAMP_RECTANGLE = 0;
const int LAMP_ELLIPSE = 1;
const int LAMP_SPHERE = 2;
const int LAMP_SUN = 3;

#define lamp_kind (int(lamp[0].w))
#define lamp_radius (lamp[1].w)
#define lamp_area (lamp[3].w)
#define lamp_extent sqrt(lamp_area / 3.14159265)  // radius of a disc of that area

// From a place in a unit direction.
bool meets_lamp(vec3 p_ws, vec3 direction_ws) {
    vec3 shining = lamp[3].xyz;
    if (lamp_kind == LAMP_SUN) {
        vec3 aside = direction_ws + shining;
        return dot(aside, aside) <= lamp_radius * lamp_radius;
    }
    vec3 away = lamp[0].xyz - p_ws;
    if (lamp_kind == LAMP_SPHERE) {
        float along = dot(away, direction_ws);
        return along > 0.0 && dot(away, away) - along * along <= lamp_radius * lamp_radius;
    }
    float against = dot(direction_ws, shining);
    float height = dot(away, shining);
    if (against >= 0.0 || height >= 0.0) {
        return false;
    }
    vec3 at = (height / against) * direction_ws - away;
    vec2 place = vec2(dot(at, lamp[1].xyz) / lamp[1].w, dot(at, lamp[2].xyz) / lamp[2].w);
    return lamp_kind == LAMP_ELLIPSE ? dot(place, place) <= 1.0 : max(abs(place.x), abs(place.y)) <= 1.0;
}
