// Copies a range of a device array to the start of another.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

void main() {
    int index = linear_invocation();
    if (index < texel_count) {
        imageStore(copied, linear_texel(index), texelFetch(original, linear_texel(first_texel + index), 0));
    }
}
