// What the fragments of a surface with an opacity map have to know (core/passes/opacity_maps.py).
#include "lib/linear_texel.glsl"
#include "lib/hash.glsl"
#include "lib/integer_halves.glsl"

void place_in_opacity_map(int instance) {
    vec4 bases = texelFetch(cut_out_instances, linear_texel(instance), 0);
    int first_vertex = integer_of(bases.xy);
    vec4 vertex = texelFetch(cut_out_uvs, linear_texel(first_vertex + gl_VertexID), 0);
    uv = vertex.xy;
    map_base = integer_of(bases.zw);
    map_header = texelFetch(opacity_maps, linear_texel(map_base), 0);
    vec4 identity = texelFetch(instances, linear_texel(instance * INSTANCE_TEXELS + 5), 0);
    threshold_seed = pcg_hash(uint(vertex.z) ^ pcg_hash((uint(identity.x) << 16u) | uint(identity.y)));
}
