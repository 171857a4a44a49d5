// Points of the cloud as places to be shaded, a texel each: where they lie on their triangles, as the cube sees them that has the finest
// texels there.
#include "lib/linear_invocation.glsl"
#include "lib/surface_point.glsl"
#include "lib/cubes.glsl"

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec3 place = texelFetch(points, linear_texel(2 * index), 0).xyz;
    Owner owner = unpack_owner(texelFetch(points, linear_texel(2 * index + 1), 0).xyz);
    vec4 work = texelFetch(work_table, linear_texel(int(owner.number / uint(WORK_GROUP_SIZE))), 0);
    int triangle_index = int(work.y) + int(owner.number % uint(WORK_GROUP_SIZE));
    InstanceData instance = load_instance(owner.instance);
    TriangleData triangle = load_triangle(instance, triangle_index);
    // points are of triangles that have an area
    vec3 geometric = normalize(scaled_geometric_normal(instance, triangle));
    vec3 weights = intersection_weights(triangle, place + geometric, -geometric);
    int finest = 0;
    float least_m = 3.0e38;
    for (int k = 0; k < cube_count; k++) {
        vec3 p = place - cube_center(k);
        float texel_m = face_depth(p) * texel_tangent(k);
        if (dot(geometric, p) < 0.0 && texel_m < least_m) {
            least_m = texel_m;
            finest = k;
        }
    }
    vec3 direction = normalize(place - cube_center(finest));
    vec3 shading = shading_normal(instance, triangle, triangle_index, weights, geometric);
    float side = dot(geometric, direction) > 0.0 ? -1.0 : 1.0;
    ivec2 address = linear_texel(index);
    imageStore(positions, address, vec4(place, float(owner.instance)));
    imageStore(normals, address, vec4(side * geometric, pack_direction(side * shading)));
    imageStore(surfaces, address, vec4(float(triangle_index), weights.yz, float(REFLECTED_BY_DIRECTION)));
    imageStore(ray_origins, address, vec4(cube_center(finest), map_numbers[finest >> 2][finest & 3]));
    imageStore(ray_directions, address, vec4(direction, 0.0));
    imageStore(throughputs, address, vec4(1.0, 1.0, 1.0, 0.0));
}
