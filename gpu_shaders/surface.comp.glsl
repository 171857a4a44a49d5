// The eye G-buffer from visibility: where each pixel's ray meets its triangle, and the normals there.
#include "lib/surface_point.glsl"
#include "lib/tiles.glsl"

void main() {
    ivec2 pixel;
    if (!find_pixel(pixel)) {
        return;
    }
    uvec2 seen = texelFetch(visibility, samples_per_px * (pixel + margin_px) + ivec2(sample_x, sample_y), 0).xy;
    // Software rasterizers wait for the memory that they store into: it is asked for now, and has come when all is worked out. What was there
    // does not matter, the second condition always holds, but compilers do not know.
    uint before = floatBitsToUint(imageLoad(positions, pixel).x) | floatBitsToUint(imageLoad(normals, pixel).x);
    // the background goes through all of it as well: stores of its own would cost a software rasterizer more
    bool is_surface = seen.x != 0u && (before & 1u) <= uint(samples_per_px);
    // the ray through the pixel's (shifted) centre: to the corner, along a row, along a column, eye
    vec2 at = vec2(pixel) + 0.5;
    vec3 to_plane = eye[0].xyz + at.x * eye[1].xyz + at.y * eye[2].xyz;
    bool orthographic = eye[3].w > 0.5;
    vec3 origin = orthographic ? eye[3].xyz + to_plane : eye[3].xyz;
    vec3 direction = orthographic ? eye[4].xyz : to_plane;

    InstanceData instance = load_instance(max(int(seen.x) - 1, 0));
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
    imageStore(positions, pixel, is_surface ? vec4(position, float(seen.x) - 1.0) : vec4(0.0, 0.0, 0.0, -1.0));
    imageStore(normals, pixel, is_surface ? vec4(geometric, pack_direction(shading)) : vec4(0.0));
#ifdef WITH_TRIANGLES
    imageStore(surfaces, pixel, is_surface ? vec4(float(seen.y), weights.yz, 0.0) : vec4(0.0));
#endif
}
