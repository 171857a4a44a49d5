"""One module per technique; `depth_map_method` picks the one that the plan chose."""

from __future__ import annotations

from ..plan import PlannedPass
from ..settings import Method, PointGeneration
from .base import DepthMapMethod, FaceJob
from .hybrid import HybridRasterization
from .ivir import ImprovedViewIndependentRasterization
from .ivir_by_rasterizer import PointsByRasterizer
from .micro import MicroTriangleRasterization
from .mvr import MultiviewRasterization
from .vir import ViewIndependentRasterization
from .vwss import ViewWarpedSoftShadows


def depth_map_method(planned: PlannedPass, job: FaceJob) -> DepthMapMethod:
    if planned.method is Method.MVR:
        return MultiviewRasterization(job)
    if planned.method is Method.MICRO:
        return MicroTriangleRasterization(job)
    if planned.method is Method.VIR:
        return ViewIndependentRasterization(job)
    if planned.points is None:
        raise ValueError(f"{planned.method.value} needs a point storage")
    if planned.method is Method.HYBRID:
        return HybridRasterization(job, planned.points)
    if planned.method is Method.VWSS:
        return ViewWarpedSoftShadows(job, planned.points)
    by_rasterizer = planned.point_generation is PointGeneration.RASTERIZER
    return (PointsByRasterizer if by_rasterizer else ImprovedViewIndependentRasterization)(job, planned.points)
