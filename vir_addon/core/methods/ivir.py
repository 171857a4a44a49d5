"""Improved view-independent rasterization (Gavane & Watson 2022; preprint 2020): triangles become points once, views replay them.

`buffered`: points go into a buffer that every batch of views replays. What a buffer too small for all of them has no room for is
generated again for each batch. `bufferless`: every batch generates the points and splats them as they come.
"""

from __future__ import annotations

import sys
from collections.abc import Generator
from typing import Any

import numpy as np

from ...device.declaration import KernelDeclaration
from ...device.owned import Owned
from ..passes.points import BUFFER_TILES, BUFFER_TRIANGLES, CUT_PARTS, KEEP_SEEN_POINTS, SPLAT_POINTS, SPLAT_TILES, SPLAT_TRIANGLES
from ..passes.scene_data import WORK_GROUP_SIZE
from ..passes.shadow_maps import DepthMaps
from ..settings import PointStorage
from ..steps import compiling, run_steps
from .base import FaceJob, ReplayMethod
from .linear_store import LinearStore
from .part_cutting import PartCutter
from .seen_space import seen_space_bindings, window_bounds
from .shared import TEXELS_PER_SPLAT

TILE_CELLS = 8
"""as in generate_points.comp.glsl"""
WORTHWHILE_SHARE_KEPT = 0.8
"""Kept points are in the order in which invocations finished, which costs the maps' locality: replaying 95 % of them took 18 % longer."""
BYTES_PER_POINT = 16
FILLED_SHARE = 0.95
"""of a buffer that has no room for all points: triangles that stand together in the list may have more of them than others"""


