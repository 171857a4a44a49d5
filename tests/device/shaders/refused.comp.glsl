#include "lib/linear_texel.glsl"

void main() {
    int missing = name_that_is_not_there;
}
