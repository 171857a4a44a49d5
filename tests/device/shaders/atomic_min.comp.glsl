// Many invocations meet in each texel; every third also tries a value above all others.
#include "lib/linear_invocation.glsl"

void main() {
    int index = linear_invocation();
    if (index < invocation_count) {
        imageAtomicMin(lowest, ivec2(index % width, 0), uint(invocation_count - index));
        if (index % 3 == 0) {
            imageAtomicMin(lowest, ivec2(index % width, 0), 0x7f000000u);
        }
    }
}