def hull_box(hull_fs: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """(2, 4) rows of the table of that name. bounds: (4,) tangents around all windows"""
    farthest = np.maximum(np.abs(bounds[0::2]), np.abs(bounds[1::2]))
    box = np.zeros((2, 4))
    box[:, :3] = (hull_fs.max(axis=0) + hull_fs.min(axis=0)) / 2, (hull_fs.max(axis=0) - hull_fs.min(axis=0)) / 2
    box[0, 3] = 1 / np.sqrt(1 + (farthest**2).sum())
    return box


class ImprovedViewIndependentRasterization(ReplayMethod):
    buffer_triangles: KernelDeclaration = BUFFER_TRIANGLES
    buffer_tiles: KernelDeclaration = BUFFER_TILES
    splat_triangles: KernelDeclaration = SPLAT_TRIANGLES
    splat_tiles: KernelDeclaration = SPLAT_TILES
    invocations_per_tile = TILE_CELLS

    def __init__(self, job: FaceJob, storage: PointStorage) -> None:
        super().__init__(job)
        self.storage = storage
        fitted, scratch = job.fitted, job.shared.point_scratch
        self.capacity_limit = job.shared.budget_bytes // BYTES_PER_POINT
        self.counters, self.tiles, self.parts = scratch.counters, scratch.tiles, scratch.parts
        self.cutter = PartCutter(scratch)
        self._groups_at_once = sys.maxsize
        """of triangles; fewer where more of them are large than the list of parts has room for"""
        seen_space = seen_space_bindings(fitted.views, job.light, job.samples_m)
        bounds = window_bounds(fitted.views)
        self.sampling_bindings = {
            **self.scene_data.bindings,
            **seen_space,
            "face": self.face_table,
            "hull_box": hull_box(seen_space["hull"][:, :3], bounds),
            "window_bounds": bounds,
            "eye": self.scene_data.eye_pixels.table(fitted.views),
        }
        self.sampling_flags = ["WATERTIGHT"] * self.settings.watertight + ["STOCHASTIC_CULLING"] * self.settings.stochastic_culling
        self.sampling_flags += self.projection_flags
        self.splat_flags = ["NEAR_SURFACES"] * (fitted.nearest_caster_m < fitted.views.light_diameter_m)
        self.splat_flags += ["FRONT_FACE"] * fitted.views.is_planar + self.projection_flags
        self.replay_flags: list[str] = []
        """of SPLAT_POINTS, beside `splat_flags`"""
        self.points_per_invocation = 1
        self.culled_triangle_count = 0
        self.point_count = 0
        self.buffered_point_count = 0
        self.buffered_splat_count = 0
        """at the end of the buffer; only `epr` makes some"""
        self.kept_point_count = 0
        self._held_group_count = 0
        """the first work groups, whose points are in the buffer"""
        self._filled_capacity: int | None = None
        """texels of the buffer that had room for these; None: what has room is to be found out"""

    def preparing(self) -> Generator[None, None, None]:
        self.work = self._owned.own(self.scene_data.work_table(self.opaque_indices, ~self.culled))
        if self.storage is PointStorage.BUFFERED:
            yield from self._holding()

    def _making(self) -> Generator[None, None, None]:
        expected = min(self.capacity_limit, max(1 << 18, 4 * self.work.triangle_count))
        self.points = LinearStore(self.device, expected if self._filled_capacity is None else self._filled_capacity)
        self._is_held = True
        if self._filled_capacity is None:
            yield from self._filling_buffer()
            self._filled_capacity = self.points.texel_count
        else:
            yield from self._generating_into_buffer(self._held_group_count)
        self.portion_count = 1 + (self._held_group_count < self.work.group_count)
        if self.portion_count > 1:
            for declaration in (self.splat_triangles, self.splat_tiles):
                yield from self._compiling(declaration)

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_POINT * self.points.texel_count

    def _free(self) -> None:
        self.points.release()
        self.kept_point_count = 0

    # buffered

    def _filling_buffer(self) -> Generator[None, None, None]:
        """With the points of as many of the first work groups as it has room for, all of them where they fit."""
        self._held_group_count = self.work.group_count
        texels, self.culled_triangle_count = yield from self._generating_into_buffer(self._held_group_count)
        self.point_count = self.buffered_point_count + self.buffered_splat_count
        if self.points.texel_count < min(texels, self.capacity_limit):
            self.points.reserve(min(texels, self.capacity_limit))
            if texels <= self.points.texel_count:
                yield from self._generating_into_buffer(self._held_group_count)
        while texels > self.points.texel_count:
            self._held_group_count = int(self._held_group_count * FILLED_SHARE * self.points.texel_count / texels)
            texels, _ = yield from self._generating_into_buffer(self._held_group_count)
        if not self._held_group_count:
            # what is never filled would push out what other faces keep
            self.points.reserve(1)

    def _generating_into_buffer(self, group_count: int) -> Generator[None, None, tuple[int, int]]:
        """Points of the first work groups. Pauses between kernels. Returns how many texels they take (more than the buffer has: the rest is
        lost) and triangles culled."""
        outputs = {"points": self.points.texture, "texel_capacity": self.points.texel_count}
        yield from self._generating_points(self.buffer_triangles, self.buffer_tiles, 0, group_count, **outputs)
        culled = self._read_counts()
        return self.buffered_point_count + TEXELS_PER_SPLAT * self.buffered_splat_count, culled

    def _read_counts(self) -> int:
        """Set how many points and splats the generating kernels found; returns how many triangles they culled."""
        counts = self.counters.read()
        self.buffered_point_count, self.buffered_splat_count = counts.points, counts.splats
        return counts.culled_triangles

    def _compiling(self, declaration: Any) -> Generator[None, None, Any]:
        """Returns one of the four kernels."""
        return (yield from compiling(self.device, declaration, *self._flags_of(declaration)))

    def _generating(self, declaration: Any, invocation_count: int, **bindings: Any) -> Generator[None, None, None]:
        """Run one of the four kernels, pausing where it had to be compiled."""
        kernel = yield from self._compiling(declaration)
        kernel.dispatch_linear(invocation_count, **bindings)

    def _generating_points(
        self, triangles: KernelDeclaration, tiles: KernelDeclaration, first_group: int, group_count: int, **outputs: Any
    ) -> Generator[None, None, None]:
        """Of a range of work groups. Begins again with fewer at once where a list was too small for what is large in them."""
        is_done = False
        while not is_done:
            self.counters.clear()
            is_done = yield from self._generating_in_portions(triangles, tiles, first_group, group_count, **outputs)

    def _generating_in_portions(
        self, triangles: KernelDeclaration, tiles: KernelDeclaration, first_group: int, group_count: int, **outputs: Any
    ) -> Generator[None, None, bool]:
        end = first_group + group_count
        while first_group < end:
            count = min(self._groups_at_once, end - first_group)
            yield from self._generating(
                triangles,
                count * WORK_GROUP_SIZE,
                **self.sampling_bindings,
                **outputs,
                work_table=self.work.texture,
                first_group=first_group,
                group_count=count,
                culling_area_texels=self.settings.culling_area_texels,
                counters=self.counters.texture,
                **self._large_outputs(),
            )
            if not (yield from self._finishing_large(tiles, **outputs)):
                return False
            first_group += count
        return True

    def _large_outputs(self) -> dict[str, Any]:
        """Where triangles of many cells go."""
        counted = self.counters.last.parts
        return {"parts": self.parts.texture, "part_capacity": self.cutter.part_limit, "counted_parts": counted}

    def _finishing_large(self, tiles: KernelDeclaration, **outputs: Any) -> Generator[None, None, bool]:
        """Make points of what the last run over triangles left as parts. Returns False when their list was too small for them."""
        yield
        counted = self.counters.last.parts
        part_count = self.counters.read().parts - counted
        if not part_count:
            return True
        if part_count > self.cutter.part_limit:
            if not self.cutter.has_grown_for(part_count):
                self._groups_at_once = max(1, min(self._groups_at_once, self.work.group_count) // 2)
            return False

        def running_tiles(tile_count: int) -> Generator[None, None, None]:
            return self._generating(
                tiles,
                tile_count * self.invocations_per_tile,
                **self.sampling_bindings,
                **outputs,
                tile_list=self.tiles.texture,
                tile_count=tile_count,
                counters=self.counters.texture,
            )

        kernel = yield from compiling(self.device, CUT_PARTS, *self.sampling_flags)
        yield from self.cutter.cutting(kernel, running_tiles, part_count, **self.sampling_bindings)
        return True

    def _flags_of(self, declaration: KernelDeclaration) -> list[str]:
        return sorted({*self.sampling_flags, *(self.splat_flags if "depth_maps" in declaration.images else ())})

    # batches

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        if self.storage is PointStorage.BUFFERED:
            self._hold()
        views = self.views_table(selected)
        self._begin(maps, selected, views)
        outputs = {"depth_maps": maps.texture, "views": views, "view_count": len(selected)}
        if self.storage is PointStorage.BUFFERLESS:
            run_steps(self._splatting(0, **outputs))
            self.culled_triangle_count = self._read_counts()
            self.point_count = self.buffered_point_count + self.buffered_splat_count
            return
        self._replay(**outputs)
        if self.portion_count > 1:
            run_steps(self._splatting(self._held_group_count, **outputs))
        elif self._may_search_hidden(selected):
            self._keep_seen_points(**outputs)

    def _splatting(self, first_group: int, **outputs: Any) -> Generator[None, None, None]:
        """Points of all work groups from this one on, as they are generated."""
        group_count = self.work.group_count - first_group
        yield from self._generating_points(self.splat_triangles, self.splat_tiles, first_group, group_count, **outputs)

    def _replay(self, **batch: Any) -> None:
        """What the buffer holds into the maps. batch: what points are splatted with"""
        self.device.compute_kernel(SPLAT_POINTS, *self.splat_flags, *self.replay_flags).dispatch_linear(
            -(-self.buffered_point_count // self.points_per_invocation),
            **batch,
            face=self.face_table,
            points=self.points.texture,
            point_count=self.buffered_point_count,
        )

    def _keep_seen_points(self, **batch: Any) -> None:
        """batch: what points are splatted with"""
        self._has_searched_hidden = True
        with Owned() as temporary:
            kept = temporary.own(LinearStore(self.device, self.buffered_point_count))
            self.counters.clear()
            self.device.compute_kernel(KEEP_SEEN_POINTS, *self.projection_flags).dispatch_linear(
                self.buffered_point_count,
                **batch,
                points=self.points.texture,
                kept_points=kept.texture,
                counters=self.counters.texture,
                face=self.face_table,
                point_count=self.buffered_point_count,
            )
            self.kept_point_count = self.counters.read().points
            if self.kept_point_count > WORTHWHILE_SHARE_KEPT * self.buffered_point_count:
                self.kept_point_count = self.buffered_point_count
                return
            self.points.replace_by(kept)
            self.buffered_point_count = self.kept_point_count

    def counts(self) -> dict[str, int]:
        return {
            "point_count": self.point_count,
            "kept_point_count": self.kept_point_count,
            "culled_triangle_count": self.culled_triangle_count,
        }
