"""Compares what `blender --background` wrote with what the button made of the same frames; run in a Blender in background."""

import sys
from pathlib import Path

import bpy
import numpy as np

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
FRAMES = {"f": (1,), "a": (1, 2, 3), "f_gpu": (1,)}


def read_picture(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], -1)[..., 0]


for name, frames in FRAMES.items():
    for frame in frames:
        expected = np.load(FOLDER / f"expected_{frame:04d}.npy")
        found = read_picture(FOLDER / f"background_{name}" / f"frame_{frame:04d}.exr")
        assert np.array_equal(found, expected), f"{name}, frame {frame}: differs by up to {np.abs(found - expected).max()}"
        print(f"{name}, frame {frame}: the same")
