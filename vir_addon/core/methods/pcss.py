"""Percentage-closer soft shadows (Fernando 2005): one map from the light's centre, drawn by the hardware rasterizer.

What makes its shadows soft is how the map is looked up (core/passes/percentage_closer.py). It is drawn once and kept; with cut-outs it
is drawn for every batch, because each has other thresholds.
"""

from __future__ import annotations

from ..passes.percentage_closer import NearestDepth
from ..passes.shadow_maps import DepthMaps
from .base import ReplayMethod
from .mvr import MultiviewRasterization

BYTES_PER_TEXEL = 8
"""the map's and the rasterizer's own depth"""


class PercentageCloserSoftShadows(ReplayMethod, MultiviewRasterization):
    def _prepare(self) -> None:
        self._nearest_depth = self._owned.own(NearestDepth(self.device))

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_TEXEL * self.fitted.views.map_width_px * self.fitted.views.map_height_px

    def _make(self) -> None:
        self.kept_maps = DepthMaps(self.device, self.fitted.views.map_width_px, self.fitted.views.map_height_px, 1)
        self._is_held = True
        self._draw(self.kept_maps)

    def _free(self) -> None:
        if self.kept_maps is not None:
            self.kept_maps.release()
        self.kept_maps = None

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        if self.has_cut_outs:
            self._draw(maps)
        else:
            self._hold()

    def _draw(self, maps: DepthMaps) -> None:
        super()._fill(maps, range(1))
        self.nearest_m = max(self._nearest_depth.find(maps), self.fitted.views.near_m)
