"""How many batches the views of a frame come in, and how many eye samples look each batch up."""

from __future__ import annotations

import math

from .passes.shadow_maps import MAX_BATCH_VIEWS
from .scene import SceneSnapshot
from .settings import Method, Settings

MIN_EYE_SAMPLES = 8
MAX_EYE_SAMPLES = 32
MANY_EYE_SAMPLES = 64
"""where MANY_VIEWS are asked for: of what is left of the error most is pixels that outlines cut"""
MANY_VIEWS = 128
MAX_MANY_EYE_SAMPLES_PX = 1 << 20
"""of the picture: G-buffers of a batch take 48 bytes for each pixel and eye sample"""
MAX_BATCH_EYE_SAMPLES = 4
MIN_EYE_SAMPLE_VIEWS = 4
"""so many at least are spread over the whole light; two of MANY_EYE_SAMPLES"""


def most_eye_samples_for(snapshot: SceneSnapshot, most_views: int, settings: Settings) -> int:
    asked = _views_asked_for(settings) if most_views == 1 else most_views
    is_small = snapshot.width_px * snapshot.height_px <= MAX_MANY_EYE_SAMPLES_PX
    return MANY_EYE_SAMPLES if asked >= MANY_VIEWS and is_small else MAX_EYE_SAMPLES


def _views_asked_for(settings: Settings) -> int:
    """For hard shadows, which have one view, but as many eye samples as if there were all of these. To `pcss` they mean nothing."""
    return settings.view_count if settings.method is not Method.PCSS else 0


def eye_samples_of_batch(most_views: int, batch_count: int, settings: Settings, most_eye_samples: int) -> int:
    """The view of hard shadows is one that every eye sample sees."""
    views = math.ceil(most_views / batch_count)
    if most_views == 1:
        views = max(MAX_BATCH_VIEWS, _views_asked_for(settings) // batch_count)
    least_views = MIN_EYE_SAMPLE_VIEWS * MAX_EYE_SAMPLES // most_eye_samples
    return max(min(math.ceil(most_eye_samples / batch_count), views // least_views, MAX_BATCH_EYE_SAMPLES), 1)


def most_batch_views(map_resolution_px: int, settings: Settings) -> int:
    """Eight maps of 1024^2 and 2048^2 a batch; larger maps in smaller batches, so that a batch stays below 128 MiB of depth."""
    return max(1, min(MAX_BATCH_VIEWS, settings.batch_view_count, MAX_BATCH_VIEWS * 2048**2 // map_resolution_px**2))


def _least_batch_count(most_views: int, map_resolution_px: int, settings: Settings) -> int:
    return math.ceil(most_views / most_batch_views(map_resolution_px, settings))


def light_batch_count(most_views: int, map_resolution_px: int, settings: Settings, only_reflects: bool, most_eye_samples: int) -> int:
    """What reflectors show is looked up by as many eye samples as rays are asked for."""
    if only_reflects:
        return _least_batch_count(most_views, map_resolution_px, settings)
    return _batch_count(most_views, map_resolution_px, settings, most_eye_samples)


def _batch_count(most_views: int, map_resolution_px: int, settings: Settings, most_eye_samples: int) -> int:
    """Where so few batches have too few eye samples, more and smaller ones. All eye samples of hard shadows could come in one, which takes
    memory for each: they come in several, too."""
    batch_count = _least_batch_count(most_views, map_resolution_px, settings)
    eye_samples = batch_count * eye_samples_of_batch(most_views, batch_count, settings, most_eye_samples)
    has_enough = most_views > 1 and eye_samples >= MIN_EYE_SAMPLES
    return batch_count if has_enough else max(MIN_EYE_SAMPLES, most_eye_samples // MAX_BATCH_EYE_SAMPLES)
