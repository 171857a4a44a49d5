// Maps of what reflectors may see, as core/passes/reflection_maps.py lays them out: six faces of a cube around a centre, or one view.
//
// A face looks along one of the map's axes, forwards or backwards; its coordinates are the other two in turn and the linear depth.
// Every texel holds the range of depths, within the texel, of the triangle that its centre sees, and the triangle. Coarser levels hold
// the range of all texels below.
#include "lib/linear_texel.glsl"
#include "lib/integer_halves.glsl"
#include "lib/map_faces.glsl"

struct ReflectionMap {
    vec3 center_ws;
    vec3 axis_x;
    vec3 axis_y;
    vec3 axis_z;
    bool is_cube;
    ivec2 size;   // texels of a face
    vec2 corner;  // tangents where texel (0, 0) begins
    vec2 texel;   // tangents
    int base;     // where its texels begin
    float near_m;
    float reach_m;  // what is farther from the centre is outside of the scene
    int number;
};

ReflectionMap load_map(int number) {
    vec4 rows[6];
    for (int k = 0; k < 6; k++) {
        rows[k] = texelFetch(map_headers, linear_texel(HEADER_TEXELS * number + k), 0);
    }
    ReflectionMap map;
    map.center_ws = rows[0].xyz;
    map.is_cube = rows[0].w > 0.5;
    map.axis_x = rows[1].xyz;
    map.axis_y = rows[2].xyz;
    map.axis_z = rows[3].xyz;
    map.size = ivec2(rows[1].w, rows[2].w);
    map.corner = rows[4].xy;
    map.texel = rows[4].zw;
    map.base = integer_of(rows[5].xy);
    map.near_m = rows[5].z;
    map.reach_m = rows[5].w;
    map.number = number;
    return map;
}

// What takes the box around all that the map shows to the cube from -1 to 1.
mat4x3 load_box(int number) {
    vec4 rows[3];
    for (int k = 0; k < 3; k++) {
        rows[k] = texelFetch(map_headers, linear_texel(HEADER_TEXELS * number + 7 + k), 0);
    }
    return transpose(mat3x4(rows[0], rows[1], rows[2]));
}

// Around all that the map shows.
void load_ball(int number, out vec3 center_ws, out float reach_m) {
    center_ws = texelFetch(map_headers, linear_texel(HEADER_TEXELS * number), 0).xyz;
    reach_m = texelFetch(map_headers, linear_texel(HEADER_TEXELS * number + 5), 0).w;
}

// Maps of other reflectors that may know what this one does not; -1: none.
ivec4 further_maps(int number) {
    return ivec4(texelFetch(map_headers, linear_texel(HEADER_TEXELS * number + 6), 0));
}

// The first of the cubes of the reflector alone that a map is of; -1: none.
int own_cube(int number) {
    return number < 0 ? -1 : int(texelFetch(map_headers, linear_texel(HEADER_TEXELS * number + 3), 0).w);
}

vec3 map_direction(ReflectionMap map, vec3 d_ws) {
    return vec3(dot(map.axis_x, d_ws), dot(map.axis_y, d_ws), dot(map.axis_z, d_ws));
}

// A single view is the face 4.
int face_of(ReflectionMap map, vec3 p) {
    return map.is_cube ? face_of_direction(p) : 4;
}

int face_count(ReflectionMap map) {
    return map.is_cube ? 6 : 1;
}

int face_row(ReflectionMap map, int face) {
    return map.is_cube ? face : 0;
}

// Where a cell of a level stands in the list of all texels.
int map_index(ReflectionMap map, int level, int face, ivec2 cell) {
    ivec2 size = map.size >> level;
    int finest = 4 * face_count(map) * map.size.x * map.size.y;
    int before = (finest - (finest >> (2 * level))) / 3;
    return map.base + before + (face_row(map, face) * size.y + cell.y) * size.x + cell.x;
}

// The face and cell of a level that an invocation is for, the faces lying from bottom to top; false beyond them.
bool find_cell(ReflectionMap map, int level, out int face, out ivec2 cell) {
    ivec2 size = map.size >> level;
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    int row = at.y / max(size.y, 1);
    face = map.is_cube ? row : 4;
    cell = ivec2(at.x, at.y - row * size.y);
    return at.x < size.x && at.y < size.y * face_count(map);
}
