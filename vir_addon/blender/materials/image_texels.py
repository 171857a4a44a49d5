"""Images of the file: one channel as bytes, or colours as renderers interpolate them."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import bpy
import imbuf
import numpy as np

from ...core.material import ImageTexels
from ...core.material_program import LUMINANCE

MAX_SIDE_PX = 2048
"""A larger image is shrunk: a texel of a leaf is smaller than one of a depth map long before, and 4 MiB an image are enough."""
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
    """Whether `texels_of` gives sRGB-encoded values, which is what renderers interpolate. Floats that Blender hands to them are linear."""
    is_encoded = image.colorspace_settings.name == "sRGB" and (not image.is_float or is_read_by_renderers(image))
    return channel is not Channel.ALPHA and is_encoded


def is_read_by_renderers(image: bpy.types.Image) -> bool:
    """Whether Cycles opens the file by itself. What it makes of texels is then not what it makes of Blender's pixels (5.2, measured)."""
    return image.source == "FILE" and not image.packed_file and not image.is_dirty


def is_multiplied_by_alpha(image: bpy.types.Image) -> bool:
    """Whether renderers take the colours of `texels_of` times alpha where only the colour is asked for."""
    if image.colorspace_settings.is_data:
        return False
    return image.alpha_mode == "STRAIGHT" or (image.alpha_mode == "PREMUL" and is_read_by_renderers(image))


@dataclass(frozen=True)
class ImagePixels:
    """What there is to know of an image, without Blender."""

    name: str
    pixels: np.ndarray
    """(height, width, channel_count) float32, row 0 at the bottom, as Blender has them"""
    width_px: int
    """the image's own, as `height_px`"""
    height_px: int
    is_float: bool
    is_data: bool
    """no colours"""
    is_srgb: bool
    """colours are encoded"""
    alpha_mode: str
    """Blender's"""
    differs_from_file: bool
    """Blender has changed what renderers read from the file"""


def take_pixels(image: bpy.types.Image, *, is_color: bool) -> ImagePixels:
    """For colours, or for alpha alone. Raises UnreadableImage."""
    _check(image, is_color=is_color)
    pixels, (width, height) = _read_pixels(image)
    return ImagePixels(
        name=image.name,
        pixels=pixels,
        width_px=width,
        height_px=height,
        is_float=image.is_float,
        is_data=image.colorspace_settings.is_data,
        is_srgb=has_encoded_color(image, Channel.RED),
        alpha_mode=image.alpha_mode,
        # larger ones are not Blender's pixels
        differs_from_file=is_read_by_renderers(image) and width * height <= LARGEST_PX,
    )


def _unmultiplied_colors(image: ImagePixels) -> None:
    """Makes the pixels' colours those of the file, but not multiplied by alpha where there is any. Blender's floats are linear and always
    multiplied by alpha, its bytes never, whatever the file holds."""
    if not (image.differs_from_file and image.is_float) or image.is_data:
        return
    has_alpha = image.pixels.shape[2] in (2, 4)
    colors = image.pixels[..., :-1] if has_alpha else image.pixels
    if has_alpha and image.alpha_mode in ("STRAIGHT", "PREMUL"):
        alpha = image.pixels[..., -1:]
        np.divide(colors, alpha, out=colors, where=alpha > 0.0)
    if image.is_srgb:
        colors[...] = _linear_to_srgb(colors)


def _times_alpha(colors: np.ndarray, alpha: np.ndarray, image: ImagePixels) -> np.ndarray:
    """Glow, which covers nothing and has been multiplied by nothing, stays; among bytes Blender has lost it."""
    keeps_glow = image.alpha_mode == "PREMUL" and image.is_float
    return np.where(alpha > 0.0, colors * alpha, colors) if keeps_glow else colors * alpha


