"""One channel of an image of the file, as bytes."""

from __future__ import annotations

import enum

import bpy
import numpy as np

MAX_SIDE_PX = 2048
"""A larger image is shrunk: a texel of a leaf is smaller than one of a depth map long before, and 4 MiB an image are enough."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""of linear colours"""
_LUMINANCE_OF_TEXELS = np.array(LUMINANCE, np.float32)


class Channel(enum.Enum):
    ALPHA = "alpha"
    GRAY = "gray"
    """what Blender makes of a colour where it needs a number: its luminance"""
    GRAY_TIMES_ALPHA = "gray times alpha"
    RED = "red"
    GREEN = "green"
    BLUE = "blue"

    @property
    def index(self) -> int:
        """of RED, GREEN and BLUE"""
        return ("red", "green", "blue").index(self.value)


class UnreadableImage(Exception):  # noqa: N818  a reason, caught where materials are read
    """The text names the image and what is wrong with it."""


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4)


def _linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055)


def has_encoded_color(image: bpy.types.Image, channel: Channel) -> bool:
    """Whether `read_texels` gives sRGB-encoded values, which is what renderers interpolate. Float images are linear already."""
    return channel is not Channel.ALPHA and not image.is_float and image.colorspace_settings.name == "sRGB"


def read_texels(image: bpy.types.Image, channel: Channel) -> tuple[np.ndarray, str]:
    """(height, width) uint8, row 0 at the bottom, and a note for the user or ''. Raises UnreadableImage."""
    if image.source not in ("FILE", "GENERATED"):
        raise UnreadableImage(f"the image '{image.name}', which is not a single picture ({image.source.lower()})")
    is_color = channel is not Channel.ALPHA
    if is_color and not image.is_float and image.colorspace_settings.name not in _KNOWN_SPACES and not image.colorspace_settings.is_data:
        raise UnreadableImage(f"the image '{image.name}' in the colour space {image.colorspace_settings.name}")
    pixels = _read_pixels(image)
    height, width, channel_count = pixels.shape
    note = ""
    if max(width, height) > MAX_SIDE_PX:
        pixels = _shrink(pixels)
        used = f"{pixels.shape[1]} x {pixels.shape[0]}"
        note = f"The opacity of the image '{image.name}' is used at {used} instead of {width} x {height} pixels."
    has_alpha = channel_count in (2, 4) and image.alpha_mode != "NONE"
    alpha = pixels[..., -1] if has_alpha else np.ones(pixels.shape[:2], np.float32)
    if not is_color:
        values = alpha
    elif channel_count < 3:
        values = pixels[..., 0]
    elif channel in (Channel.RED, Channel.GREEN, Channel.BLUE):
        values = pixels[..., channel.index]
    else:
        values = _gray(pixels[..., :3], is_encoded=has_encoded_color(image, channel))
    if channel is Channel.GRAY_TIMES_ALPHA:
        values = values * alpha
    return np.round(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255).astype(np.uint8), note


_KNOWN_SPACES = ("sRGB", "Non-Color", "Linear Rec.709")


def _read_pixels(image: bpy.types.Image) -> np.ndarray:
    """(height, width, channel_count) float32"""
    # asking for pixels loads the file; before that the size of a missing one may be that of long ago
    value_count = len(image.pixels)
    width, height = image.size
    if not value_count or not width or not height:
        place = f" ({image.filepath})" if image.filepath else ""
        raise UnreadableImage(f"the image '{image.name}', which is missing{place}")
    pixels = np.empty(value_count, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, -1)


def _gray(colors: np.ndarray, *, is_encoded: bool) -> np.ndarray:
    if np.array_equal(colors[..., 0], colors[..., 1]) and np.array_equal(colors[..., 0], colors[..., 2]):
        return colors[..., 0]
    if not is_encoded:
        return colors @ _LUMINANCE_OF_TEXELS
    return _linear_to_srgb(srgb_to_linear(colors) @ _LUMINANCE_OF_TEXELS)


def _shrink(pixels: np.ndarray) -> np.ndarray:
    """Means of blocks, which keep the share that is opaque."""
    factor = MAX_SIDE_PX / max(pixels.shape[:2])
    for axis in range(2):
        size = pixels.shape[axis]
        count = max(1, round(size * factor))
        starts = np.arange(count) * size // count
        lengths = np.diff(np.append(starts, size)).astype(np.float32)
        pixels = np.add.reduceat(pixels, starts, axis=axis) / np.expand_dims(lengths, (1 - axis, 2))
    return pixels
