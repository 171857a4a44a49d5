"""What each light calls for: whether its pass runs and why, with which method, views and maps, and how long that may take."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from . import cost
from .batches import most_batch_views
from .bounds import SceneBounds
from .enclosure import CameraShell, sealing_object, shell_against
from .errors import UsageError
from .fit import fit_light
from .passes.shadow_maps import BYTES_PER_TEXEL
from .reach import Receivers, light_casters, lit_places, may_shadow
from .sampling import light_samples
from .scene import Light, LightShape, SceneSnapshot, is_same_light
from .settings import Hardware, Method, PointGeneration, PointStorage, Settings
from .views import MIN_RECEIVER_MARGIN, light_axes

AUTO_METHODS = (Method.MICRO, Method.MVR, Method.IVIR)
"""What `auto` chooses from; the others are there to be compared with these, and were nowhere measured to be faster."""
GPU_AUTO_METHODS = (Method.HYBRID,)
"""and from these on a GPU: three times as fast as any of the others where there are far more triangles than texels"""
POINTS_HANDICAP = 1.25
"""of these: maps that hold points as well take four look-ups where others take one"""
LEAST_BALL_VIEWS = 6
"""Of a point light or spot with a size, unless one is asked for, the centre: places that face away from all of a ball's points would count
as turned away from the light. Of three lamps of .5 m in a room, that was up to .32 of the picture with two or three, .009 with four."""
NO_MAP_REASON = "no map needed: nothing casts a shadow on what is in the picture"

MAX_FITTED_PLACES = 2048
MAX_FACE_ZOOM = 4.0
"""how much finer than the texels of one face of a light those of another may be"""
FITTED_SAMPLES = 16
"""as many find the far ends of a light"""


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
    point_generation: PointGeneration = PointGeneration.COMPUTE
    needs_maps: bool = True
    """False: nothing can cast; surfaces are looked at for which way they face only"""
    is_sealed: bool = False
    """something closes around the light: what is in the picture gets none of it, for which no map is needed"""
    surface_value: float = 1.0
    predicted_ms: float = 0.0
    kept_map_bytes: int = 0
    """of the maps that all batches share (core/methods/kept_map.py)"""

    @property
    def method_text(self) -> str:
        """As plan and statistics name it: the method, where its points are kept, and how they are made if that is not the usual way."""
        by = f"by {self.point_generation.value}" if self.point_generation is not PointGeneration.COMPUTE else ""
        return " ".join(filter(None, [self.method.value, self.points.value if self.points else "", by]))


LikelyFaces = dict[tuple[bool, str, int], tuple[list[cost.LikelyFace], int]]
"""whether it lights reflections, a light's name, map resolution -> as of `_likely_faces`"""

KnownLines = Mapping[tuple[bool, str, str, int], PlannedPass]
"""whether it lights reflections, names of a light and its pass, bytes of the maps made before it that are kept -> what was planned"""


class Steps(NamedTuple):
    """Of a frame, which all of its lights have, whatever they would need on their own."""

    batch_count: int
    round_count: int
    """eye samples that share the views"""


@dataclass(frozen=True)
class LightJob:
    """What is known of a light before all lights' steps are."""

    light: Light
    pass_name: str
    settings: Settings
    view_count: int
    skipped: tuple[str, float] | None
    """as of `_reason_to_skip`"""
    receiver_boxes: np.ndarray
    """(n, 8, 3) world space"""
    places_ws: np.ndarray
    """(n, 3) of `visible_places`"""
    casts: bool = True
    """False: lights what reflectors show, without shadows"""
    sealed_by: str | None = None
    """the object that closes around the light, or keeps it out"""
    is_sealed_out: bool = False
    """it closes around the camera, and the light is outside"""

    @property
    def is_filtered(self) -> bool:
        return self.settings.method is Method.PCSS and self.light.has_size and self.sealed_by is None


