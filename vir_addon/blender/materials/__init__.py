"""Materials and images of a .blend, read from their nodes into `core.material`'s terms."""
