"""One module per technique; `depth_map_method` picks the one that the plan chose."""

from __future__ import annotations

from collections.abc import Callable

from ..light_plan import PlannedPass
from ..settings import Method, PointGeneration, PointStorage
from .base import DepthMapMethod, FaceJob
from .epr import EyeBasedPointRendering
from .hybrid import HybridRasterization
from .ivir import ImprovedViewIndependentRasterization
from .ivir_by_rasterizer import PointsByRasterizer
from .kept_map import KeptMap
from .micro import MicroTriangleRasterization
from .mvr import MultiviewRasterization
from .pcss import PercentageCloserSoftShadows
from .vir import ViewIndependentRasterization
from .vwss import ViewWarpedSoftShadows

WITHOUT_CHOICE: dict[Method, Callable[[FaceJob], DepthMapMethod]] = {
    Method.MVR: MultiviewRasterization,
    Method.MICRO: MicroTriangleRasterization,
    Method.VIR: ViewIndependentRasterization,
    Method.PCSS: PercentageCloserSoftShadows,
}
OF_POINTS: dict[Method, Callable[[FaceJob, PointStorage], DepthMapMethod]] = {
    Method.IVIR: ImprovedViewIndependentRasterization,
    Method.HYBRID: HybridRasterization,
    Method.VWSS: ViewWarpedSoftShadows,
    Method.EPR: EyeBasedPointRendering,
}


def depth_map_method(planned: PlannedPass, job: FaceJob) -> DepthMapMethod:
    method = _method_of_face(planned, job)
    if planned.view_count > 1 or planned.method is Method.PCSS or method.has_cut_outs:
        return method
    return KeptMap(job, method)


def _method_of_face(planned: PlannedPass, job: FaceJob) -> DepthMapMethod:
    if planned.method in WITHOUT_CHOICE:
        return WITHOUT_CHOICE[planned.method](job)
    if planned.points is None:
        raise ValueError(f"{planned.method.value} needs a point storage")
    if planned.point_generation is PointGeneration.RASTERIZER:
        return PointsByRasterizer(job, planned.points)
    return OF_POINTS[planned.method](job, planned.points)
