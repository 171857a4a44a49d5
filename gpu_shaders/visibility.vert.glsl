// Which triangle of which instance a pixel sees.
#include "lib/place_vertex.glsl"
#include "lib/hash.glsl"
#ifdef CUT_OUT
#include "lib/cut_out_vertex.glsl"
#endif

void main() {
    int instance = first_instance + gl_InstanceID;
    instance_id = instance;
    tie_breaker = int(hash_position(position_os) & 7u);
#ifdef CUT_OUT
    place_in_opacity_map(instance);
#endif
    gl_Position = clip_from_world * vec4(place_vertex(instance, position_os), 1.0);
}
