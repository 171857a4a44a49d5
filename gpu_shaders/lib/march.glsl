// Follows rays through maps of reflectors.
//
// A ray crosses the cells of a map one after the other; cells of coarser levels whose depths it does not reach are crossed at once
// (Uludag 2014, "Hi-Z Screen-Space Cone-Traced Reflections"). What a texel says is only which triangle to ask: where the ray meets it is
// computed exactly.
#include "lib/scene_data.glsl"
#include "lib/reflection_map.glsl"

const float FAR_ALONG = 1.0e30;
const vec2 NOWHERE = vec2(FAR_ALONG, -FAR_ALONG);
const float STEP_PAST = 1.0e-3;       // of the way through a cell, to be in the next one
const float ROUNDING = 1.0e-6;        // of the distance to the map's centre
const float OWN_SHARE = 10.0;         // of what is rounding to other surfaces, in maps of what the ray begins in
const float SAME_PLACE_SHARE = 1.0e-4;  // of how far along a ray it is: two maps may show one surface
const float INSIDE_TOLERANCE = 1.0e-4;  // of barycentric weights: neighbours leave nothing between them

struct Meeting {
    float along;  // the ray, metres; FAR_ALONG: none
    vec2 weights;  // of the triangle's second and third corner
    bool inside;   // of the triangle, not only of its plane
};

// Where the ray meets a triangle's plane (Moeller & Trumbore 1997).
Meeting meet(vec3 origin_ws, vec3 direction_ws, vec4 texel) {
    InstanceData instance = load_instance(int(texel.z));
    TriangleData triangle = load_triangle(instance, int(texel.w));
    vec3 edge_1 = triangle.position_ws[1] - triangle.position_ws[0];
    vec3 edge_2 = triangle.position_ws[2] - triangle.position_ws[0];
    vec3 p = cross(direction_ws, edge_2);
    float determinant = dot(edge_1, p);
    Meeting meeting = Meeting(FAR_ALONG, vec2(1.0 / 3.0), false);
    if (determinant != 0.0) {
        vec3 s = origin_ws - triangle.position_ws[0];
        vec3 q = cross(s, edge_1);
        vec2 weights = vec2(dot(s, p), dot(direction_ws, q)) / determinant;
        meeting.along = dot(edge_2, q) / determinant;
        meeting.weights = weights;
        meeting.inside = all(greaterThanEqual(vec3(weights, 1.0 - weights.x - weights.y), vec3(-INSIDE_TOLERANCE)));
    }
    return meeting;
}

// Barycentric weights of the place of the triangle that is nearest to where its plane is met: planes are met beside their triangles too.
vec3 weights_within(Meeting meeting) {
    vec3 weights = max(vec3(1.0 - meeting.weights.x - meeting.weights.y, meeting.weights), 0.0);
    return weights / (weights.x + weights.y + weights.z);
}

// Whether a place is just behind a triangle's plane, seen from the map's centre: then it is on the surface that goes on there, which falls
// away from the plane, and no ray from it meets the plane's continuation.
bool is_just_behind(ReflectionMap map, vec3 place_ws, vec4 texel, float reach_m) {
    InstanceData instance = load_instance(int(texel.z));
    TriangleData triangle = load_triangle(instance, int(texel.w));
    vec3 scaled = cross(triangle.position_ws[1] - triangle.position_ws[0], triangle.position_ws[2] - triangle.position_ws[0]);
    float height = dot(scaled, place_ws - triangle.position_ws[0]);
    return height * dot(scaled, map.center_ws - triangle.position_ws[0]) < 0.0 && height * height < reach_m * reach_m * dot(scaled, scaled);
}

bool is_empty(vec4 texel) {
    return texel.z < 0.0;
}

// Whether a ray met what a map shows at that very place: perhaps not the first thing on its way.
bool is_met_exactly(int how) {
    return how == REFLECTED_SURFACE || how == REFLECTED_BEHIND;
}

vec4 map_texel(ReflectionMap map, int level, int face, ivec2 cell) {
    return texelFetch(map_texels, linear_texel(map_index(map, level, face, cell)), 0);
}

struct Found {
    Meeting meeting;
    vec4 texel;
    int how;
};

