"""What a render will take and how wrong it will be, for a slider: the plan's times, corrected by what renders took and reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .batches import MANY_VIEWS
from .plan import PlannedOnce, RenderPlan, plan
from .quality import FEWEST_VIEWS, MAP_RESOLUTION_OF_VIEWS, MAP_RESOLUTIONS_PX, MOST_VIEWS
from .scene import SceneSnapshot

VIEW_COUNTS = tuple(sorted({1, 2, FEWEST_VIEWS, *(below for below, _ in MAP_RESOLUTION_OF_VIEWS), MANY_VIEWS - 1, MANY_VIEWS, MOST_VIEWS}))
"""What is planned for each map resolution. Between them the plan's model is nearly linear: it leaps where eye samples become more, which
they also are where one view is asked for, and two are as many as eight, a batch."""

ERROR_EXPONENT = 0.4
"""Estimated errors fall with the views to the power of -0.4: measured in one scene, the still life, between 8 and 128 views, most of whose
pixels are in penumbrae or at edges. Smooth penumbrae alone may fall faster."""


@dataclass(frozen=True)
class Forecast:
    """Of one picture, by the plan's model."""

    steps_ms: dict[int, tuple[float, ...]]
    """map resolution -> milliseconds of renders with VIEW_COUNTS"""
    planned_ms: float
    """of the settings that were planned"""
    planned_for: tuple[int, int]
    """their views and map resolution"""

    def compute_ms(self, view_count: int, map_resolution_px: int) -> float:
        """What the plan said where nothing has changed since; otherwise by the nearest map resolution."""
        if (view_count, map_resolution_px) == self.planned_for:
            return self.planned_ms
        steps_ms = self.steps_ms[min(self.steps_ms, key=lambda px: abs(math.log(px / map_resolution_px)))]
        # of fewer views only so much is known: scene and picture take as long
        within_ms = float(np.interp(view_count, VIEW_COUNTS, steps_ms))
        view_ms = (steps_ms[-1] - steps_ms[-2]) / (VIEW_COUNTS[-1] - VIEW_COUNTS[-2])
        return within_ms + view_ms * max(view_count - VIEW_COUNTS[-1], 0)


def make_forecast(snapshot: SceneSnapshot, planned: RenderPlan) -> Forecast:
    """Plans the picture some times more; the snapshot is not needed afterwards."""
    once = PlannedOnce()

    def predicted_ms(view_count: int, map_resolution_px: int) -> float:
        settings = replace(planned.settings, view_count=view_count, map_resolution_px=map_resolution_px)
        return plan(snapshot, settings, once=once).predicted_ms

    steps_ms = {px: tuple(predicted_ms(count, px) for count in VIEW_COUNTS) for px in MAP_RESOLUTIONS_PX}
    return Forecast(steps_ms, planned.predicted_ms, (planned.settings.view_count, planned.settings.map_resolution_px))


def predict_error(measured: float, measured_view_count: int, view_count: int) -> float:
    """The error estimate that so many views would have, from that of a render with another number."""
    return measured * (measured_view_count / view_count) ** ERROR_EXPONENT
