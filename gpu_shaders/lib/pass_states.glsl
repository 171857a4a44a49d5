// The two sums of a lit pixel have the same terms, but not always in the same order.
bool wholly_lit(vec2 sums) {
    return sums.x >= sums.y * (1.0 - 1.0e-6);
}

// Samples that nothing is known of are there with next to nothing of their weight.
bool wholly_dark(vec2 sums) {
    return sums.x <= sums.y * 1.0e-6;
}
