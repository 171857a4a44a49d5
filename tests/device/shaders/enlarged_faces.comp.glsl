#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/enlarged_faces.glsl"

void main() {
    int index = linear_invocation();
    if (index >= triangle_count) {
        return;
    }
    vec3 corners[3];
    for (int k = 0; k < 3; k++) {
        corners[k] = texelFetch(triangle_corners, linear_texel(3 * index + k), 0).xyz;
    }
    imageStore(faces, linear_texel(index), uvec4(faces_of_triangle(corners[0], corners[1], corners[2])));
}
