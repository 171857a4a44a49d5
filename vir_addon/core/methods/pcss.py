"""Percentage-closer soft shadows (Fernando 2005): one map from the light's centre, drawn by the hardware rasterizer.

What makes its shadows soft is how the map is looked up (core/passes/percentage_closer.py). It is drawn once and kept; with cut-outs it
is drawn for every batch, because each has other thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

from ..passes.percentage_closer import NearestDepth
from ..passes.shadow_maps import DepthMaps
from .base import DepthMapMethod, FaceJob
from .kept_map import KeptMap
from .mvr import MultiviewRasterization


class PercentageCloserSoftShadows(KeptMap):
    def __init__(self, job: FaceJob) -> None:
        super().__init__(job, MultiviewRasterization(job))

    def preparing(self) -> Generator[None, None, None]:
        self._nearest_depth = self._owned.own(NearestDepth(self.device))
        yield from ()

    def _making(self) -> Generator[None, None, None]:
        yield from super()._making()
        assert self._kept is not None
        self._find_nearest(self._kept)

    def maps_of(self, selected: range, lend: Callable[[], DepthMaps]) -> DepthMaps:
        if not self.has_cut_outs:
            return super().maps_of(selected, lend)
        return DepthMapMethod.maps_of(self, selected, lend)

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        super()._fill(maps, selected)
        self._find_nearest(maps)

    def _find_nearest(self, maps: DepthMaps) -> None:
        self.nearest_m = max(self._nearest_depth.find(maps), self.fitted.views.near_m)