def light_job(
    snapshot: SceneSnapshot,
    light: Light,
    pass_name: str,
    settings: Settings,
    bounds: SceneBounds,
    in_picture: np.ndarray,
    places_ws: np.ndarray,
) -> LightJob:
    """in_picture: (instance_count,) bool; places_ws: (n, 3) of `visible_places`. UsageError if the method cannot do this light"""
    receiver_boxes = bounds.corners_ws[in_picture if light.receivers is None else in_picture & light.receivers]
    skipped = _unwanted(light, settings) or _reason_to_skip(snapshot, light, bool(in_picture.any()), receiver_boxes)
    refusal = _what_the_method_cannot_do(light, settings)
    if skipped is None and refusal is not None:
        raise UsageError(refusal)
    view_count = _sample_count(light, settings) if settings.method is not Method.PCSS else 1
    return LightJob(light, pass_name, settings, view_count, skipped, receiver_boxes, places_ws)


def reflected_light_job(snapshot: SceneSnapshot, light: Light, pass_name: str, settings: Settings, bounds: SceneBounds) -> LightJob | None:
    """How a light reaches what reflectors show, which may be anywhere. None when it lights nothing at all."""
    if light.strength == 0 or not math.isfinite(light.strength):
        return None
    # passes may be switched off or left out, light is not
    light, settings = replace(light, is_wanted=True), replace(settings, omni_shadows=True, soft_shadows=True)
    if _what_the_method_cannot_do(light, settings) is not None and light.name not in (settings.light_names or [light.name]):
        settings = replace(settings, method=Method.AUTO)
    everything = np.ones(len(snapshot.instances), bool)
    if light.casts_shadow and len(light_casters(snapshot, light)):
        job = light_job(snapshot, light, pass_name, settings, bounds, everything, bounds.corners_ws.reshape(-1, 3))
        return job if job.skipped is None else None
    nowhere = np.zeros((0, 8, 3))
    return LightJob(light, pass_name, settings, _sample_count(light, settings), None, nowhere, nowhere[:, 0], casts=False)


def _sample_count(light: Light, settings: Settings) -> int:
    asked = _asked_count(light, settings)
    is_ball = light.shape.is_omni and not light.has_soft_falloff
    return LEAST_BALL_VIEWS if is_ball and 1 < asked < LEAST_BALL_VIEWS else asked


def _asked_count(light: Light, settings: Settings) -> int:
    if not light.has_size:
        return 1
    return settings.view_count if light.own_view_count is None else light.own_view_count


def if_sealed(snapshot: SceneSnapshot, job: LightJob, bounds: SceneBounds, shells: Sequence[CameraShell]) -> LightJob:
    """shells: of the camera"""
    if job.skipped is not None:
        return job
    name = sealing_object(snapshot, job.light, bounds)
    if name is not None:
        return replace(job, sealed_by=name)
    name = shell_against(snapshot, job.light, shells)
    return job if name is None else replace(job, sealed_by=name, is_sealed_out=True)


def known_lines(
    lights: Sequence[Light], lights_before: Sequence[Light], passes: Sequence[PlannedPass], reflected_lights: Sequence[PlannedPass]
) -> KnownLines:
    """Of lights that are what they were before. passes, reflected_lights: what was planned for `lights_before` in the same steps,
    of the same surfaces, camera and settings"""
    before = {light.name: light for light in lights_before}
    same = {light.name for light in lights if light.name in before and is_same_light(light, before[light.name])}
    known, kept_bytes = {}, 0
    for is_reflected, index in _making_order([line.light_name for line in passes], [line.light_name for line in reflected_lights]):
        line = reflected_lights[index] if is_reflected else passes[index]
        if line.light_name in same:
            known[is_reflected, line.light_name, line.pass_name, kept_bytes] = line
        kept_bytes += line.kept_map_bytes
    return known


def _making_order(names: Sequence[str], reflected_names: Sequence[str]) -> list[tuple[bool, int]]:
    """Light by light, its maps for the picture before those for what reflectors show: whether it is of the latter, and its index there."""
    indices = {name: index for index, name in enumerate(reflected_names)}
    order: list[tuple[bool, int]] = []
    for index, name in enumerate(names):
        order.append((False, index))
        if name in indices:
            order.append((True, indices.pop(name)))
    return order + [(True, index) for index in indices.values()]


