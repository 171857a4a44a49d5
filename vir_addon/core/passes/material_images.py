"""Images of materials and of the world on the device: all of them in one array.

surface_images    per image a texel with width, height, packing and whether its colours are sRGB-encoded; then its texels, row by row:
                  PACKED_FLOATS one to a texel, PACKED_COLORS four (three bytes to a channel), PACKED_WITH_ALPHA two (two bytes to a
                  channel), PACKED_GRAYS eight (two bytes to a channel)
"""

from __future__ import annotations

import enum
from collections.abc import Iterable

import numpy as np

from ...device.declaration import Sampled
from ..material import Extension, ImageTexels
from ..material_program import IMAGE_ALPHA, IMAGE_DIVIDED, IMAGE_INTERPOLATED


class Packing(enum.IntEnum):
    PACKED_FLOATS = 0
    PACKED_COLORS = 1
    PACKED_WITH_ALPHA = 2
    PACKED_GRAYS = 3

    @property
    def pixels_per_texel(self) -> int:
        return (1, 4, 2, 8)[self]


IMAGE_TEXTURES = {"surface_images": Sampled("sampler2D", "sizes and packed texels of all images of materials and the world")}
IMAGE_DEFINES = {
    **{packing.name: int(packing) for packing in Packing if packing is not Packing.PACKED_WITH_ALPHA},  # what no condition is left for
    **{f"EXTENSION_{kind.name}": list(Extension).index(kind) for kind in (Extension.REPEAT, Extension.MIRROR, Extension.CLIP)},
    "IMAGE_INTERPOLATED": IMAGE_INTERPOLATED,
    "IMAGE_ALPHA": IMAGE_ALPHA,
    "IMAGE_DIVIDED": IMAGE_DIVIDED,
}


def packing_of(image: ImageTexels) -> Packing:
    if image.texels.dtype != np.uint8:
        return Packing.PACKED_FLOATS
    return {1: Packing.PACKED_GRAYS, 3: Packing.PACKED_COLORS, 4: Packing.PACKED_WITH_ALPHA}[image.texels.shape[2]]


def texel_count_of(image: ImageTexels) -> int:
    """Texels on the device, its header included."""
    height, width = image.texels.shape[:2]
    return 1 - (-width * height // packing_of(image).pixels_per_texel)


def _pack_into(image: ImageTexels, rows: np.ndarray) -> None:
    """rows: (texel_count_of(image), 4) float32 zeros"""
    height, width, channel_count = image.texels.shape
    packing = packing_of(image)
    rows[0] = width, height, packing, image.is_srgb
    texels = image.texels.reshape(-1, channel_count)
    values = rows[1:].reshape(-1)
    match packing:
        case Packing.PACKED_FLOATS:
            colors = texels if channel_count > 1 else np.repeat(texels, 3, axis=1)
            rows[1:, : colors.shape[1]] = colors
            if colors.shape[1] == 3:
                rows[1:, 3] = 1.0
        case Packing.PACKED_COLORS:
            wide = texels.astype(np.int32)
            values[: len(texels)] = wide[:, 0] | wide[:, 1] << 8 | wide[:, 2] << 16
        case _:
            single = texels.reshape(-1)
            pairs = np.append(single, np.zeros(len(single) % 2, np.uint8)).reshape(-1, 2).astype(np.int32)
            values[: len(pairs)] = pairs[:, 0] | pairs[:, 1] << 8


def pack_images(images: Iterable[ImageTexels]) -> tuple[np.ndarray, dict[ImageTexels, int]]:
    """Each once: (n, 4) float32 texels, and where each image's header is."""
    images = list(dict.fromkeys(images))
    counts = [texel_count_of(image) for image in images]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows = np.zeros((int(starts[-1]), 4), np.float32)
    for image, start, count in zip(images, starts, counts, strict=False):
        _pack_into(image, rows[start : start + count])
    return rows, {image: int(start) for image, start in zip(images, starts, strict=False)}
