"""Points for small triangles, the hardware rasterizer for large ones: the future work that the papers on points ask for.

A point costs the same whatever its triangle, and a rasterized triangle the same however few its texels. What takes at most
`Settings.small_triangle_points` points of `ivir` becomes points, once; what takes more is placed once and drawn for every view. The
lowest bit of a depth tells which of the two wrote it, because only outlines of points are half a texel too large (docs/sampling.md).
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from ...device.declaration import KernelDeclaration
from ..passes.points import BUFFER_SMALL_TRIANGLES, SPLAT_SMALL_TRIANGLES
from ..settings import PointStorage
from .base import FaceJob
from .ivir import ImprovedViewIndependentRasterization
from .large_triangles import BYTES_PER_TRIANGLE, TEXELS_PER_TRIANGLE, LargeTriangles

EXPECTED_LARGE_SHARE = 1 / 16
MOST_EXPECTED_LARGE = 1 << 17
"""Half as many large triangles as the first list has room for: 12 MiB at most."""


class HybridRasterization(ImprovedViewIndependentRasterization):
    buffer_triangles = BUFFER_SMALL_TRIANGLES
    splat_triangles = SPLAT_SMALL_TRIANGLES
    large: LargeTriangles

    def __init__(self, job: FaceJob, storage: PointStorage) -> None:
        super().__init__(job, storage)
        self.splat_flags.append("MIXED_MAPS")
        self.raster_flags.append("MIXED_MAPS")
        self.large = LargeTriangles(self)
        self.large_triangle_count = 0
        """of the last list, whether or not it is still held"""
        self._has_listed = False

    def preparing(self) -> Generator[None, None, None]:
        expected = min(int(EXPECTED_LARGE_SHARE * self.caster_triangle_count), MOST_EXPECTED_LARGE)
        # a list that turns out too short costs another walk over all triangles
        self._has_room_for(expected)
        yield from super().preparing()
        if self.storage is PointStorage.BUFFERLESS:
            # the rasterizer comes before the first points: a buffer without room leaves only the list
            outputs = {"points": self.tiles.texture, "texel_capacity": 0}
            yield from self._generating_points(self.buffer_triangles, self.buffer_tiles, 0, self.work.group_count, **outputs)

    @property
    def held_bytes(self) -> int:
        return super().held_bytes + BYTES_PER_TRIANGLE * self.large.triangle_count

    def _free(self) -> None:
        super()._free()
        self._release_large()
        # large triangles are listed by a walk over all
        self._filled_capacity = None

    def release(self) -> None:
        super().release()
        # what is never buffered is never freed above, and may be prepared again
        self._release_large()

    def _release_large(self) -> None:
        self.large.release()
        self._has_listed = False

    def _large_outputs(self) -> dict[str, Any]:
        return {
            "large_triangles": self.parts.texture,
            "large_capacity": 0 if self._has_listed else self.parts.texel_count // TEXELS_PER_TRIANGLE,
            "points_of_small": self.settings.small_triangle_points,
        }

    def _finishing_large(self, tiles: KernelDeclaration, **outputs: Any) -> Generator[None, None, bool]:
        """Take the list over; returns False when it was too short: it has grown, and its content is lost. It is whole after the first run,
        which is always of all work groups; later runs leave it alone."""
        if self._has_listed:
            return True
        yield
        count = self.counters.read().parts
        if not self._has_room_for(count):
            return False
        self.large.add(self.parts, 0, count)
        self.large_triangle_count = count
        self._has_listed = True
        return True

    def _has_room_for(self, triangle_count: int) -> bool:
        if TEXELS_PER_TRIANGLE * triangle_count <= self.parts.texel_count:
            return True
        self.parts.reserve(2 * TEXELS_PER_TRIANGLE * triangle_count)
        return False

    def counts(self) -> dict[str, int]:
        return {**super().counts(), "large_triangle_count": self.large_triangle_count}
