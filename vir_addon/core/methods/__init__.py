"""One module per technique; `depth_map_method` picks the one that the plan chose."""

from __future__ import annotations

import numpy as np

from ..fit import FittedFace
from ..passes.scene_data import SceneData
from ..plan import PlannedPass
from ..scene import Light
from ..settings import Method, Settings
from .base import DepthMapMethod
from .ivir import ImprovedViewIndependentRasterization
from .micro import MicroTriangleRasterization
from .mvr import MultiviewRasterization
from .shared import SharedByFaces


def depth_map_method(
    planned: PlannedPass,
    scene_data: SceneData,
    fitted: FittedFace,
    face_table: np.ndarray,
    culled: np.ndarray,
    light: Light,
    samples_m: np.ndarray,
    settings: Settings,
    shared: SharedByFaces,
) -> DepthMapMethod:
    if planned.method is Method.MVR:
        return MultiviewRasterization(scene_data, fitted, face_table, culled)
    if planned.method is Method.MICRO:
        return MicroTriangleRasterization(scene_data, fitted, face_table, culled, light, samples_m, settings, shared)
    if planned.points is None:
        raise ValueError(f"{planned.method.value} needs a point storage")
    return ImprovedViewIndependentRasterization(scene_data, fitted, face_table, culled, light, samples_m, settings, planned.points, shared)
