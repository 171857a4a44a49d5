"""Texels of images that were read before. Blender hands pixels out on its main thread only; texels can be made of them elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, TypeVar

import bpy
import numpy as np

from ...core.material import ImageTexels
from ...core.steps import HostWork
from .image_texels import Channel, ImagePixels, colors_of, is_read_by_renderers, take_pixels, texels_of

Result = TypeVar("Result")

SMALL_PX = 512 * 512
"""of an image whose texels are made at once, in some ten milliseconds: waiting for others to make them costs finding the place in the scene
again, for every image"""


class OutOfTimeError(Exception):
    """There is no time left to read a mesh or an image; what was read is kept."""


class ImageCache:
    """Reads each image once for each use of it, until it is told that the image has changed.

    What a script writes into an image's pixels and then saves or packs is noticed by nobody.
    """

    def __init__(self, begin_reading: Callable[[], None] | None = None) -> None:
        """begin_reading: of who has little time. Called before pixels are asked for, it may raise OutOfTimeError; of images
        that are not small only these are read then, and OutOfTimeError is raised until `host_work` is done."""
        self._begin_reading = begin_reading
        self._read: dict[int, dict[Hashable, Any]] = {}
        """session_uid -> what was read of the image, by what was asked"""
        self._work: HostWork | None = None
        self.read_count = 0
        """images read since this was made"""

    def texels(self, image: bpy.types.Image, channel: Channel) -> tuple[np.ndarray, str]:
        """As of `texels_of`. Raises UnreadableImage."""
        return self._find(image, (channel,), lambda taken: texels_of(taken, channel), is_color=channel is not Channel.ALPHA)

    def colors(self, image: bpy.types.Image, max_side_px: int, max_bytes: int) -> tuple[ImageTexels, ImageTexels | None, str]:
        """As of `colors_of`. Raises UnreadableImage."""
        return self._find(image, (max_side_px, max_bytes), lambda taken: colors_of(taken, max_side_px, max_bytes), is_color=True)

    def _find(
        self, image: bpy.types.Image, asked: tuple[Hashable, ...], make: Callable[[ImagePixels], Result], *, is_color: bool
    ) -> Result:
        known = self._read.setdefault(image.session_uid, {})
        # nothing tells of another alpha mode, of another file that has been loaded meanwhile, nor of packing, which changes who reads it
        key = (*asked, image.name, image.filepath, image.alpha_mode, image.colorspace_settings.name, is_read_by_renderers(image))
        if key not in known:
            if self._begin_reading is not None:
                self._begin_reading()
            taken = take_pixels(image, is_color=is_color)
            self.read_count += 1
            if self._begin_reading is not None and taken.width_px * taken.height_px > SMALL_PX:
                # if the image changes meanwhile, nobody will look there
                self._work = partial(_make_known, known, key, make, taken)
                raise OutOfTimeError
            known[key] = make(taken)
        result: Result = known[key]
        return result

    def host_work(self) -> HostWork | None:
        """What is left to do of an image, once."""
        work, self._work = self._work, None
        return work

    def forget(self, uid: int) -> None:
        """session_uid of an image"""
        self._read.pop(uid, None)

    def forget_changed(self) -> bool:
        """All that may have changed without an update that names them: those that were painted and those that were reloaded, whose pixels
        Blender has freed. Whether there were any."""
        kept = {image.session_uid for image in bpy.data.images if image.has_data and not image.is_dirty}
        forgotten = self._read.keys() - kept
        for uid in forgotten:
            del self._read[uid]
        return bool(forgotten)


def _make_known(known: dict[Hashable, Any], key: Hashable, make: Callable[[ImagePixels], Any], taken: ImagePixels) -> None:
    known[key] = make(taken)
