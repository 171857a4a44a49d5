"""What only a real Blender with a window can show: `make test-blender`, with the environment variable BLENDER."""
