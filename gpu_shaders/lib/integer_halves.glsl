// Integers travel as floats, split into 16-bit halves (device/interface.py, `split_integers`).
int integer_of(vec2 high_low) {
    return int(high_low.x) * 65536 + int(high_low.y);
}
