"""Released textures, kept for whoever asks for the same size again: the next round, batch or frame.

For a software rasterizer a texture is memory that the system hands out page by page and that it clears itself before anything is drawn
into it. In a render that has a few seconds, a twentieth went there.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Protocol

from .interface import TextureFormat

Size = tuple[int, int, TextureFormat]
"""width and height in texels"""


class Handle(Protocol):
    """a backend's own texture"""

    def write(self, data: Any) -> object: ...
    def release(self) -> object: ...


def byte_count(size: Size) -> int:
    width, height, texture_format = size
    return 4 * texture_format.channel_count * width * height


class TexturePool:
    def __init__(self, limit_bytes: int) -> None:
        """limit_bytes: what may lie unused; 0: nothing is kept"""
        self.limit_bytes = limit_bytes
        self.unused_bytes = 0
        self._unused: OrderedDict[int, tuple[Size, Handle]] = OrderedDict()
        """those released longest ago first"""
        self._released_count = 0

    def take(self, size: Size) -> Handle | None:
        """One of this size with whatever it was left with, the one released last: most of it may be in a cache still."""
        for number in reversed(self._unused):
            if self._unused[number][0] == size:
                self.unused_bytes -= byte_count(size)
                return self._unused.pop(number)[1]
        return None

    def keep(self, size: Size, handle: Handle) -> None:
        self._unused[self._released_count] = size, handle
        self._released_count += 1
        self.unused_bytes += byte_count(size)
        while self.unused_bytes > self.limit_bytes:
            _, (oldest_size, oldest) = self._unused.popitem(last=False)
            self.unused_bytes -= byte_count(oldest_size)
            oldest.release()