def plan_lights(
    snapshot: SceneSnapshot,
    jobs: Sequence[LightJob],
    reflected_jobs: Sequence[LightJob],
    bounds: SceneBounds,
    steps: Steps,
    known: KnownLines,
    likely_faces: LikelyFaces,
) -> tuple[tuple[PlannedPass, ...], tuple[PlannedPass, ...]]:
    """For the picture, and for what reflectors show. All share the memory for maps that are kept: what does not fit beside those before
    it is made again for every batch."""
    planned: dict[tuple[bool, int], PlannedPass] = {}
    kept_bytes = 0
    for is_reflected, index in _making_order([job.light.name for job in jobs], [job.light.name for job in reflected_jobs]):
        job = reflected_jobs[index] if is_reflected else jobs[index]
        line = known.get((is_reflected, job.light.name, job.pass_name, kept_bytes))
        if line is None:
            line = _plan_light(snapshot, job, bounds, steps, kept_bytes, likely_faces, is_reflected)
        planned[is_reflected, index] = line
        kept_bytes += line.kept_map_bytes
    passes = tuple(planned[False, index] for index in range(len(jobs)))
    return passes, tuple(planned[True, index] for index in range(len(reflected_jobs)))


def _plan_light(
    snapshot: SceneSnapshot,
    job: LightJob,
    bounds: SceneBounds,
    steps: Steps,
    kept_bytes: int,
    likely_faces: LikelyFaces,
    is_reflected: bool,
) -> PlannedPass:
    """kept_bytes: of other lights' maps"""
    light, settings = job.light, job.settings
    if job.skipped is not None:
        reason, surface_value = job.skipped
        return PlannedPass(light.name, job.pass_name, runs=False, reason=reason, surface_value=surface_value)
    if not job.casts:
        return _without_maps(job, "lights reflected surfaces without shadows")
    description = _describe(light) if light.has_size else f"{_describe(light)} without size: one view, a hard shadow"
    if job.view_count > _asked_count(light, settings):
        description += f", {job.view_count} views, as places that face away from fewer points of a ball would be dark"
    round_count = steps.round_count
    taps = round_count * max(settings.blocker_sample_count, settings.filter_sample_count)
    if job.sealed_by is not None:
        job = replace(job, view_count=_sealed_sample_count(light, settings, steps.batch_count))
    sample_count = taps if job.is_filtered else job.view_count
    look_ups_ms = cost.resolve_ms(snapshot, settings, max(sample_count, round_count), round_count)
    if job.sealed_by is not None:
        around = "the camera" if job.is_sealed_out else "it"
        reason = (
            f"{description}; no map needed: {job.sealed_by!r} closes around {around} and lets none of its light into the picture "
            f"(switch off the shadow of {job.sealed_by!r} if it should)"
        )
        return replace(_without_maps(job, reason, look_ups_ms), is_sealed=True)
    if not may_shadow(snapshot, light, bounds, job.receiver_boxes.reshape(-1, 3), sample_count):
        # of one map, its light is looked up by other samples than views
        method = Method.PCSS if job.is_filtered else Method.MVR
        return replace(_without_maps(job, f"{description}; {NO_MAP_REASON}", look_ups_ms), method=method)
    key = is_reflected, light.name, settings.map_resolution_px
    if key not in likely_faces:
        likely_faces[key] = _likely_faces(snapshot, light, bounds, job.places_ws, settings.map_resolution_px)
    faces, face_count = likely_faces[key]
    has_cut_outs = any(snapshot.meshes[index].opacity_map is not None for index in _caster_meshes(snapshot, light))
    map_bytes = len(faces) * BYTES_PER_TEXEL * settings.map_resolution_px**2 * (job.view_count == 1 and not has_cut_outs)
    is_kept = 0 < map_bytes <= (settings.replay_buffer_mib << 20) - kept_bytes
    # where there are fewer views than batches each batch shows one again
    turns = 1 if is_kept else steps.batch_count
    # what a map that is to be kept was made of is let go of
    estimates = cost.estimate_methods(
        snapshot, light, max(job.view_count, turns), settings, bounds, faces, turns, is_replayed=not map_bytes
    )
    method, why = _choose_method(job, estimates, has_cut_outs)
    look_ups_ms = cost.filter_ms(snapshot, settings, round_count) if job.is_filtered else face_count * look_ups_ms
    return PlannedPass(
        light.name,
        job.pass_name,
        runs=True,
        reason=f"{description}; {why}",
        method=method,
        points=settings.points if method.uses_points else None,
        point_generation=settings.point_generation,
        view_count=job.view_count,
        map_resolution_px=settings.map_resolution_px,
        predicted_ms=estimates[method] + look_ups_ms,
        kept_map_bytes=map_bytes * is_kept,
    )


