"""What a render will take and how wrong it will be, for a slider: the plan's times, corrected by what renders took and reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from .plan import RenderPlan, plan
from .quality import FEWEST_VIEWS, MAP_RESOLUTIONS_PX, MOST_VIEWS
from .scene import SceneSnapshot

VIEW_COUNTS = (FEWEST_VIEWS, MOST_VIEWS)
"""what is planned for each map resolution; the plan's model is nearly linear between them"""

ERROR_EXPONENT = 0.4
"""Estimated errors fall with the views to the power of -0.4: measured in one scene, the still life, between 8 and 128 views, most of whose
pixels are in penumbrae or at edges. Smooth penumbrae alone may fall faster."""


@dataclass(frozen=True)
class Forecast:
    """Of one picture, by the plan's model."""

    steps_ms: dict[int, tuple[float, float]]
    """map resolution -> milliseconds of renders with VIEW_COUNTS"""
    planned_ms: float
    """of the settings that were planned"""
    planned_for: tuple[int, int]
    """their views and map resolution"""

    def compute_ms(self, view_count: int, map_resolution_px: int) -> float:
        """What the plan said where nothing has changed since; otherwise by the nearest map resolution."""
        if (view_count, map_resolution_px) == self.planned_for:
            return self.planned_ms
        nearest_px = min(self.steps_ms, key=lambda px: abs(math.log(px / map_resolution_px)))
        (few, many), (few_ms, many_ms) = VIEW_COUNTS, self.steps_ms[nearest_px]
        return max(few_ms + (many_ms - few_ms) * (view_count - few) / (many - few), few_ms / few * view_count)


def make_forecast(snapshot: SceneSnapshot, planned: RenderPlan) -> Forecast:
    """Plans the picture a few times more; the snapshot is not needed afterwards."""
    steps_ms = {}
    for resolution_px in MAP_RESOLUTIONS_PX:
        settings = [replace(planned.settings, view_count=count, map_resolution_px=resolution_px) for count in VIEW_COUNTS]
        few_ms, many_ms = (plan(snapshot, one).predicted_ms for one in settings)
        steps_ms[resolution_px] = (few_ms, many_ms)
    return Forecast(steps_ms, planned.predicted_ms, (planned.settings.view_count, planned.settings.map_resolution_px))


def predict_error(measured: float, measured_view_count: int, view_count: int) -> float:
    """The error estimate that so many views would have, from that of a render with another number."""
    return measured * (measured_view_count / view_count) ** ERROR_EXPONENT
