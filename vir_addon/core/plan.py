"""What the scene calls for, decided before any GPU work: one line per light with its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from . import cost
from .bounds import SceneBounds, compute_bounds
from .errors import SceneError, UsageError
from .fit import light_casters
from .pass_set import unique_pass_names
from .passes.shadow_maps import MAX_BATCH_VIEWS
from .scene import Camera, Light, SceneSnapshot
from .settings import Method, PointStorage, Settings
from .views import light_axes

MIN_EYE_SAMPLES = 8
MAX_EYE_SAMPLES = 16
"""Anti-aliasing gains little from more: with 16 samples of the filter an edge pixel is off by about a fiftieth."""


@dataclass(frozen=True)
class PlannedPass:
    light_name: str
    pass_name: str
    runs: bool
    """False: surfaces get `surface_value`, the background 1, and no map is made"""
    reason: str
    """why it runs as it does, or why it does not; one clause in plain words"""
    method: Method = Method.MVR
    """never AUTO: the plan has decided"""
    points: PointStorage | None = None
    view_count: int = 0
    map_resolution_px: int = 0
    surface_value: float = 1.0
    predicted_ms: float = 0.0


@dataclass(frozen=True)
class RenderPlan:
    settings: Settings
    passes: tuple[PlannedPass, ...]
    batch_count: int
    """steps after which a valid picture exists; each renders its share of every light's views"""
    eye_sample_count: int
    """eye G-buffers with sub-pixel offsets that batches take turns with"""
    notes: tuple[str, ...] = ()
    """what the user should know, the snapshot's notes included"""
    predicted_ms: float = 0.0


def plan(snapshot: SceneSnapshot, settings: Settings) -> RenderPlan:
    """Decide per light.

    Raises UsageError for lights that the scene does not have, SceneError when the scene has no light that can be rendered.
    """
    lights = _chosen_lights(snapshot, settings)
    names = unique_pass_names([light.name for light in snapshot.lights])
    bounds = compute_bounds(snapshot)
    passes = tuple(_plan_light(snapshot, light, names[light.name], settings, bounds) for light in lights)
    running = [planned for planned in passes if planned.runs]
    most_views = max((planned.view_count for planned in running), default=0)
    per_batch = _views_per_batch(settings)
    batch_count = max(math.ceil(most_views / per_batch), MIN_EYE_SAMPLES) if running else 1
    eye_sample_count = min(batch_count, MAX_EYE_SAMPLES)
    eye_ms = cost.eye_ms(snapshot, eye_sample_count)
    return RenderPlan(
        settings=settings,
        passes=passes,
        batch_count=batch_count,
        eye_sample_count=eye_sample_count,
        notes=snapshot.notes,
        predicted_ms=sum(planned.predicted_ms for planned in running) + eye_ms,
    )


def _views_per_batch(settings: Settings) -> int:
    """Eight maps of 1024^2 and 2048^2; larger maps in smaller batches, so that a batch stays below 128 MiB of depth."""
    return max(1, min(MAX_BATCH_VIEWS, MAX_BATCH_VIEWS * 2048**2 // settings.map_resolution_px**2))


def _chosen_lights(snapshot: SceneSnapshot, settings: Settings) -> list[Light]:
    known = {light.name: light for light in snapshot.lights}
    if settings.light_names is not None:
        missing = [name for name in settings.light_names if name not in known]
        if missing:
            raise UsageError(f"no light named {', '.join(map(repr, missing))}; the scene has {', '.join(map(repr, known)) or 'none'}")
        lights = [light for light in snapshot.lights if light.name in settings.light_names]
    else:
        lights = list(snapshot.lights)
    if not lights:
        raise SceneError(f"scene {snapshot.scene_name!r} has no light that is rendered; add an area light or enable one for rendering")
    if not any(light.shape.is_area for light in lights):
        kinds = ", ".join(f"{light.name!r} ({light.shape.value})" for light in lights)
        raise SceneError(f"scene {snapshot.scene_name!r} has no area light, the only kind this version makes shadows of; it has {kinds}")
    return lights


def _plan_light(snapshot: SceneSnapshot, light: Light, pass_name: str, settings: Settings, bounds: SceneBounds) -> PlannedPass:
    skipped = _reason_to_skip(snapshot, light, bounds.corners_ws)
    if skipped is not None:
        reason, surface_value = skipped
        return PlannedPass(light.name, pass_name, runs=False, reason=reason, surface_value=surface_value)
    has_size = light.size_x_m > 0 or light.size_y_m > 0
    view_count = settings.view_count if has_size else 1
    size = f"{light.size_x_m:.3g} x {light.size_y_m:.3g} m {light.shape.value}"
    reason = size if has_size else "the light has no size: one view, a hard shadow"
    estimates = cost.estimate_methods(snapshot, light, view_count, settings, bounds)
    if settings.method is Method.AUTO:
        method = min(estimates, key=lambda m: estimates[m])
        other = max(estimates, key=lambda m: estimates[m])
        reason += (
            f"; {method.value} about {max(estimates[other] / max(estimates[method], 1e-9), 1.0):.1f} times faster than {other.value} here"
        )
    else:
        method = settings.method
        reason += f"; {method.value} as asked"
    return PlannedPass(
        light.name,
        pass_name,
        runs=True,
        reason=reason,
        method=method,
        points=settings.points if method is Method.IVIR else None,
        view_count=view_count,
        map_resolution_px=settings.map_resolution_px,
        predicted_ms=estimates[method] + cost.resolve_ms(snapshot, view_count),
    )


def _reason_to_skip(snapshot: SceneSnapshot, light: Light, corners_ws: np.ndarray) -> tuple[str, float] | None:  # noqa: PLR0911  a list of reasons
    """The reason and the value of surfaces, or None when the light calls for work."""
    if not light.shape.is_area:
        return f"skipped: this version makes shadows of area lights only, this is a {light.shape.value} light", 1.0
    if not light.casts_shadow:
        return "skipped: the light casts no shadow", 1.0
    if light.strength == 0 or not math.isfinite(light.strength):
        return "skipped: the light has no strength", 1.0
    visible = snapshot.instances.visible_to_camera & _may_be_in_picture(snapshot.camera, corners_ws)
    if not visible.any():
        return "skipped: no surface is in the picture", 1.0
    if light.receivers is not None:
        visible &= light.receivers
        if not visible.any():
            return "skipped: light linking leaves it nothing in the picture to light", 1.0
    depths = (corners_ws[visible] - light.world_from_light[:3, 3]) @ light_axes(light)[2]
    if not (depths > 0).any():
        return "skipped: it faces away from everything in the picture", 0.0
    if not len(light_casters(snapshot, light)):
        return "skipped: nothing casts its shadow", 1.0
    return None


def _may_be_in_picture(camera: Camera, corners_ws: np.ndarray) -> np.ndarray:
    """(instance_count,) bool: boxes that are not wholly outside one side of the camera's view."""
    view_from_world = np.linalg.inv(camera.world_from_view)
    p = corners_ws @ view_from_world[:3, :3].T + view_from_world[:3, 3]
    left, right, bottom, top = camera.window
    depth = -p[..., 2]
    scale = np.ones_like(depth) if camera.is_orthographic else depth
    sides = [
        depth - camera.clip_start_m,
        camera.clip_end_m - depth,
        p[..., 0] - left * scale,
        right * scale - p[..., 0],
        p[..., 1] - bottom * scale,
        top * scale - p[..., 1],
    ]
    return np.logical_and.reduce([(side >= 0).any(axis=-1) for side in sides])
