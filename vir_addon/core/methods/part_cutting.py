"""Cutting large triangles of `ivir` into tiles, in lists whose size does not depend on how many tiles they take.

A wall that touches a light may take a hundred million tiles. Parts are a stack: those on its top are cut first, only so many at once that
there is room for whatever becomes of them, and tiles become points as soon as their list is full.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from ...device.interface import ComputeKernel
from ..passes.points import PARTS_OF_A_PART
from .shared import MOST_PART_CAPACITY, TEXELS_PER_PART, TEXELS_PER_TILE, PointScratch

MAX_CUTS = 6
"""A part that touches the light asks for any number of points; six cuts into 8 x 8 make enough."""

RunTiles = Callable[[int], Generator[None, None, None]]
"""makes points of so many tiles at the list's beginning, in steps"""


class PartCutter:
    def __init__(self, scratch: PointScratch) -> None:
        self.counters, self.parts, self.tiles = scratch.counters, scratch.parts, scratch.tiles

    @property
    def _part_capacity(self) -> int:
        return self.parts.texel_count // TEXELS_PER_PART

    @property
    def part_limit(self) -> int:
        """Parts of triangles that may be on the list at once: half of it. What is cut takes half of what is left, so that even what is cut
        `MAX_CUTS` times has room."""
        return self._part_capacity // 2

    def has_grown_for(self, part_count: int) -> bool:
        """Whether the list of parts, whose content is lost, has grown; False where it is as large as it ever gets."""
        if self._part_capacity >= MOST_PART_CAPACITY:
            return False
        self.parts.reserve(TEXELS_PER_PART * min(2 * 2 * part_count, MOST_PART_CAPACITY))
        return True

    def cutting(self, kernel: ComputeKernel, run_tiles: RunTiles, part_count: int, **bindings: Any) -> Generator[None, None, None]:
        """Make points of the list's first `part_count` parts, at most `part_limit`, pausing between kernels. `counters` were last read
        after these were listed.

        bindings: what `kernel`, one of CUT_PARTS, is bound to beside the lists
        """
        part_capacity, tile_limit = self._part_capacity, self.tiles.texel_count // TEXELS_PER_TILE
        counts = self.counters.last
        flushed_count, tile_count = counts.tiles, 0
        stack = [(0, part_count, 0)]
        while stack:
            first, end, cuts = stack.pop()
            cut_count = min(end - first, (part_capacity - end) // 2 // PARTS_OF_A_PART, tile_limit // PARTS_OF_A_PART)
            if tile_count + PARTS_OF_A_PART * cut_count > tile_limit:
                yield from run_tiles(tile_count)
                flushed_count, tile_count = flushed_count + tile_count, 0
                yield
            kernel.dispatch_linear(
                cut_count,
                **bindings,
                counters=self.counters.texture,
                parts=self.parts.texture,
                tiles=self.tiles.texture,
                first_part=end - cut_count,
                part_count=cut_count,
                part_capacity=part_capacity,
                counted_parts=counts.parts - end,
                counted_tiles=flushed_count,
                may_leave_parts=int(cuts < MAX_CUTS - 1),
            )
            before, counts = counts.parts, self.counters.read()
            tile_count = counts.tiles - flushed_count
            if first < end - cut_count:
                stack.append((first, end - cut_count, cuts))
            if counts.parts > before:
                stack.append((end, end + counts.parts - before, cuts + 1))
            yield
        yield from run_tiles(tile_count)
