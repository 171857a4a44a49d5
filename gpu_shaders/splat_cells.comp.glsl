// Replays the splats at the end of the point buffer into the depth maps of a batch of views.
#include "lib/load_aligned.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/splat.glsl"
#include "lib/splat_cell.glsl"

void main() {
    int index = linear_invocation();
    if (index >= splat_count) {
        return;
    }
    int place = buffer_end - 2 * (index + 1);
    vec4 owner = texelFetch(points, linear_texel(place), 0);
    vec2 half_size = texelFetch(points, linear_texel(place + 1), 0).xy;
    InstanceData instance = load_instance(int(owner.x));
    splat_cell(load_aligned(instance, load_triangle(instance, int(owner.y))), owner.zw, half_size);
}
