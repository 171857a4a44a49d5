// A point of a triangle: where a ray meets its plane, and the shading normal there.
#include "lib/scene_data.glsl"

vec3 shading_normal(InstanceData instance, TriangleData triangle, int triangle_index, vec3 weights, vec3 fallback_ws) {
    vec3 packed_normals = triangle.packed_normals;
    if (instance.shading == SHADING_FLAT) {
        return fallback_ws;
    }
    if (instance.shading == SHADING_CORNER) {
        packed_normals = texelFetch(corner_normals, linear_texel(instance.corner_base + triangle_index), 0).xyz;
    }
    vec3 n = vec3(0.0);
    for (int k = 0; k < 3; k++) {
        n += weights[k] * unpack_direction(packed_normals[k]);
    }
    vec3 n_ws = transform_normal(instance, n);
    float squared = dot(n_ws, n_ws);
    // opposite normals of a folded triangle can cancel
    return squared > 0.0 ? n_ws * inversesqrt(squared) : fallback_ws;
}

// Barycentric weights of the point of the triangle's plane that the ray meets (Moeller & Trumbore 1997), also outside of the triangle.
vec3 plane_weights(TriangleData triangle, vec3 origin, vec3 direction) {
    vec3 edge_1 = triangle.position_ws[1] - triangle.position_ws[0];
    vec3 edge_2 = triangle.position_ws[2] - triangle.position_ws[0];
    vec3 p = cross(direction, edge_2);
    float determinant = dot(edge_1, p);
    if (determinant == 0.0) {
        return vec3(1.0 / 3.0);
    }
    vec3 s = origin - triangle.position_ws[0];
    float u = dot(s, p) / determinant;
    float v = dot(direction, cross(s, edge_1)) / determinant;
    return vec3(1.0 - u - v, u, v);
}

// The same moved into the triangle: the rasterizer and this arithmetic round differently at edges.
vec3 intersection_weights(TriangleData triangle, vec3 origin, vec3 direction) {
    vec3 weights = max(plane_weights(triangle, origin, direction), 0.0);
    return weights / (weights.x + weights.y + weights.z);
}
