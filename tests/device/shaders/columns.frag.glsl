void main() {
    imageAtomicAdd(counts, ivec2(1, 0), 1u);
    number = uint(column_number) + 1u;
}
