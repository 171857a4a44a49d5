"""What a render will take and how wrong it will be, for a slider: the plan's times, corrected by what renders took and reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .plan import RenderPlan, plan
from .quality import FEWEST_VIEWS, MOST_VIEWS, map_resolution_of_views
from .scene import SceneSnapshot

FORECAST_STEPS = 4
"""numbers of views that a plan is made for; between them times follow a power law closely"""

ERROR_EXPONENT = 0.4
"""Estimated errors fall with the views to the power of -0.4: 0.35 to 0.45 for the lights of the demo scenes between 8 and 256 views, most
of which have penumbrae and edges everywhere; smooth penumbrae alone fall with -0.75."""


@dataclass(frozen=True)
class Forecast:
    """Of one picture."""

    view_counts: tuple[int, ...]
    predicted_ms: tuple[float, ...]
    """of renders with so many views, by the plan's model"""

    def compute_ms(self, view_count: int) -> float:
        """Between the steps along a power law, beyond them as the nearest two say."""
        x, y = np.log(self.view_counts), np.log(np.maximum(self.predicted_ms, 1e-3))
        at = math.log(max(view_count, 1))
        index = int(np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2))
        slope = (y[index + 1] - y[index]) / (x[index + 1] - x[index])
        return math.exp(y[index] + slope * (at - x[index]))


def make_forecast(snapshot: SceneSnapshot, planned: RenderPlan) -> Forecast:
    """Plans the picture a few times more; the snapshot is not needed afterwards."""
    counts = tuple(round(count) for count in np.geomspace(FEWEST_VIEWS, MOST_VIEWS, FORECAST_STEPS))
    settings = [replace(planned.settings, view_count=count, map_resolution_px=map_resolution_of_views(count)) for count in counts]
    return Forecast(counts, tuple(plan(snapshot, wanted).predicted_ms for wanted in settings))


def predict_error(measured: float, measured_view_count: int, view_count: int) -> float:
    """The error estimate that so many views would have, from that of a render with another number."""
    return measured * (measured_view_count / view_count) ** ERROR_EXPONENT