def texels_of(image: ImagePixels, channel: Channel) -> tuple[np.ndarray, str]:
    """(height, width) uint8, row 0 at the bottom, and a note for the user or ''. Spoils the pixels."""
    if channel is not Channel.ALPHA:
        _unmultiplied_colors(image)
    pixels, width, height = image.pixels, image.width_px, image.height_px
    channel_count = pixels.shape[2]
    note = ""
    if max(width, height) > MAX_SIDE_PX:
        pixels = shrink(pixels, MAX_SIDE_PX)
        used = f"{pixels.shape[1]} x {pixels.shape[0]}"
        note = f"The opacity of the image '{image.name}' is used at {used} instead of {width} x {height} pixels."
    has_alpha = channel_count in (2, 4) and image.alpha_mode != "NONE"
    alpha = pixels[..., -1] if has_alpha else np.ones(pixels.shape[:2], np.float32)
    if channel is Channel.ALPHA:
        values = alpha
    elif channel_count < 3:
        values = pixels[..., 0]
    elif channel in (Channel.RED, Channel.GREEN, Channel.BLUE):
        values = pixels[..., channel.index]
    else:
        values = _gray(pixels[..., :3], is_encoded=image.is_srgb)
    if channel is Channel.GRAY_TIMES_ALPHA:
        values = _times_alpha(values, alpha, image)
    return np.round(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255).astype(np.uint8), note


def _check(image: bpy.types.Image, *, is_color: bool) -> None:
    if image.source not in ("FILE", "GENERATED"):
        raise UnreadableImage(f"the image '{image.name}', which is not a single picture ({image.source.lower()})")
    if is_color and not image.is_float and image.colorspace_settings.name not in _KNOWN_SPACES and not image.colorspace_settings.is_data:
        raise UnreadableImage(f"the image '{image.name}' in the colour space {image.colorspace_settings.name}")


def colors_of(image: ImagePixels, max_side_px: int, max_bytes: int) -> tuple[ImageTexels, ImageTexels | None, str]:
    """The colours; the alpha where the colours are not multiplied with it and yet it is there (channel packed images); and a note for the
    user or ''. Spoils the pixels.

    max_bytes: on the device, of the colours
    """
    pixels, width, height = image.pixels, image.width_px, image.height_px
    channel_count = pixels.shape[2]
    has_alpha = channel_count in (2, 4) and image.alpha_mode != "NONE" and bool((pixels[..., -1] < 1.0).any())
    is_packed = image.alpha_mode == "CHANNEL_PACKED" or image.is_data
    is_multiplied = image.is_float and image.alpha_mode == "PREMUL" and not image.is_srgb
    if not is_multiplied:
        _unmultiplied_colors(image)
    if has_alpha and not is_packed and not is_multiplied and (image.alpha_mode == "STRAIGHT" or image.differs_from_file):
        pixels[..., :-1] = _times_alpha(pixels[..., :-1], pixels[..., -1:], image)
        if not image.is_float and image.alpha_mode == "STRAIGHT":
            # Cycles rounds products of bytes down, which shows where little is left
            pixels[..., :-1] = np.floor(pixels[..., :-1] * np.float32(255) + np.float32(1e-3)) / np.float32(255)
    is_gray = channel_count < 3 or _is_gray(pixels[..., :3])
    bytes_per_px = 16 if image.is_float else 8 if has_alpha and not is_packed else 2 if is_gray else 4
    max_side_px = min(max_side_px, int(max(width, height) * (max_bytes / (bytes_per_px * width * height)) ** 0.5))
    note = ""
    if max(width, height) > max_side_px:
        pixels = shrink(pixels, max(max_side_px, 1))
        used = f"{pixels.shape[1]} x {pixels.shape[0]}"
        note = f"In reflections the image '{image.name}' is used at {used} instead of {width} x {height} pixels."
    colors, alpha = (pixels[..., :-1], pixels[..., -1:]) if channel_count in (2, 4) else (pixels, None)
    colors = colors[..., :1] if is_gray else colors
    is_srgb = image.is_srgb
    if not has_alpha or alpha is None:
        return ImageTexels(image.name, _stored(colors, image), is_srgb), None, note
    if is_packed:
        return ImageTexels(image.name, _stored(colors, image), is_srgb), ImageTexels(image.name, _stored(alpha, image)), note
    if is_gray:
        # what has an alpha has all channels
        colors = np.repeat(colors, 3, axis=2)
    return ImageTexels(image.name, _stored(np.concatenate([colors, alpha], axis=2), image), is_srgb), None, note


