"""Micro-triangle rasterization: triangles are culled, placed and projected once a light, small ones then rasterized by a kernel.

For triangles of a few texels a hardware rasterizer's set-up costs more than its texels, and it repeats the vertex work for every view.
Here a list of small triangles is replayed into the maps of a batch by a kernel that tests the texels' centres itself, each triangle for
all views at once; large ones, placed and culled as well, go to the hardware rasterizer. Both cover a texel by the same rule, so the
maps are `mvr`'s: no density to choose, no holes, no randomness. Triangles that no view of the first batch is near to
seeing are left out of the list from then on.

A list too long for its memory is processed in portions, each gathered again for each batch.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...device.interface import LINEAR_TEXTURE_WIDTH, Texture, TextureFormat, split_integers, spread_out
from ...device.owned import Owned
from ..passes.scene_data import WORK_GROUP_SIZE
from ..passes.shadow_maps import DepthMaps
from ..passes.small_triangles import BLOCK_TEXELS, GATHER_TRIANGLES, KEEP_SEEN_TRIANGLES, ORDER_TRIANGLES, RASTERIZE_SMALL_TRIANGLES
from ..steps import compiling, run_steps
from .base import FaceJob, ReplayMethod
from .large_triangles import BYTES_PER_TRIANGLE, TEXELS_PER_TRIANGLE, LargeTriangles
from .linear_store import LinearStore
from .seen_space import seen_space_bindings

FIRST_CAPACITY = 1 << 14
GROUPS_AT_ONCE = (1 << 20) // WORK_GROUP_SIZE
"""A software rasterizer gathers a million triangles in a fifth of a second, which is what a preview may take at a time."""
SKIP_NONE, SKIP_FACING_AWAY, SKIP_FACING = -1, 0, 1
"""of RASTERIZE_SMALL_TRIANGLES"""


@dataclass(frozen=True)
class _Portion:
    """Work groups whose small triangles are in the list together."""

    first_group: int
    group_count: int
    small_count: int = 0


class MicroTriangleRasterization(ReplayMethod):
    large: LargeTriangles

    def __init__(self, job: FaceJob) -> None:
        super().__init__(job)
        self.seen_space = seen_space_bindings(job.fitted.views, job.light, job.samples_m)
        self.flags = ["FRONT_FACE"] * job.fitted.views.is_planar + self.projection_flags
        self.small_count = 0
        self.large_count = 0
        self.kept_count = 0
        self.large = LargeTriangles(self)
        self._looks_first = ["LOOKS_FIRST"] * (not self.device.is_software)
        self._portions: list[_Portion] = []
        self._gathered: _Portion | None = None
        self.capacity_limit = max(job.shared.budget_bytes // BYTES_PER_TRIANGLE, FIRST_CAPACITY)

    def preparing(self) -> Generator[None, None, None]:
        self.work = self._owned.own(self.scene_data.work_table(self.opaque_indices, ~self.culled))
        self.counters = self._owned.own(self.device.create_texture(2, 1, TextureFormat.R32UI))
        yield from self._holding()

    def _making(self) -> Generator[None, None, None]:
        kernel = yield from compiling(self.device, GATHER_TRIANGLES, *self.flags)
        expected = max(min(self._expected_triangle_count, self.capacity_limit), FIRST_CAPACITY)
        self.triangles = LinearStore(self.device, TEXELS_PER_TRIANGLE * expected)
        self._is_held = True
        if not self.device.has_run(kernel):
            # software rasterizers translate it then, which takes as long as gathering a million triangles
            yield from self._gathering(_Portion(0, 0))
            yield
        yield from self._planning_portions()
        self.small_count = sum(portion.small_count for portion in self._portions)
        self.large_count = self.large.triangle_count
        self.portion_count = len(self._portions)

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_TRIANGLE * (self._capacity + self.large.triangle_count)

    def _free(self) -> None:
        self.triangles.release()
        self.large.release()
        self._gathered = None
        self._portions = []

    @property
    def _expected_triangle_count(self) -> int:
        """About half of a closed surface faces the light; two thirds leave room for one that leans towards it."""
        casters = self.opaque_indices
        counts = self.scene_data.triangle_counts[self.scene_data.snapshot.instances.mesh_index[casters]]
        return int(np.where(self.culled[casters], counts * 2 // 3 + 1, counts).sum())

    def _planning_portions(self) -> Generator[None, None, None]:
        pending = [_Portion(0, self.work.group_count)]
        while pending:
            portion = pending.pop()
            small_count, large_count = yield from self._gathering_with_room(portion)
            half = portion.group_count // 2
            if half and small_count + large_count > self.capacity_limit:
                first = portion.first_group
                pending += [_Portion(first + half, portion.group_count - half), _Portion(first, half)]
                continue
            if large_count:
                yield
            self.large.add(self.triangles, TEXELS_PER_TRIANGLE * (self._capacity - large_count), large_count)
            self._gathered = _Portion(portion.first_group, portion.group_count, small_count)
            self._portions.append(self._gathered)

    def _gathering_with_room(self, portion: _Portion) -> Generator[None, None, tuple[int, int]]:
        """Returns how many small and large triangles the portion has; more than `capacity_limit` are not all in the list."""
        counts = yield from self._gathering(portion)
        if self._capacity < sum(counts) <= self.capacity_limit:
            self.triangles.reserve(TEXELS_PER_TRIANGLE * sum(counts))
            counts = yield from self._gathering(portion)
        return counts

    @property
    def _capacity(self) -> int:
        return self.triangles.texel_count // TEXELS_PER_TRIANGLE

    def _gathering(self, portion: _Portion) -> Generator[None, None, tuple[int, int]]:
        """Pauses where a portion is long. Returns how many small and large triangles it has."""
        kernel = self.device.compute_kernel(GATHER_TRIANGLES, *self.flags)
        self.device.fill(self.counters, 0)
        end = portion.first_group + portion.group_count
        for first_group in range(portion.first_group, max(end, 1), GROUPS_AT_ONCE):
            if first_group > portion.first_group:
                yield
            kernel.dispatch_linear(
                max(min(end - first_group, GROUPS_AT_ONCE), 1) * kernel.declaration.local_size[0],
                **self.scene_data.bindings,
                **self.seen_space,
                face=self.face_table,
                work_table=self.work.texture,
                first_group=first_group,
                group_count=min(end - first_group, GROUPS_AT_ONCE),
                counters=self.counters,
                gathered_triangles=self.triangles.texture,
                triangle_capacity=self._capacity,
            )
        small_count, large_count = (int(count) for count in self.device.read(self.counters)[0])
        return small_count, large_count

    # batches

    def getting_ready(self, selected: range) -> Generator[None, None, None]:
        yield from self._holding()
        if self.large_count:
            yield from self.large.compiling()
        if self.small_count:
            yield from compiling(self.device, RASTERIZE_SMALL_TRIANGLES, *self.flags, *self._looks_first)
        if self.small_count and self._may_search_hidden(selected):
            yield from compiling(self.device, KEEP_SEEN_TRIANGLES, *self.flags)
            yield from compiling(self.device, ORDER_TRIANGLES)
        yield from super().getting_ready(selected)

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        self._hold()
        views = self.views_table(selected)
        self._begin(maps, selected, views)
        batch = {"views": views, "view_count": len(selected), "face": self.face_table}
        if not (self.small_count and self._may_search_hidden(selected)):
            self._rasterize_small(maps, batch, SKIP_NONE)
            return
        # most of what faces away stands behind the rest: it is searched before it is rasterized
        self._rasterize_small(maps, batch, SKIP_FACING_AWAY)
        self._cull_hidden(maps, batch)
        if not self.culled[self.opaque_indices].all():
            self._rasterize_small(maps, batch, SKIP_FACING)

    def _rasterize_small(self, maps: DepthMaps, batch: dict[str, Any], skipped_facing: int) -> None:
        for portion in self._gathered_portions():
            self.device.compute_kernel(RASTERIZE_SMALL_TRIANGLES, *self.flags, *self._looks_first).dispatch_linear(
                portion.small_count,
                gathered_triangles=self.triangles.texture,
                depth_maps=maps.texture,
                triangle_count=portion.small_count,
                skipped_facing=skipped_facing,
                **batch,
            )

    def _gathered_portions(self) -> Iterator[_Portion]:
        """Yields portions with small triangles, each while the list holds them."""
        for portion in self._portions:
            if not portion.small_count:
                continue
            if self._gathered is not portion:
                run_steps(self._gathering(portion))
                self._gathered = portion
            yield portion

    def _cull_hidden(self, maps: DepthMaps, batch: dict[str, Any]) -> None:
        """Put what the batch's views are near to seeing of all portions into one list, if that has room for it, in the order of its
        places in the maps."""
        self._has_searched_hidden = True
        capacity = min(self.small_count, self.capacity_limit)
        with Owned() as temporary:
            kept = temporary.own(LinearStore(self.device, TEXELS_PER_TRIANGLE * capacity))
            rows = -(-math.prod(self._block_grid) // LINEAR_TEXTURE_WIDTH)
            block_counts = temporary.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, TextureFormat.R32UI))
            self.device.fill(block_counts, 0)
            kept_count = 0
            for portion in self._gathered_portions():
                self.device.fill(self.counters, kept_count)
                self.device.compute_kernel(KEEP_SEEN_TRIANGLES, *self.flags).dispatch_linear(
                    portion.small_count,
                    gathered_triangles=self.triangles.texture,
                    kept_triangles=kept.texture,
                    depth_maps=maps.texture,
                    block_counts=block_counts,
                    counters=self.counters,
                    triangle_count=portion.small_count,
                    triangle_capacity=capacity,
                    **batch,
                )
                kept_count = int(self.device.read(self.counters)[0, 0])
            if kept_count > capacity:
                return
            self.triangles.replace_by(kept)
            self._order(kept_count, block_counts)
        self._gathered = _Portion(0, self.work.group_count, kept_count)
        self._portions = [self._gathered]
        self.kept_count = kept_count

    @property
    def _block_grid(self) -> tuple[int, int]:
        """rows and columns"""
        return -(-self.fitted.views.map_height_px // BLOCK_TEXELS), -(-self.fitted.views.map_width_px // BLOCK_TEXELS)

    def _order(self, count: int, block_counts: Texture) -> None:
        """The list in an order in which neighbours in the maps follow each other, and no longer than it is."""
        rows, columns = self._block_grid
        order = spread_out(rows)
        counts = self.device.read(block_counts).ravel()[: rows * columns].reshape(rows, columns)[order].astype(np.int64)
        self.device.fill(block_counts, 0)
        with Owned() as temporary:
            starts = np.zeros((rows, columns, 4), np.float32)
            starts[order, :, :2] = split_integers((np.cumsum(counts) - counts.ravel()).reshape(rows, columns))
            block_starts = temporary.own(self.device.upload_array(starts.reshape(-1, 4)))
            ordered = temporary.own(LinearStore(self.device, max(TEXELS_PER_TRIANGLE * count, 1)))
            self.device.compute_kernel(ORDER_TRIANGLES).dispatch_linear(
                count,
                kept_triangles=self.triangles.texture,
                ordered_triangles=ordered.texture,
                block_starts=block_starts,
                block_counts=block_counts,
                triangle_count=count,
            )
            self.triangles.replace_by(ordered)

    def counts(self) -> dict[str, int]:
        return {
            "small_triangle_count": self.small_count,
            "kept_small_triangle_count": self.kept_count,
            "large_triangle_count": self.large_count,
        }
