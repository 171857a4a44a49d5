"""View-independent rasterization as first published (Marrs et al. 2017), as far as its successors describe it; to be compared with `ivir`.

Each triangle is put before a perspective generation view of the depth maps' own field of view, centred and parallel to its picture,
as near as the nearest view of the light comes to it. Seen under an angle a texel covers less, so the rate is raised for all triangles
alike by what the worst angle of any map needs. A perspective samples a plane that is parallel to its picture evenly, so the lattice
is a square one; what `ivir` changed is the rate: its own for every triangle, and its parts, from where and how it lies before the views.

Points go into a buffer, nothing is culled at random. The kernel that replays them takes a few neighbours at a time and writes only the
nearest of those that fall into one texel (local point culling).
"""

from __future__ import annotations

from ..passes.points import POINTS_AT_ONCE
from ..settings import PointStorage
from .base import FaceJob
from .ivir import ImprovedViewIndependentRasterization


class ViewIndependentRasterization(ImprovedViewIndependentRasterization):
    def __init__(self, job: FaceJob) -> None:
        super().__init__(job, PointStorage.BUFFERED)
        self.sampling_flags = ["GLOBAL_RATE"] + ["WATERTIGHT"] * self.settings.watertight
        # points that cover several texels would have to be compared in all of them
        if "NEAR_SURFACES" not in self.splat_flags:
            self.replay_flags = ["LOCAL_CULLING"]
            self.points_per_invocation = POINTS_AT_ONCE

    def _may_search_hidden(self, selected: range) -> bool:
        return False
