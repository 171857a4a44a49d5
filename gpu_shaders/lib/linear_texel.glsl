// Arrays on the device are textures 4096 texels wide, filled row by row.
ivec2 linear_texel(int index) {
    return ivec2(index & 4095, index >> 12);
}
