// views is only spoken of here, and declared is a parameter's name of its own
int twice(int declared) {
    return 2 * declared;
}
#define never_used (hull[0])
void main() {
    imageStore(numbers, ivec2(0), uvec4(point_count));
#ifdef MISSPELT
#endif
}
