// The scene's triangles and instances, as core/passes/scene_data.py lays them out.
#include "lib/linear_texel.glsl"
#include "lib/octahedral.glsl"
#include "lib/integer_halves.glsl"

const int SHADING_FLAT = 0;
const int SHADING_POINT = 1;
const int SHADING_CORNER = 2;

struct InstanceData {
    vec4 row_x;  // rows of world_from_object
    vec4 row_y;
    vec4 row_z;
    int vertex_base;
    int triangle_base;
    int corner_base;
    int shading;
    uint stable_id;
    float orientation;  // -1 where the transform mirrors, which turns every triangle around
};

struct TriangleData {
    vec3 position_os[3];
    vec3 position_ws[3];
    vec4 corners;      // x, y, z: vertex indices; w: material slot
    vec3 packed_normals;  // of its vertices, octahedral
};

InstanceData load_instance(int instance) {
    int base = instance * INSTANCE_TEXELS;
    InstanceData data;
    data.row_x = texelFetch(instances, linear_texel(base), 0);
    data.row_y = texelFetch(instances, linear_texel(base + 1), 0);
    data.row_z = texelFetch(instances, linear_texel(base + 2), 0);
    vec4 bases = texelFetch(instances, linear_texel(base + 3), 0);
    vec4 kind = texelFetch(instances, linear_texel(base + 4), 0);
    vec4 identity = texelFetch(instances, linear_texel(base + 5), 0);
    data.vertex_base = integer_of(bases.xy);
    data.triangle_base = integer_of(bases.zw);
    data.corner_base = integer_of(kind.xy);
    data.shading = int(kind.z);
    data.orientation = kind.w;
    data.stable_id = (uint(identity.x) << 16u) | uint(identity.y);
    return data;
}

vec3 transform_point(InstanceData instance, vec3 p) {
    return vec3(dot(instance.row_x, vec4(p, 1.0)), dot(instance.row_y, vec4(p, 1.0)), dot(instance.row_z, vec4(p, 1.0)));
}

// Normals go with the transposed inverse; the cofactor matrix is that up to a factor whose sign is the orientation.
vec3 transform_normal(InstanceData instance, vec3 n) {
    vec3 x = instance.row_x.xyz;
    vec3 y = instance.row_y.xyz;
    vec3 z = instance.row_z.xyz;
    return instance.orientation * vec3(dot(cross(y, z), n), dot(cross(z, x), n), dot(cross(x, y), n));
}

TriangleData load_triangle(InstanceData instance, int triangle) {
    TriangleData data;
    data.corners = texelFetch(triangles, linear_texel(instance.triangle_base + triangle), 0);
    for (int k = 0; k < 3; k++) {
        vec4 vertex = texelFetch(vertices, linear_texel(instance.vertex_base + int(data.corners[k])), 0);
        data.position_os[k] = vertex.xyz;
        data.position_ws[k] = transform_point(instance, vertex.xyz);
        data.packed_normals[k] = vertex.w;
    }
    return data;
}

// Not normalized; points to where the triangle's front is, mirrored instances included. Zero for a degenerate triangle.
vec3 scaled_geometric_normal(InstanceData instance, TriangleData triangle) {
    return instance.orientation * cross(triangle.position_ws[1] - triangle.position_ws[0], triangle.position_ws[2] - triangle.position_ws[0]);
}

// Which side of a triangle shows a surface with this geometric normal: 1 its front, -1 its back.
float shown_side(InstanceData instance, TriangleData triangle, vec3 geometric_ws) {
    return dot(scaled_geometric_normal(instance, triangle), geometric_ws) < 0.0 ? -1.0 : 1.0;
}
