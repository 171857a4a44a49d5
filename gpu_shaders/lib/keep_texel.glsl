// What the centre of a map's texel sees, as a ray from the map's centre meets it: a place to be shaded.
#include "lib/surface_point.glsl"
#include "lib/reflection_map.glsl"

// place: where it is kept
void keep_texel(ReflectionMap map, int face, ivec2 cell, ivec2 place) {
    vec4 texel = texelFetch(map_texels, linear_texel(map_index(map, 0, face, cell)), 0);
    vec3 along = from_face(face, vec3(map.corner + (vec2(cell) + 0.5) * map.texel, 1.0));
    vec3 direction = normalize(along.x * map.axis_x + along.y * map.axis_y + along.z * map.axis_z);
    vec4 position = vec4(0.0, 0.0, 0.0, -1.0);
    vec4 normal = vec4(0.0);
    vec4 surface = vec4(0.0, 0.0, 0.0, float(REFLECTED_NOTHING));
    if (texel.z >= 0.0) {
        InstanceData instance = load_instance(int(texel.z));
        TriangleData triangle = load_triangle(instance, int(texel.w));
        vec3 weights = intersection_weights(triangle, map.center_ws, direction);
        position = vec4(weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2], texel.z);
        vec3 scaled = scaled_geometric_normal(instance, triangle);
        float area_squared = dot(scaled, scaled);
        vec3 geometric = area_squared > 0.0 ? scaled * inversesqrt(area_squared) : -direction;
        vec3 shading = shading_normal(instance, triangle, int(texel.w), weights, geometric);
        float side = dot(geometric, direction) > 0.0 ? -1.0 : 1.0;
        normal = vec4(side * geometric, pack_direction(side * shading));
        surface = vec4(texel.w, weights.yz, float(REFLECTED_BY_DIRECTION));
    }
    imageStore(positions, place, position);
    imageStore(normals, place, normal);
    imageStore(surfaces, place, surface);
    imageStore(ray_origins, place, vec4(map.center_ws, float(map_number)));
    imageStore(ray_directions, place, vec4(direction, 0.0));
    imageStore(throughputs, place, vec4(1.0, 1.0, 1.0, 0.0));
}
