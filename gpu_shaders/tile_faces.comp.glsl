// Finds the faces of the light's cube that the surfaces of each tile are seen in from the samples of a batch.
#include "lib/cube_faces.glsl"

void main() {
    ivec2 tile = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = ivec2(width, height);
    if (any(greaterThanEqual(tile * TILE_PX, size))) {
        return;
    }
    uint found = 0u;
    for (int i = 0; i < TILE_PX * TILE_PX; i++) {
        vec4 position = texelFetch(positions, min(tile * TILE_PX + ivec2(i % TILE_PX, i / TILE_PX), size - 1), 0);
        vec3 p_ls = light_position(position.xyz);
        for (int k = first_view; k < first_view + view_count; k++) {
            found |= position.w >= 0.0 ? 1u << uint(face_index(p_ls - samples[k].xyz)) : 0u;
        }
    }
    imageStore(tile_faces, tile, uvec4(found));
}