def _without_maps(job: LightJob, reason: str, predicted_ms: float = 0.0) -> PlannedPass:
    return PlannedPass(
        job.light.name,
        job.pass_name,
        runs=True,
        reason=reason,
        view_count=job.view_count,
        map_resolution_px=job.settings.map_resolution_px,
        needs_maps=False,
        predicted_ms=predicted_ms,
    )


def _choose_method(job: LightJob, estimates: Mapping[Method, float], has_cut_outs: bool) -> tuple[Method, str]:
    """And why. estimates: milliseconds; has_cut_outs: of what casts"""
    settings = job.settings
    if settings.method is not Method.AUTO:
        why = f"{settings.method.value} as asked"
        if has_cut_outs and settings.method.shrinks_cut_outs:
            why += ", though cut-outs lose half a texel at their outlines"
        if job.is_filtered:
            why += f": one map, {settings.blocker_sample_count} + {settings.filter_sample_count} samples of it for every eye sample"
        return settings.method, why
    methods = AUTO_METHODS + GPU_AUTO_METHODS * (settings.hardware is Hardware.GPU)
    handicap = {m: POINTS_HANDICAP if m in GPU_AUTO_METHODS else 1.0 for m in methods}
    # what the rasterizer draws into splatted maps loses half a texel at every outline, and lace is nothing but outlines
    method = min((m for m in methods if not (has_cut_outs and m.shrinks_cut_outs)), key=lambda m: estimates[m] * handicap[m])
    other = max(methods, key=lambda m: estimates[m]) if method is Method.MVR else Method.MVR
    note = " (no points, no holes)" * (method is Method.MICRO)
    times = max(estimates[other] / max(estimates[method], 1e-9), 1.0)
    return method, f"{method.value}{note} about {times:.1f} times faster than {other.value} here"


def _sealed_sample_count(light: Light, settings: Settings, batch_count: int) -> int:
    """Whatever the method, samples only weigh the light in the combined pass: as many as there is room for in batches that others call
    for."""
    return min(_sample_count(light, settings), batch_count * most_batch_views(settings.map_resolution_px, settings))


def _what_the_method_cannot_do(light: Light, settings: Settings) -> str | None:
    """With the nearest thing that works."""
    if settings.method is Method.VWSS and not light.shape.is_area:
        return (
            f"vwss warps the view of an area light, and {light.name!r} is a {light.shape.value}: choose the "
            "method ivir, or leave the light out"
        )
    if settings.method is Method.EPR and not light.shape.is_omni:
        return (
            f"epr makes the shadows of lights that shine to all sides, and {light.name!r} is a {light.shape.value}: choose the "
            "method ivir, or leave the light out"
        )
    if settings.method is Method.VIR and light.shape is LightShape.SUN:
        return (
            f"vir samples at the rate of perspective views, and those of the sun {light.name!r} are parallel: choose the method ivir, "
            "or leave the light out"
        )
    return None


def _caster_meshes(snapshot: SceneSnapshot, light: Light) -> np.ndarray:
    """(n,) int32 meshes that may cast this light's shadow."""
    return np.unique(snapshot.instances.mesh_index[light_casters(snapshot, light)])


def _describe(light: Light) -> str:
    if light.shape is LightShape.SUN:
        return f"sun of {2 * math.degrees(math.atan(light.size_x_m / 2)):.3g} degrees" if light.has_size else "sun"
    if light.shape.is_area:
        return f"{light.size_x_m:.3g} x {light.size_y_m:.3g} m {light.shape.value}" if light.has_size else "area light"
    kind = "point light" if light.shape is LightShape.POINT else f"spot of {math.degrees(light.cone_rad):.3g} degrees"
    return f"{kind} of {light.radius_m:.3g} m radius" if light.has_size else kind


