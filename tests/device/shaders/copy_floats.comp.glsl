#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

void main() {
    ivec2 texel = linear_texel(linear_invocation());
    imageStore(copied, texel, texelFetch(given, texel, 0));
}
