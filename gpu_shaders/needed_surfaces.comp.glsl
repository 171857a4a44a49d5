// What the centres of those of a map's texels see that samples need, kept in the order of a list; and for samples where each is kept.
#include "lib/linear_invocation.glsl"
#include "lib/keep_texel.glsl"

void main() {
    int index = linear_invocation();
    if (index >= count) {
        return;
    }
    ReflectionMap map = load_map(map_number);
    int place = first + index;
    int number = int(texelFetch(listed, linear_texel(place >> 2), 0)[place & 3]);
    int face_size = map.size.x * map.size.y;
    int face = number / face_size;
    int within = number - face * face_size;
    keep_texel(map, face, ivec2(within % map.size.x, within / map.size.x), linear_texel(place));
    imageStore(needed, linear_texel(map.base + number), uvec4(uint(place + 1)));
}