def _likely_faces(
    snapshot: SceneSnapshot, light: Light, bounds: SceneBounds, places_ws: np.ndarray, resolution_px: int
) -> tuple[list[cost.LikelyFace], int]:
    """Those that need maps, and how many are looked up: what `fit_light` finds for two views from the light's far ends and some of
    the places where something visible may be, (n, 3) world space."""
    p = places_ws - light.world_from_light[:3, 3]
    lit = places_ws[lit_places(light, p @ light_axes(light).T)]
    some = lit[np.linspace(0, len(lit) - 1, min(len(lit), MAX_FITTED_PLACES)).astype(np.int64)]
    samples_m = light_samples(light, FITTED_SAMPLES)
    far_ends_m = np.stack([samples_m.min(axis=0), samples_m.max(axis=0)])
    fitted, _ = fit_light(snapshot, light, far_ends_m, bounds, Receivers(some, MIN_RECEIVER_MARGIN), resolution_px)
    needed = [face for face in fitted if len(face.caster_indices)]
    tangents = [math.sqrt(math.prod(face.views.texel_tangent)) for face in needed]
    # of a face that next to none of the places are in, the window is hardly known
    finest = max(tangents, default=0.0) / MAX_FACE_ZOOM
    faces = [cost.LikelyFace(face.caster_indices, max(tangent, finest)) for face, tangent in zip(needed, tangents, strict=True)]
    # few places are known of what is seen: there may be shadows between them
    return faces or [cost.LikelyFace(light_casters(snapshot, light), 1 / resolution_px)], max(len(fitted), 1)


def _unwanted(light: Light, settings: Settings) -> tuple[str, float] | None:
    """As `_reason_to_skip`, for what the artist has switched off."""
    if not light.is_wanted:
        return "skipped: switched off for this light", 1.0
    if light.shape.is_omni and not settings.omni_shadows:
        return "skipped: omni shadows are switched off", 1.0
    if not light.shape.is_omni and not settings.soft_shadows:
        return "skipped: soft shadows are switched off", 1.0
    return None


def _reason_to_skip(  # noqa: PLR0911  a list of reasons
    snapshot: SceneSnapshot, light: Light, is_anything_seen: bool, receiver_boxes: np.ndarray
) -> tuple[str, float] | None:
    """The reason and the value of surfaces, or None when the light calls for work. receiver_boxes: (n, 8, 3) world space, of what is in
    the picture"""
    if not light.casts_shadow:
        return "skipped: the light casts no shadow", 1.0
    if light.strength == 0 or not math.isfinite(light.strength):
        return "skipped: the light has no strength", 1.0
    if not is_anything_seen:
        return "skipped: no surface is in the picture", 1.0
    if not len(receiver_boxes):
        return "skipped: light linking leaves it nothing in the picture to light", 1.0
    if not _may_shine_on(light, receiver_boxes):
        return f"skipped: it {'faces away from' if light.shape.is_area else 'does not shine on'} everything in the picture", 0.0
    if not len(light_casters(snapshot, light)):
        return "skipped: nothing casts its shadow", 1.0
    return None


def _may_shine_on(light: Light, corners_ws: np.ndarray) -> bool:
    """Whether any of the boxes, (n, 8, 3), may reach into where the light shines."""
    if light.shape in (LightShape.POINT, LightShape.SUN):
        return True
    corners = (corners_ws - light.world_from_light[:3, 3]) @ light_axes(light).T
    before = (corners[..., 2] > (-light.radius_m if light.shape.is_omni else 0)).any(axis=-1)
    if light.shape.is_area or light.widest_half_cone_rad > math.pi / 2 - 1e-3:
        return bool(before.any())
    # a ball around the box against the round cone around the light's, moved back until it holds both balls
    center, radius_m = corners.mean(axis=1), np.linalg.norm(np.ptp(corners, axis=1), axis=1) / 2 + light.radius_m
    half = light.widest_half_cone_rad
    depth = center[:, 2] + radius_m / math.sin(half)
    return bool((before & (depth >= math.cos(half) * np.hypot(np.hypot(center[:, 0], center[:, 1]), depth))).any())
