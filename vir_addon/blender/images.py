"""Passes as float images in the .blend file."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.pass_set import PassSet

PASS_PROPERTY = "vir_pass"
"""custom property with the pass's name; what marks an image as made here"""


def write_images(passes: PassSet, *, pack: bool = True) -> dict[str, bpy.types.Image]:
    """Write every pass into an image of its name ("VIR Shadow Key"): float, Non-Color, grey. Returns pass name -> image.

    An image that an earlier call made for the pass is filled again, resized where needed, so nodes keep pointing at it. An
    artist's image that happens to have the name is left alone; ours then gets a number from Blender. `pack` puts the pixels into the
    .blend (Blender drops unsaved pixels of generated images on saving); without it this is fast enough for every frame.
    """
    return {name: _write_image(name, pixels, pack) for name, pixels in passes.images.items()}


def find_image(pass_name: str) -> bpy.types.Image | None:
    """The image made here for the pass. Of several (an artist's copies carry the mark too) the one with the pass's name."""
    ours = [image for image in bpy.data.images if image.library is None and image.get(PASS_PROPERTY) == pass_name]
    return min(ours, key=lambda image: (image.name != pass_name, image.name), default=None)


def _write_image(pass_name: str, pixels: np.ndarray, pack: bool) -> bpy.types.Image:
    height, width = pixels.shape
    image = find_image(pass_name) or _new_image(pass_name, width, height)
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    rgba = np.ones((height, width, image.channels), dtype=np.float32)
    rgba[..., :3] = pixels[..., np.newaxis]
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    if pack:
        image.pack()
    return image


def _new_image(pass_name: str, width: int, height: int) -> bpy.types.Image:
    image = bpy.data.images.new(pass_name, width, height, alpha=False, float_buffer=True, is_data=True)
    image[PASS_PROPERTY] = pass_name
    image.use_fake_user = True  # else saving drops it until a node uses it
    return image