// Of the three texels next to one of the finest level, towards a place, the triangle that the ray meets first, within its edges.
Found meet_neighbours(ReflectionMap map, int face, ivec2 own, vec2 place, vec3 origin_ws, vec3 direction_ws, vec2 between) {
    Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), REFLECTED_NOTHING);
    ivec2 toward = ivec2(place.x - float(own.x) > 0.5 ? 1 : -1, place.y - float(own.y) > 0.5 ? 1 : -1);
    for (int k = 1; k < 4; k++) {
        ivec2 cell = own + toward * ivec2(k & 1, k >> 1);
        if (any(lessThan(cell, ivec2(0))) || any(greaterThanEqual(cell, map.size))) {
            continue;
        }
        vec4 texel = map_texel(map, 0, face, cell);
        if (is_empty(texel)) {
            continue;
        }
        Meeting meeting = meet(origin_ws, direction_ws, texel);
        if (meeting.inside && meeting.along >= between.x && meeting.along <= between.y && meeting.along < found.meeting.along) {
            found = Found(meeting, texel, REFLECTED_SURFACE);
        }
    }
    return found;
}

// From where to where along a ray it is in a ball around the origin.
vec2 within_ball(vec3 start, vec3 direction, float radius) {
    float middle = -dot(start, direction);
    float half_chord = radius * radius - dot(start, start) + middle * middle;
    return half_chord > 0.0 ? middle + sqrt(half_chord) * vec2(-1.0, 1.0) : NOWHERE;
}

// The ray from its origin on; nothing is met before `first_m`, and what is met beyond `last_m` may be left out.
Found march(ReflectionMap map, vec3 origin_ws, vec3 direction_ws, float first_m, float last_m) {
    vec3 start = map_direction(map, origin_ws - map.center_ws);
    vec3 direction = map_direction(map, direction_ws);
    Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), REFLECTED_NOTHING);
    // all that the map shows is in the ball of its reach
    vec2 within = within_ball(start, direction, map.reach_m);
    float end = within.y;
    if (end <= 0.0) {
        return found;
    }
    float along = max(within.x, 0.0);
    int level = MAP_LEVELS - 1;
    int step_count = 0;
    bool was_behind = false;
    do {
        step_count++;
        vec3 p = start + along * direction;
        int face = face_of(map, p);
        vec3 f = in_face(face, p);
        vec3 g = in_face(face, direction);
        if (f.z < 0.5 * map.near_m) {
            // nothing is there, and at the centre itself a place has no direction
            if (!map.is_cube) {
                found.how = REFLECTED_OUT_OF_VIEW;
                break;
            }
            along += 0.5 * map.near_m;
            continue;
        }
        vec2 tangent = f.xy / f.z;
        vec2 cell_size = map.texel * float(1 << level);
        ivec2 cells = map.size >> level;
        vec2 place = (tangent - map.corner) / cell_size;
        if (!map.is_cube && (any(lessThan(place, vec2(0.0))) || any(greaterThanEqual(place, vec2(cells))))) {
            found.how = REFLECTED_OUT_OF_VIEW;
            break;
        }
        ivec2 cell = clamp(ivec2(floor(place)), ivec2(0), cells - 1);
        // the planes through the centre and the cell's sides, those that the ray goes towards
        vec4 sides = map.corner.xyxy + vec4(cell, cell + 1) * cell_size.xyxy;
        vec4 rate = (g.xyxy - sides * g.z) * vec4(-1.0, -1.0, 1.0, 1.0);
        vec4 distance_left = max((sides * f.z - f.xyxy) * vec4(-1.0, -1.0, 1.0, 1.0), 0.0);
        vec4 lengths = mix(vec4(FAR_ALONG), distance_left / rate, greaterThan(rate, vec4(0.0)));
        float crossing = min(min(min(lengths.x, lengths.y), min(lengths.z, lengths.w)), end - along);
        // surfaces between the places that two neighbours see belong to neither: each is asked a texel's way back as well
        float texel_crossing = min(map.texel.x, map.texel.y) * f.z / max(length(g.xy - tangent * g.z), 1.0e-20);
        float back = min(texel_crossing, along);
        if (along - back > last_m) {
            break;
        }
        float depth_in = f.z - back * g.z;
        float depth_out = f.z + crossing * g.z;
        vec4 texel = map_texel(map, level, face, cell);
        if (min(depth_in, depth_out) <= texel.y && max(depth_in, depth_out) >= texel.x) {
            if (level > 0) {
                level--;
                continue;
            }
            vec2 between = vec2(max(along - back, first_m), along + crossing);
            Meeting meeting = meet(origin_ws, direction_ws, texel);
            bool is_between = meeting.along >= between.x && meeting.along <= between.y;
            bool is_met = is_between && meeting.inside;
            // of a curved surface, rays that leave it would meet the facets beside theirs
            is_between = is_met || (is_between && !is_just_behind(map, origin_ws, texel, map.texel.x * f.z));
            // beside an outline the texel's centre sees past what the ray meets, or meets what the ray passes by
            float before = is_met ? meeting.along : between.y + texel_crossing;
            vec3 at = f + ((is_between ? meeting.along : along + 0.5 * min(crossing, texel_crossing)) - along) * g;
            vec2 place_there = (at.xy / max(at.z, map.near_m) - map.corner) / map.texel;
            Found nearby = meet_neighbours(map, face, cell, place_there, origin_ws, direction_ws, vec2(between.x, before));
            if (nearby.how == REFLECTED_SURFACE || is_between) {
                found = nearby.how == REFLECTED_SURFACE ? nearby : Found(meeting, texel, REFLECTED_SURFACE);
                found.how = was_behind ? REFLECTED_BEHIND : REFLECTED_SURFACE;
                break;
            }
        }
        was_behind = was_behind || (texel.y > 0.0 && min(depth_in, depth_out) > texel.y);
        along += crossing + max(STEP_PAST * min(crossing, texel_crossing), ROUNDING * max(f.z, length(f)));
        level = min(level + 1, MAP_LEVELS - 1);
    } while (along < end && step_count < MAX_STEPS);
    return found;
}

