// Which of a batch's cubes a triangle or point of the cloud is splatted into: those that show it, and when depths are known those where it
// came first. The rest needs no second look.
#include "lib/linear_texel.glsl"

// mask: of its instance
int pending_cubes(int index, vec4 mask) {
    int shown = ((1 << cube_count) - 1) & ~int(mask.x);
    return is_numbering != 0 ? int(imageLoad(came_first, linear_texel(index)).x) : shown;
}

void finish(int index, int cubes_before) {
    if (is_numbering == 0) {
        imageStore(came_first, linear_texel(index), uvec4(cubes_before));
    }
}

bool shows_back_faces(vec4 mask, int k) {
    return (int(mask.y) >> k & 1) == 0;
}
