// Which triangle of which instance a pixel sees.
#include "lib/place_vertex.glsl"

void main() {
    int instance = first_instance + gl_InstanceID;
    instance_id = instance;
    gl_Position = clip_from_world * vec4(place_vertex(instance, position_os), 1.0);
}
