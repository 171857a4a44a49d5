"""Multiview rasterization: the scene is drawn once per view, as fairly as can be.

Per view only the instances that its window sees, closed surfaces with back faces culled, instances of a mesh as one
instanced draw, all views of a batch into one target, linear depth from the fragment's 1/w without a varying.
"""

from __future__ import annotations

from collections.abc import Generator

from ...device.interface import EMPTY_DEPTH_BITS
from ..passes.shadow_maps import RASTERIZE_DEPTH, DepthMaps
from ..steps import compiling_raster
from .base import DepthMapMethod


class MultiviewRasterization(DepthMapMethod):
    def getting_ready(self, selected: range) -> Generator[None, None, None]:
        yield from compiling_raster(self.device, RASTERIZE_DEPTH, *self.raster_flags)
        yield from super().getting_ready(selected)

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        kernel = self.device.raster_kernel(RASTERIZE_DEPTH, *self.raster_flags)
        target = maps.target
        self.device.fill(maps.texture, EMPTY_DEPTH_BITS)
        self.device.fill(target.depth, 0)
        table = self.views_table(selected)
        for index, seen, viewport in self.maps_to_draw(selected):
            draws = self.scene_data.draws(seen[~self.scene_data.cut_out[seen]], self.culled)
            kernel.draw(target, viewport, draws, instances=self.scene_data.instances, face=self.face_table, views=table, view_index=index)
        self._rasterize_cut_outs(maps, selected, table)
