"""What every method offers: depth maps of a batch of views of one face."""

from __future__ import annotations

import abc
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...device.interface import EMPTY_DEPTH_BITS, Device
from ...device.owned import Owned
from ..fit import FittedFace
from ..passes.scene_data import SceneData
from ..passes.shadow_maps import MAX_BATCH_VIEWS, RASTERIZE_CUT_OUTS, DepthMaps, views_table
from ..scene import Light
from ..settings import Settings
from ..steps import compiling_raster, run_steps
from .shared import SharedByFaces

if TYPE_CHECKING:
    from .large_triangles import LargeTriangles


@dataclass(frozen=True)
class FaceJob:
    """What there is to do for one face of a light, whatever the method."""

    scene_data: SceneData
    fitted: FittedFace
    face_table: np.ndarray
    """rows for the kernels"""
    culled: np.ndarray
    """(instance_count,) bool of `bounds.cullable_instances`"""
    light: Light
    samples_m: np.ndarray
    """(view_count, 3) of `sampling.light_samples`"""
    settings: Settings
    shared: SharedByFaces


class DepthMapMethod(abc.ABC):
    """Fills the depth maps of one face of one light, batch by batch."""

    def __init__(self, job: FaceJob) -> None:
        self.settings, self.shared = job.settings, job.shared
        self.scene_data, self.fitted, self.face_table, self.culled = job.scene_data, job.fitted, job.face_table, job.culled
        self.device: Device = job.scene_data.device
        self.portion_count = 1
        self.projection_flags = ["ORTHOGRAPHIC"] * job.fitted.views.is_orthographic
        self.raster_flags = list(self.projection_flags)
        """of what the rasterizer draws into the maps"""
        is_cut_out = self.scene_data.cut_out[self.fitted.caster_indices]
        self.opaque_indices = self.fitted.caster_indices[~is_cut_out]
        """(n,) int64 casters without an opacity map"""
        self.has_cut_outs = bool(is_cut_out.any())
        self.large: LargeTriangles | None = None
        """of methods whose kernels leave them to the rasterizer"""
        self._cut_out_map_count = 0
        self.nearest_m = job.fitted.views.near_m
        """after `maps_of`: nothing in the maps is nearer"""

    @property
    def caster_triangle_count(self) -> int:
        mesh_index = self.scene_data.snapshot.instances.mesh_index[self.fitted.caster_indices]
        return int(self.scene_data.triangle_counts[mesh_index].sum())

    def prepare(self) -> None:
        """Work that all batches share, e.g. generating points."""
        self.device.run(run_steps, self.preparing())

    def preparing(self) -> Generator[None, None, None]:
        """`prepare` in steps, on the device's thread."""
        yield from ()  # most methods have nothing to prepare

    def getting_ready(self, selected: range) -> Generator[None, None, None]:
        """What `maps_of` would do at once where it can be done in steps, on the device's thread."""
        if self.has_cut_outs:
            yield from compiling_raster(self.device, RASTERIZE_CUT_OUTS, *self.raster_flags)

    def maps_of(self, selected: range, lend: Callable[[], DepthMaps]) -> DepthMaps:
        """The maps of the selected views, in those that are lent unless the method has its own."""
        maps = lend()
        self.fill(maps, selected)
        return maps

    def fill(self, maps: DepthMaps, selected: range) -> None:
        """Clear the maps and write the depths of the selected views into them, in order."""
        self.device.run(self._fill, maps, selected)

    @abc.abstractmethod
    def _fill(self, maps: DepthMaps, selected: range) -> None:
        """`fill` on the device's thread."""

    def release(self) -> None:  # noqa: B027  nor to free
        """Free what `prepare` made."""

    def counts(self) -> dict[str, int]:
        """What was prepared for the views so far, by the fields of `PassStatistics`."""
        return {}

    def _begin(self, maps: DepthMaps, selected: range, views: np.ndarray) -> None:
        """Clear the maps and draw what is not for kernels: the rasterizer knows only its own depths, while kernels keep the smaller one
        of what is there. views: rows of `views_table` of the selected views"""
        self.device.fill(maps.texture, EMPTY_DEPTH_BITS)
        large = self.large if self.large is not None and self.large.triangle_count else None
        if large or self.has_cut_outs:
            self.device.fill(maps.target.depth, 0)
        if large:
            large.rasterize(maps, selected, views)
        self._rasterize_cut_outs(maps, selected, views)

    def _rasterize_cut_outs(self, maps: DepthMaps, selected: range, table: np.ndarray) -> None:
        """Draw the casters with an opacity map, whatever the method does with the others. Whatever the number of views, each map has
        thresholds of its own. table: rows of `views_table` of the selected views"""
        if not self.has_cut_outs or self.scene_data.opacity_maps is None:
            return
        kernel = self.device.raster_kernel(RASTERIZE_CUT_OUTS, *self.raster_flags)
        bindings = {
            "instances": self.scene_data.instances,
            "face": self.face_table,
            "views": table,
            **self.scene_data.opacity_maps.bindings,
        }
        for index, seen, viewport in self.maps_to_draw(selected):
            draws = self.scene_data.draws(seen[self.scene_data.cut_out[seen]])
            kernel.draw(maps.target, viewport, draws, view_index=index, map_number=self._cut_out_map_count + index, **bindings)
        self._cut_out_map_count += len(selected)

    def maps_to_draw(self, selected: range) -> Iterator[tuple[int, np.ndarray, tuple[int, int, int, int]]]:
        """For the rasterizer, of every selected view: its place in the batch, (n,) int64 casters that it sees, its map's viewport."""
        width, height = self.fitted.views.map_width_px, self.fitted.views.map_height_px
        for index, view in enumerate(selected):
            yield index, self.fitted.caster_indices[self.fitted.seen_by_view[view]], (0, index * height, width, height)

    def views_table(self, selected: range) -> np.ndarray:
        return views_table(self.fitted.views, selected)


class ReplayMethod(DepthMapMethod):
    """Keeps on the device what every batch replays; lets go of it when other faces need the memory, and makes it again in its turn."""

    def __init__(self, job: FaceJob) -> None:
        super().__init__(job)
        self._is_held = self._was_dropped = self._has_searched_hidden = False
        self._owned = Owned()

    @property
    @abc.abstractmethod
    def held_bytes(self) -> int: ...

    @abc.abstractmethod
    def _making(self) -> Generator[None, None, None]:
        """Make what is replayed, in steps; sets `_is_held` as soon as there is something to free."""

    @abc.abstractmethod
    def _free(self) -> None:
        """Release what is replayed."""

    def _hold(self) -> None:
        """Before every use of what is replayed."""
        run_steps(self._holding())

    def _holding(self) -> Generator[None, None, None]:
        """`_hold` in steps"""
        self.shared.begin_turn(self)
        if not self._is_held:
            yield from self._making()
        self.shared.touch(self)

    def drop(self) -> None:
        self._free()
        self._is_held, self._was_dropped = False, True

    def _may_search_hidden(self, selected: range) -> bool:
        """Once, after a batch large enough to stand for all views, and only if there are others left to gain from it. What is made
        again for every batch would be searched every time; what stands behind an opacity map is hidden in one batch and seen in another."""
        return (
            self.settings.cull_hidden
            and not (self._has_searched_hidden or self._was_dropped or self.has_cut_outs)
            and len(selected) == MAX_BATCH_VIEWS < self.fitted.views.view_count
        )

    def release(self) -> None:
        self.shared.forget(self)
        if self._is_held:
            self.drop()
        self._owned.close()
