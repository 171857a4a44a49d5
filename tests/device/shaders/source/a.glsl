in_a
