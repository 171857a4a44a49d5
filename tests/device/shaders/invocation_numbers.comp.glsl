// Leaves each invocation's number where linear addressing puts it.
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

void main() {
    int index = linear_invocation();
    if (index < invocation_count) {
        imageStore(numbers, linear_texel(index), uvec4(uint(index + 1)));
    }
}
