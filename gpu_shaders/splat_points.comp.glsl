// Replays the point buffer into the depth maps of a batch of views.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"
#include "lib/octahedral.glsl"
#include "lib/splat.glsl"

void main() {
    int index = linear_invocation();
    if (index >= point_count) {
        return;
    }
    vec4 point = texelFetch(points, linear_texel(index), 0);
    splat(point.xyz, unpack_direction(point.w));
}
