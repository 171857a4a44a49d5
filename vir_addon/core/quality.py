"""One slider from fast to exact: how many views and how fine maps it stands for, and back."""

from __future__ import annotations

import math

FEWEST_VIEWS, MOST_VIEWS = 8, 512
"""at the slider's ends: a single batch, and more than any measured error asked for"""

MAP_RESOLUTION_OF_VIEWS = ((32, 512), (128, 1024))
"""Below so many views, maps of so many pixels; above 2048. Finer maps than that gain nothing while the views' own noise is larger."""
FINEST_MAP_PX = 2048
MAP_RESOLUTIONS_PX = (*(px for _, px in MAP_RESOLUTION_OF_VIEWS), FINEST_MAP_PX)


def views_of_quality(quality: float) -> int:
    """0 (fast) .. 1 (exact) -> views of a light with size; whole batches, equal steps of the slider multiply equally."""
    share = min(max(quality, 0.0), 1.0)
    return FEWEST_VIEWS * round((MOST_VIEWS / FEWEST_VIEWS) ** share)


def quality_of_views(view_count: int) -> float:
    """The inverse: where the slider stands for a number of views; its ends for what lies beyond them."""
    share = math.log(max(view_count, 1) / FEWEST_VIEWS) / math.log(MOST_VIEWS / FEWEST_VIEWS)
    return min(max(share, 0.0), 1.0)


def map_resolution_of_views(view_count: int) -> int:
    """Width and height of depth maps in pixels that go with so many views."""
    return next((px for below, px in MAP_RESOLUTION_OF_VIEWS if view_count < below), FINEST_MAP_PX)
