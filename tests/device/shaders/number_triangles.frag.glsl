void main() {
    number = uint(instance_number * 10 + gl_PrimitiveID + 1);
}
