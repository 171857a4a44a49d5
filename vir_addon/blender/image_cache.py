"""Texels of images that were read before. Blender hands pixels out on its main thread only, a second for a few large images."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import bpy
import numpy as np

from ..core.material import ImageTexels
from .image_texels import Channel, read_colors, read_texels

Result = TypeVar("Result")


class ImageCache:
    """Reads each image once for each use of it, until it is told that the image has changed.

    What a script writes into an image's pixels and then saves or packs is noticed by nobody.
    """

    def __init__(self, before_reading: Callable[[], None] = lambda: None) -> None:
        """before_reading: raises if there is no time for an image; what was read is kept"""
        self._before_reading = before_reading
        self._read: dict[int, dict[Hashable, Any]] = {}
        """session_uid -> what was read of the image, by what was asked"""
        self.read_count = 0
        """images read since this was made"""

    def texels(self, image: bpy.types.Image, channel: Channel) -> tuple[np.ndarray, str]:
        """As of `read_texels`."""
        return self._find(image, (channel,), lambda: read_texels(image, channel))

    def colors(self, image: bpy.types.Image, max_side_px: int, max_bytes: int) -> tuple[ImageTexels, ImageTexels | None, str]:
        """As of `read_colors`."""
        return self._find(image, (max_side_px, max_bytes), lambda: read_colors(image, max_side_px, max_bytes))

    def _find(self, image: bpy.types.Image, asked: tuple[Hashable, ...], read: Callable[[], Result]) -> Result:
        known = self._read.setdefault(image.session_uid, {})
        # nothing tells of another alpha mode
        key = (*asked, image.name, image.alpha_mode, image.colorspace_settings.name)
        if key not in known:
            self._before_reading()
            self.read_count += 1
            known[key] = read()
        result: Result = known[key]
        return result

    def forget(self, uid: int) -> None:
        """session_uid of an image"""
        self._read.pop(uid, None)

    def forget_changed(self) -> None:
        """All that may have changed without an update that names them: those that were painted and those that were reloaded, whose pixels
        Blender has freed."""
        kept = {image.session_uid for image in bpy.data.images if image.has_data and not image.is_dirty}
        self._read = {uid: known for uid, known in self._read.items() if uid in kept}