def _stored(values: np.ndarray, image: ImagePixels) -> np.ndarray:
    """Copies; float images keep what is beyond 1."""
    if image.is_float:
        return np.clip(np.nan_to_num(values, nan=0.0), -_LARGEST_VALUE, _LARGEST_VALUE)
    return (values * np.float32(255) + np.float32(0.5)).astype(np.uint8)


_LARGEST_VALUE = 1e9
"""Suns in pictures of the sky are below it; squares of it are still numbers."""


def _is_gray(colors: np.ndarray) -> bool:
    return np.array_equal(colors[..., 0], colors[..., 1]) and np.array_equal(colors[..., 0], colors[..., 2])


_KNOWN_SPACES = ("sRGB", "Non-Color", "Linear Rec.709")


LARGEST_PX = 8192 * 8192
"""Blender hands pixels out as floats: these take a GiB."""
_STRIP_PX = 1 << 22
"""that are floats at a time where an image has more than LARGEST_PX"""


def _read_pixels(image: bpy.types.Image) -> tuple[np.ndarray, tuple[int, int]]:
    """(height, width, channel_count) float32, and the image's own width and height: what has more than LARGEST_PX is read smaller, at
    MAX_SIDE_PX at least."""
    # asking for pixels loads the file; before that the size of a missing one may be that of long ago
    value_count = len(image.pixels)
    width, height = image.size
    if not value_count or not width or not height:
        place = f" ({image.filepath})" if image.filepath else ""
        raise UnreadableImage(f"the image '{image.name}', which is missing{place}")
    if width * height > LARGEST_PX:
        return _read_smaller(image, width, height), (width, height)
    pixels = np.empty(value_count, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, -1), (width, height)


def _read_smaller(image: bpy.types.Image, width: int, height: int) -> np.ndarray:
    """Means of blocks of a file's pixels, without all of them as floats."""
    too_large = UnreadableImage(f"the image '{image.name}', which is too large ({width} x {height} pixels)")
    if image.source != "FILE" or image.is_dirty or image.is_float or not hasattr(imbuf.types.ImBuf, "with_buffer"):
        raise too_large
    try:
        packed = image.packed_file
        loaded = imbuf.load_from_buffer(packed.data) if packed else imbuf.load(bpy.path.abspath(image.filepath, library=image.library))
    except (OSError, ValueError) as error:
        raise too_large from error
    if tuple(loaded.size) != (width, height) or loaded.buffer_type != "BYTE":
        raise too_large
    step = max(width, height) // MAX_SIDE_PX
    with loaded.with_buffer() as buffer:
        texels = np.asarray(buffer)[: height // step * step, : width // step * step]
        strip = max(1, _STRIP_PX // width // step) * step
        parts = [_block_means(texels[start : start + strip], step) for start in range(0, len(texels), strip)]
    return np.concatenate(parts) / np.float32(255)


def _block_means(texels: np.ndarray, step: int) -> np.ndarray:
    height, width, channel_count = texels.shape
    blocks = texels.reshape(height // step, step, width // step, step, channel_count)
    return blocks.mean(axis=(1, 3), dtype=np.float32)


def _gray(colors: np.ndarray, *, is_encoded: bool) -> np.ndarray:
    if _is_gray(colors):
        return colors[..., 0]
    if not is_encoded:
        return colors @ _LUMINANCE_OF_TEXELS
    return _linear_to_srgb(srgb_to_linear(colors) @ _LUMINANCE_OF_TEXELS)


def shrink(pixels: np.ndarray, max_side_px: int) -> np.ndarray:
    """Means of blocks, which keep the share that is opaque: (height, width, channel_count) float32."""
    factor = max_side_px / max(pixels.shape[:2])
    for axis in range(2):
        size = pixels.shape[axis]
        count = max(1, round(size * factor))
        starts = np.arange(count) * size // count
        lengths = np.diff(np.append(starts, size))
        # a few times faster than reduceat
        sums = np.take(pixels, starts, axis=axis)
        for step in range(1, int(lengths.max())):
            sums += np.take(pixels, np.minimum(starts + step, size - 1), axis=axis) * np.expand_dims(lengths > step, (1 - axis, 2))
        pixels = sums / np.expand_dims(lengths.astype(np.float32), (1 - axis, 2))
    return pixels