// What the map shows in the ray's direction from its centre: right for what is far away.
Found look_up_direction(ReflectionMap map, vec3 direction_ws) {
    vec3 direction = map_direction(map, direction_ws);
    int face = face_of(map, direction);
    vec3 f = in_face(face, direction);
    Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), map.is_cube ? REFLECTED_NOTHING : REFLECTED_OUT_OF_VIEW);
    vec2 place = (f.xy / f.z - map.corner) / map.texel;
    if (!(f.z > 0.0) || (!map.is_cube && (any(lessThan(place, vec2(0.0))) || any(greaterThanEqual(place, vec2(map.size)))))) {
        return found;
    }
    vec4 texel = map_texel(map, 0, face, clamp(ivec2(floor(place)), ivec2(0), map.size - 1));
    found.how = REFLECTED_NOTHING;
    if (!is_empty(texel)) {
        found = Found(meet(map.center_ws, direction_ws, texel), texel, REFLECTED_BY_DIRECTION);
    }
    return found;
}

// Whether a ray that met nothing is behind what the map shows, seen from its centre, where it leaves the box around all of that. If not,
// nothing was in its way, whatever lies in its direction from the centre: over walls rays from high places go out, and others never are
// in the box.
bool ends_hidden(ReflectionMap map, vec3 origin_ws, vec3 direction_ws, float first_m) {
    mat4x3 box_from_world = load_box(map.number);
    vec3 from = box_from_world * vec4(origin_ws, 1.0);
    vec3 along = mat3(box_from_world) * direction_ws;
    // no quotient of zeros
    vec3 rate = mix(along, vec3(1.0 / FAR_ALONG), lessThan(abs(along), vec3(1.0 / FAR_ALONG)));
    vec3 to_low = (-1.0 - from) / rate;
    vec3 to_high = (1.0 - from) / rate;
    vec3 nearer = min(to_low, to_high);
    vec3 farther = max(to_low, to_high);
    float begin = max(max(nearer.x, nearer.y), max(nearer.z, 0.0));
    float end = min(min(farther.x, farther.y), farther.z);
    // rays that begin on a side of the box, or on two, may do so beyond it by rounding
    return end + first_m >= begin && look_up_direction(map, origin_ws + max(end, 0.0) * direction_ws - map.center_ws).how != REFLECTED_NOTHING;
}

// What the ray meets up to `last_m`; REFLECTED_OUT_OF_VIEW: perhaps something outside of a map that is no cube. Where that was hidden from
// the map's centre, what the map shows in its direction, if that counts.
Found follow(ReflectionMap map, vec3 origin_ws, vec3 direction_ws, float first_m, float last_m, bool counts_by_direction) {
#ifdef BY_DIRECTION
    return look_up_direction(map, direction_ws);
#else
    Found found = march(map, origin_ws, direction_ws, first_m, last_m);
    if (counts_by_direction && found.how == REFLECTED_NOTHING && ends_hidden(map, origin_ws, direction_ws, first_m)) {
        Found behind = look_up_direction(map, direction_ws);
        if (behind.how != REFLECTED_NOTHING) {
            Meeting exact = meet(origin_ws, direction_ws, behind.texel);
            bool is_met = exact.inside && exact.along >= first_m;
            found = is_met ? Found(exact, behind.texel, REFLECTED_BEHIND) : behind;
        }
    }
    return found;
#endif
}

