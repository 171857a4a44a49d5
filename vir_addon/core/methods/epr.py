"""Eye-based point rendering of omnidirectional shadows (Gavane & Watson 2022, "Eye-Based Point Rendering for Dynamic Multiview Effects").

Points are `ivir`'s where the picture shows as much as the maps, and fewer where a pixel of the eye takes several texels of a map: the
lattice is made coarser by the ratio of distances of eq. 5. A cell that is no larger than a texel is written directly, a larger one is a
splat: its footprint, clipped by the edges of its triangle. Splats cover texels by the rasterizer's rule, points enlarge outlines
by half a texel; the lowest bit of a depth tells which of the two wrote it, as with `hybrid`. Maps are only as large as the picture
asks for (eq. 6; `fit.finest_tangent`).
"""

from __future__ import annotations

from typing import Any

from ..passes.points import SPLAT_CELLS
from ..settings import PointStorage
from .base import FaceJob
from .ivir import ImprovedViewIndependentRasterization


class EyeBasedPointRendering(ImprovedViewIndependentRasterization):
    def __init__(self, job: FaceJob, storage: PointStorage) -> None:
        super().__init__(job, storage)
        self.sampling_flags.append("EYE_DENSITY")
        # what is near to the light is splatted: points always stay within their texel
        self.splat_flags = [flag for flag in self.splat_flags if flag != "NEAR_SURFACES"] + ["MIXED_MAPS"]
        self.raster_flags.append("MIXED_MAPS")

    def _replay(self, **batch: Any) -> None:
        super()._replay(**batch)
        self.device.compute_kernel(SPLAT_CELLS).dispatch_linear(
            self.buffered_splat_count,
            **batch,
            **self.scene_data.bindings,
            face=self.face_table,
            points=self.points.texture,
            buffer_end=self.points.texel_count,
            splat_count=self.buffered_splat_count,
        )

    def _may_search_hidden(self, selected: range) -> bool:
        return not self.buffered_splat_count and super()._may_search_hidden(selected)
