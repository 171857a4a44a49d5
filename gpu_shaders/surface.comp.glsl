// The eye G-buffer from visibility: where each pixel's ray meets its triangle, and the normals there.
#include "lib/scene_data.glsl"
#include "lib/tiles.glsl"

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

// Barycentric weights of the point of the triangle's plane that the ray meets (Moeller & Trumbore 1997), moved into the
// triangle: the rasterizer and this arithmetic round differently at edges.
vec3 intersection_weights(TriangleData triangle, vec3 origin, vec3 direction) {
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
    vec3 weights = max(vec3(1.0 - u - v, u, v), 0.0);
    return weights / (weights.x + weights.y + weights.z);
}

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    uvec2 seen = texelFetch(visibility, samples_per_px * (pixel + margin_px) + ivec2(sample_x, sample_y), 0).xy;
    if (seen.x == 0u) {
        imageStore(positions, pixel, vec4(0.0, 0.0, 0.0, -1.0));
        imageStore(normals, pixel, vec4(0.0));
        return;
    }
    // the ray through the pixel's (shifted) centre: to the corner, along a row, along a column, eye
    vec2 at = vec2(pixel) + 0.5;
    vec3 to_plane = eye[0].xyz + at.x * eye[1].xyz + at.y * eye[2].xyz;
    bool orthographic = eye[3].w > 0.5;
    vec3 origin = orthographic ? eye[3].xyz + to_plane : eye[3].xyz;
    vec3 direction = orthographic ? eye[4].xyz : to_plane;

    InstanceData instance = load_instance(int(seen.x) - 1);
    TriangleData triangle = load_triangle(instance, int(seen.y));
    vec3 weights = intersection_weights(triangle, origin, direction);
    vec3 position = weights.x * triangle.position_ws[0] + weights.y * triangle.position_ws[1] + weights.z * triangle.position_ws[2];
    vec3 scaled = scaled_geometric_normal(instance, triangle);
    float area_squared = dot(scaled, scaled);
    vec3 geometric = area_squared > 0.0 ? scaled * inversesqrt(area_squared) : -normalize(direction);
    vec3 shading = shading_normal(instance, triangle, int(seen.y), weights, geometric);
    if (dot(geometric, direction) > 0.0) {
        // seen from behind: both sides of a surface are lit, each by what lies before it
        geometric = -geometric;
        shading = -shading;
    }
    imageStore(positions, pixel, vec4(position, float(seen.x) - 1.0));
    imageStore(normals, pixel, vec4(geometric, pack_direction(shading)));
}