// Where a ray is in the ball around all that a map shows.
vec2 within_reach(int number, vec3 origin_ws, vec3 direction_ws) {
    vec3 center_ws;
    float reach_m;
    load_ball(number, center_ws, reach_m);
    return within_ball(origin_ws - center_ws, direction_ws, reach_m);
}

const int FIRST_FURTHER = 3 + OWN_CUBES * (1 + FURTHER_MAPS);  // of the turns below

// What a ray meets that begins at a reflector, or at what this shows: by its first map, by that beside it where the ray leaves the first or
// comes to what is hidden there, and by that of the reflector itself; -1: none. What these do not know others may: cubes of this and of other
// reflectors alone, from which nothing else hides them; and what is around other reflectors, where the ray is hidden, or, as far as the
// reflector itself reaches, where the eye sees its hollows. What is met there exactly is there, and the nearest of it counts. Two of the
// latter, neither of which sees all that stands there, that both see nothing in a direction, show that there is nothing.
Found follow_through(ivec3 numbers, vec3 origin_ws, vec3 direction_ws, float first_m) {
    Found found = Found(Meeting(FAR_ALONG, vec2(0.0), false), vec4(-1.0), REFLECTED_NOTHING);
    int seen_past = 0;
    ivec4 further = further_maps(numbers.x);
    int own = own_cube(numbers.x);
    float own_end_m = own < 0 ? FAR_ALONG : within_reach(own, origin_ws, direction_ws).y;
    // in turns: what stands in a kernel twice is compiled twice
#ifdef BY_DIRECTION
    const int turn_count = 2;
#else
    const int turn_count = FIRST_FURTHER + FURTHER_MAPS;
#endif
    int next = 0;
    while (next < turn_count) {
        bool has_left = found.how == REFLECTED_OUT_OF_VIEW;
        bool is_hidden = found.how == REFLECTED_BY_DIRECTION;
        bool is_unsure = is_hidden || found.how == REFLECTED_BEHIND;
        float found_m = is_met_exactly(found.how) ? found.meeting.along : FAR_ALONG;
        // on to the next map that this ray asks: neighbours follow theirs together, whichever turns these are
        int turn;
        int number = -1;
        do {
            turn = next;
            next++;
            if (turn < 3) {
                number = turn != 1 || has_left || is_hidden ? numbers[turn] : -1;
            } else if (turn >= FIRST_FURTHER) {
                number = is_unsure || numbers.z >= 0 ? further[turn - FIRST_FURTHER] : -1;
            } else {
                int whose = (turn - 3) / OWN_CUBES;
                int which = (turn - 3) % OWN_CUBES;
                int first = own_cube(whose == 0 ? numbers.x : further[whose - 1]);
                vec2 within = first < 0 ? NOWHERE : within_reach(first, origin_ws, direction_ws);
                number = within.y > 0.0 && within.x <= found_m ? first + which : -1;
                // they are of the same ball
                next += number < 0 ? OWN_CUBES - 1 - which : 0;
            }
        } while (number < 0 && next < turn_count);
        if (number < 0) {
            break;
        }
        bool is_further = turn >= FIRST_FURTHER;
        bool is_first = turn < 2;  // of the reflector, and without it
        // other maps tell what is there, and whether nothing is
        bool may_guess = is_first || (is_further && is_hidden);
        float last_m = is_further && !is_unsure ? min(found_m, own_end_m) : found_m;
        Found one = follow(load_map(number), origin_ws, direction_ws, (is_first ? 1.0 : OWN_SHARE) * first_m, last_m, may_guess);
        seen_past += int(is_further && is_hidden && one.how == REFLECTED_NOTHING);
        bool is_sure = is_met_exactly(one.how) && (is_first || one.meeting.inside);
        if (turn >= 3 && !is_further) {
            // of what else may be in the way these know nothing
            one.how = found.how == REFLECTED_BEHIND ? REFLECTED_BEHIND : REFLECTED_SURFACE;
        }
        bool is_before = one.meeting.along < found_m;
        // seen all along the way from elsewhere
        bool confirms = one.how == REFLECTED_SURFACE && one.meeting.along < (1.0 + SAME_PLACE_SHARE) * found_m;
        if (turn == 0 || (turn == 1 && has_left) || (is_sure && (is_before || confirms)) || (is_hidden && seen_past > 1)) {
            found = one;
        }
    }
    return found;
}
