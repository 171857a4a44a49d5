"""What the scene calls for, decided before any GPU work: one line per light with its reason."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..device.interface import Device
from . import cost
from .bounds import SceneBounds, compute_bounds
from .enclosure import sealing_object
from .errors import SceneError, UsageError
from .fit import fit_light
from .pass_set import unique_pass_names
from .passes.shadow_maps import BYTES_PER_TEXEL, MAX_BATCH_VIEWS
from .reach import Receivers, light_casters, lit_places, may_shadow
from .reflections.reflectors import PlannedReflections, choose_reflectors
from .reflections.rounds import ReflectionRounds, least_ray_batches, plan_rounds
from .sampling import light_samples
from .scene import Camera, Light, LightShape, SceneSnapshot, has_same_picture, is_same_light
from .settings import Effect, Hardware, Method, PointGeneration, PointStorage, ReflectionFilter, Settings
from .views import MIN_RECEIVER_MARGIN, light_axes

SHARED_MAPS_NOTE = (
    "shadows may differ a little from those made without reflections: lights' maps may reach over what reflectors show as well"
)
MIN_EYE_SAMPLES = 8
MAX_EYE_SAMPLES = 32
MANY_EYE_SAMPLES = 64
"""where MANY_VIEWS are asked for: of what is left of the error most is pixels that outlines cut"""
MANY_VIEWS = 128
MAX_MANY_EYE_SAMPLES_PX = 1 << 20
"""of the picture: G-buffers of a batch take 48 bytes for each pixel and eye sample"""
MAX_BATCH_EYE_SAMPLES = 4

AUTO_METHODS = (Method.MICRO, Method.MVR, Method.IVIR)
"""What `auto` chooses from; the others are there to be compared with these, and were nowhere measured to be faster."""
GPU_AUTO_METHODS = (Method.HYBRID,)
"""and from these on a GPU: three times as fast as any of the others where there are far more triangles than texels"""
POINTS_HANDICAP = 1.25
"""of these: maps that hold points as well take four look-ups where others take one"""
NO_MAP_REASON = "no map needed: nothing casts a shadow on what is in the picture"

MIN_EYE_SAMPLE_VIEWS = 4
"""so many at least are spread over the whole light; two of MANY_EYE_SAMPLES"""

LATTICE_STEPS = 6
"""to a box, or as many as MAX_LATTICE_PLACES leaves it where there are many"""
MAX_LATTICE_BOXES = 1024
MAX_LATTICE_PLACES = 1 << 15
"""what is enough to tell which faces of a cube will be needed"""
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


@dataclass(frozen=True)
class RenderPlan:
    settings: Settings
    bounds: SceneBounds = field(repr=False, compare=False)
    """of the snapshot that was planned"""
    passes: tuple[PlannedPass, ...]
    """shadow passes"""
    batch_count: int
    """steps after which a valid picture exists; each renders its share of every light's views"""
    eye_samples_per_batch: int
    """Each has its share of a batch's views. Where a pixel shows surfaces of unlike irradiance, its ratio is as good as its eye samples."""
    eye_sample_count: int
    """eye G-buffers with sub-pixel offsets that batches take turns with"""
    edge_sample_count: int
    """of these, those that anti-aliasing takes: reflections may have more"""
    most_edge_samples: int
    """as many were asked for; batches may have no room for all of them, or have few views"""
    notes: tuple[str, ...] = ()
    """what the user should know, the snapshot's notes included"""
    predicted_ms: float = 0.0
    reflections: PlannedReflections | None = None
    """None: not asked for"""
    reflected_lights: tuple[PlannedPass, ...] = ()
    """what lights surfaces that are seen in reflectors, shadows of all of the scene included; none where nothing reflects"""

    @property
    def is_combined(self) -> bool:
        """Whether lights lie beside each other in the combined pass, so that it counts how much each delivers."""
        return sum(planned.runs for planned in self.passes) > 1

    def has_same_steps(self, other: RenderPlan) -> bool:
        """Whether passes of both are made in the same batches, and with the same settings."""
        own, others = (
            (each.settings, each.batch_count, each.eye_samples_per_batch, each.eye_sample_count, each.edge_sample_count)
            for each in (self, other)
        )
        return own == others


LikelyFaces = dict[tuple[bool, str, int], tuple[list[cost.LikelyFace], int]]
"""whether it lights reflections, a light's name, map resolution -> as of `_likely_faces`"""


@dataclass
class PlannedOnce:
    """What plans of one snapshot share that differ in nothing but views and map resolution; the first that needs it fills it."""

    likely_faces: LikelyFaces = field(default_factory=dict)
    reflections: PlannedReflections | None = None
    """with the bounces that are asked for, which memory for rounds may lessen"""


def plan(
    snapshot: SceneSnapshot,
    settings: Settings,
    before: tuple[SceneSnapshot, RenderPlan] | None = None,
    once: PlannedOnce | None = None,
) -> RenderPlan:
    """Decide per light. before: what was planned, and how; the answer is the same without, and takes longer where little has changed.
    once: shared by plans of one snapshot that differ in nothing but views and map resolution, so that each light's faces are fitted and
    reflectors chosen once.

    Raises UsageError for lights that the scene does not have, SceneError when the scene has no light that can be rendered.
    """
    once = PlannedOnce() if once is None else once
    lights = _chosen_lights(snapshot, settings)
    names = unique_pass_names([light.name for light in snapshot.lights])
    if before is not None and (before[1].settings != settings or not has_same_picture(snapshot, before[0])):
        before = None
    bounds = compute_bounds(snapshot) if before is None else before[1].bounds
    in_picture = instances_in_picture(snapshot, bounds)
    jobs: list[_LightJob] = []
    if Effect.SHADOW in settings.effects:
        places_ws = _visible_places(snapshot.camera, bounds.corners_ws[in_picture])
        jobs = [_light_job(snapshot, light, names[light.name], settings, bounds, in_picture, places_ws) for light in lights]
        # as seen in the picture: what reflectors show may be within what the camera sees from outside
        jobs = [_if_sealed(snapshot, job, bounds) for job in jobs]
    reflections: PlannedReflections | None = None
    reflected_jobs: list[_LightJob] = []
    if Effect.REFLECTION in settings.effects:
        if once.reflections is None:
            once.reflections = _plan_reflections(snapshot, settings, bounds, in_picture)
        reflections = once.reflections
        if reflections.runs:
            wanted = (_reflected_light_job(snapshot, light, names[light.name], settings, bounds) for light in snapshot.lights)
            reflected_jobs = [job for job in wanted if job is not None]
    running = [job for job in [*jobs, *reflected_jobs] if job.skipped is None]
    # a light that needs no map takes the steps of those that do
    view_counts = [job.view_count for job in [job for job in running if job.sealed_by is None] or running]
    needs_rounds = reflections is not None and reflections.runs
    has_passes = any(job.skipped is None for job in jobs)
    most_views = max(view_counts, default=0)
    only_reflects = _only_reflects(has_passes, reflections)
    # reflections trace rays for each
    most_edge_samples = MAX_EYE_SAMPLES if needs_rounds else _most_eye_samples(snapshot, most_views, settings)
    batch_count = 1
    if most_views:
        batch_count = _light_batch_count(most_views, settings.map_resolution_px, settings, only_reflects, most_edge_samples)

    def eye_samples_of(batch_count: int) -> int:
        return 1 if only_reflects else _eye_samples_per_batch(most_views, batch_count, settings, most_edge_samples)

    notes = list(snapshot.notes)
    rounds: ReflectionRounds | None = None
    if reflections is not None and reflections.runs:
        rounds = plan_rounds(snapshot, settings, reflections.bounces, batch_count, view_counts, eye_samples_of)
        reflections, batch_count = replace(reflections, bounces=rounds.bounces), rounds.batch_count
        notes += [rounds.note] if rounds.note else []
        notes += [SHARED_MAPS_NOTE] if has_passes else []
    eye_samples_per_batch = eye_samples_of(batch_count) if rounds is None else rounds.rounds_per_batch
    most_eye_samples = max(most_edge_samples, settings.reflection_sample_count * needs_rounds)
    if only_reflects and settings.reflection_filter is not ReflectionFilter.EYE:
        most_eye_samples = 1
    eye_sample_count = min(batch_count * eye_samples_per_batch, most_eye_samples)
    steps = _Steps(batch_count, batch_count * eye_samples_per_batch)
    known = _known_lines(snapshot, steps, before)
    passes, reflected_lights = _plan_lights(snapshot, jobs, reflected_jobs, bounds, steps, known, once.likely_faces)
    # as if each light had two sets of maps: whether one serves both is known when surfaces are
    lights_ms = sum(planned.predicted_ms for planned in [*passes, *reflected_lights])
    eye_ms = cost.eye_ms(snapshot, settings, eye_sample_count)
    reflections_ms = reflections.predicted_ms if reflections is not None else 0.0
    return RenderPlan(
        settings=settings,
        bounds=bounds,
        passes=passes,
        batch_count=batch_count,
        eye_samples_per_batch=eye_samples_per_batch,
        eye_sample_count=eye_sample_count,
        edge_sample_count=min(eye_sample_count, most_edge_samples),
        most_edge_samples=most_edge_samples,
        notes=tuple(notes),
        predicted_ms=lights_ms + eye_ms + reflections_ms,
        reflections=reflections,
        reflected_lights=reflected_lights,
    )


def _plan_reflections(snapshot: SceneSnapshot, settings: Settings, bounds: SceneBounds, in_picture: np.ndarray) -> PlannedReflections:
    planned = choose_reflectors(snapshot, bounds, settings, in_picture)
    predicted_ms = cost.reflections_ms(snapshot, settings, planned, settings.reflection_sample_count) if planned.runs else 0.0
    return replace(planned, predicted_ms=predicted_ms)


def _reflected_light_job(
    snapshot: SceneSnapshot, light: Light, pass_name: str, settings: Settings, bounds: SceneBounds
) -> _LightJob | None:
    """How a light reaches what reflectors show, which may be anywhere. None when it lights nothing at all."""
    if light.strength == 0 or not math.isfinite(light.strength):
        return None
    # passes may be switched off or left out, light is not
    light, settings = replace(light, is_wanted=True), replace(settings, omni_shadows=True, soft_shadows=True)
    if _what_the_method_cannot_do(light, settings) is not None and light.name not in (settings.light_names or [light.name]):
        settings = replace(settings, method=Method.AUTO)
    everything = np.ones(len(snapshot.instances), bool)
    if light.casts_shadow and len(light_casters(snapshot, light)):
        job = _light_job(snapshot, light, pass_name, settings, bounds, everything, bounds.corners_ws.reshape(-1, 3))
        return job if job.skipped is None else None
    nowhere = np.zeros((0, 8, 3))
    return _LightJob(light, pass_name, settings, _sample_count(light, settings), None, nowhere, nowhere[:, 0], casts=False)


def settings_for(device: Device, settings: Settings) -> Settings:
    """The same settings, predicting for what this device is: plans made with them choose what is quickest there."""
    return replace(settings, hardware=Hardware.SOFTWARE if device.is_software else Hardware.GPU)


def check_device(render_plan: RenderPlan, device: Device) -> None:
    """UsageError when the device lacks what a planned method needs; to be asked before any work is done."""
    running = [*(planned for planned in render_plan.passes if planned.runs), *render_plan.reflected_lights]
    if not device.stores_from_fragments and any(planned.method is Method.VWSS for planned in running):
        raise UsageError(
            f"vwss stores what the rasterizer makes, which the device {device.name} cannot: choose the device moderngl, or the method ivir"
        )
    if not device.stores_from_geometry and any(planned.point_generation is PointGeneration.RASTERIZER for planned in running):
        raise UsageError(
            f"points by the rasterizer need geometry shaders that store, and the device {device.name} has none: "
            "choose the device moderngl, or the point generation compute"
        )
    most_views = max((planned.view_count for planned in running), default=0)
    mapped_views = max((planned.view_count for planned in running if planned.needs_maps), default=0)
    resolution_px, limit_px = render_plan.settings.map_resolution_px, device.max_texture_size_px
    height_px = resolution_px * math.ceil(mapped_views / render_plan.batch_count)
    if height_px > limit_px:
        # smaller maps come in larger batches
        reflects = render_plan.reflections is not None and render_plan.reflections.runs
        only_reflects = _only_reflects(any(planned.runs for planned in render_plan.passes), render_plan.reflections)

        def batches_of(px: int) -> int:
            count = _light_batch_count(most_views, px, render_plan.settings, only_reflects, render_plan.most_edge_samples)
            return least_ray_batches(render_plan.settings.reflection_sample_count, count) if reflects else count

        fitting_px = next(px for px in range(resolution_px, 0, -1) if px * math.ceil(mapped_views / batches_of(px)) <= limit_px)
        raise UsageError(
            f"a batch of maps of {resolution_px} px is {height_px} px high, and the device's largest texture {limit_px} px: "
            f"choose a map resolution of {fitting_px} or less"
        )


def _only_reflects(has_passes: bool, reflections: PlannedReflections | None) -> bool:
    """Whether maps are made for what reflectors show alone."""
    return reflections is not None and reflections.runs and not has_passes


def _most_eye_samples(snapshot: SceneSnapshot, most_views: int, settings: Settings) -> int:
    asked = _views_asked_for(settings) if most_views == 1 else most_views
    is_small = snapshot.width_px * snapshot.height_px <= MAX_MANY_EYE_SAMPLES_PX
    return MANY_EYE_SAMPLES if asked >= MANY_VIEWS and is_small else MAX_EYE_SAMPLES


def _views_asked_for(settings: Settings) -> int:
    """For hard shadows, which have one view, but as many eye samples as if there were all of these. To `pcss` they mean nothing."""
    return settings.view_count if settings.method is not Method.PCSS else 0


def _eye_samples_per_batch(most_views: int, batch_count: int, settings: Settings, most_eye_samples: int) -> int:
    """The view of hard shadows is one that every eye sample sees."""
    views = math.ceil(most_views / batch_count)
    if most_views == 1:
        views = max(MAX_BATCH_VIEWS, _views_asked_for(settings) // batch_count)
    least_views = MIN_EYE_SAMPLE_VIEWS * MAX_EYE_SAMPLES // most_eye_samples
    return max(min(math.ceil(most_eye_samples / batch_count), views // least_views, MAX_BATCH_EYE_SAMPLES), 1)


def _most_batch_views(map_resolution_px: int, settings: Settings) -> int:
    """Eight maps of 1024^2 and 2048^2 a batch; larger maps in smaller batches, so that a batch stays below 128 MiB of depth."""
    return max(1, min(MAX_BATCH_VIEWS, settings.batch_view_count, MAX_BATCH_VIEWS * 2048**2 // map_resolution_px**2))


def _least_batch_count(most_views: int, map_resolution_px: int, settings: Settings) -> int:
    return math.ceil(most_views / _most_batch_views(map_resolution_px, settings))


def _light_batch_count(most_views: int, map_resolution_px: int, settings: Settings, only_reflects: bool, most_eye_samples: int) -> int:
    """What reflectors show is looked up by as many eye samples as rays are asked for."""
    if only_reflects:
        return _least_batch_count(most_views, map_resolution_px, settings)
    return _batch_count(most_views, map_resolution_px, settings, most_eye_samples)


def _batch_count(most_views: int, map_resolution_px: int, settings: Settings, most_eye_samples: int) -> int:
    """Where so few batches have too few eye samples, more and smaller ones. All eye samples of hard shadows could come in one, which takes
    memory for each: they come in several, too."""
    batch_count = _least_batch_count(most_views, map_resolution_px, settings)
    eye_samples = batch_count * _eye_samples_per_batch(most_views, batch_count, settings, most_eye_samples)
    has_enough = most_views > 1 and eye_samples >= MIN_EYE_SAMPLES
    return batch_count if has_enough else max(MIN_EYE_SAMPLES, most_eye_samples // MAX_BATCH_EYE_SAMPLES)


def _chosen_lights(snapshot: SceneSnapshot, settings: Settings) -> list[Light]:
    known = {light.name: light for light in snapshot.lights}
    if settings.light_names is not None:
        missing = [name for name in settings.light_names if name not in known]
        if missing:
            raise UsageError(f"no light named {', '.join(map(repr, missing))}; the scene has {', '.join(map(repr, known)) or 'none'}")
        lights = [light for light in snapshot.lights if light.name in settings.light_names]
    else:
        lights = list(snapshot.lights)
    if not lights and Effect.SHADOW in settings.effects:
        left_out = "".join(f"; {item.object_name} is left out: {item.reason}" for item in snapshot.left_out if item.is_light)
        raise SceneError(f"scene {snapshot.scene_name!r} has no light that is rendered; add a light or enable one for rendering{left_out}")
    return lights


class _Steps(NamedTuple):
    """Of a frame, which all of its lights have, whatever they would need on their own."""

    batch_count: int
    round_count: int
    """eye samples that share the views"""

    @classmethod
    def of(cls, render_plan: RenderPlan) -> _Steps:
        return cls(render_plan.batch_count, render_plan.batch_count * render_plan.eye_samples_per_batch)


@dataclass(frozen=True)
class _LightJob:
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
    """(n, 3) of `_visible_places`"""
    casts: bool = True
    """False: lights what reflectors show, without shadows"""
    sealed_by: str | None = None
    """the object that closes around the light"""

    @property
    def is_filtered(self) -> bool:
        return self.settings.method is Method.PCSS and self.light.has_size and self.sealed_by is None


def _light_job(
    snapshot: SceneSnapshot,
    light: Light,
    pass_name: str,
    settings: Settings,
    bounds: SceneBounds,
    in_picture: np.ndarray,
    places_ws: np.ndarray,
) -> _LightJob:
    """in_picture: (instance_count,) bool; places_ws: (n, 3) of `_visible_places`. UsageError if the method cannot do this light"""
    receiver_boxes = bounds.corners_ws[in_picture if light.receivers is None else in_picture & light.receivers]
    skipped = _unwanted(light, settings) or _reason_to_skip(snapshot, light, bool(in_picture.any()), receiver_boxes)
    refusal = _what_the_method_cannot_do(light, settings)
    if skipped is None and refusal is not None:
        raise UsageError(refusal)
    view_count = _sample_count(light, settings) if settings.method is not Method.PCSS else 1
    return _LightJob(light, pass_name, settings, view_count, skipped, receiver_boxes, places_ws)


def _sample_count(light: Light, settings: Settings) -> int:
    if not light.has_size:
        return 1
    return settings.view_count if light.own_view_count is None else light.own_view_count


def _if_sealed(snapshot: SceneSnapshot, job: _LightJob, bounds: SceneBounds) -> _LightJob:
    return replace(job, sealed_by=sealing_object(snapshot, job.light, bounds)) if job.skipped is None else job


def _sealed_sample_count(light: Light, settings: Settings, batch_count: int) -> int:
    """Whatever the method, samples only weigh the light in the combined pass: as many as there is room for in batches that others call
    for."""
    return min(_sample_count(light, settings), batch_count * _most_batch_views(settings.map_resolution_px, settings))


_KnownLines = Mapping[tuple[bool, str, str, int], PlannedPass]
"""whether it lights reflections, names of a light and its pass, bytes of the maps made before it that are kept -> what was planned"""


def _known_lines(snapshot: SceneSnapshot, steps: _Steps, before: tuple[SceneSnapshot, RenderPlan] | None) -> _KnownLines:
    """Of lights that are what they were before. before: as of `plan`, of the same surfaces, camera and settings"""
    if before is None or steps != _Steps.of(before[1]):
        return {}
    lights = {light.name: light for light in before[0].lights}
    same = {light.name for light in snapshot.lights if light.name in lights and is_same_light(light, lights[light.name])}
    passes, reflected_lights = before[1].passes, before[1].reflected_lights
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


def _plan_lights(
    snapshot: SceneSnapshot,
    jobs: Sequence[_LightJob],
    reflected_jobs: Sequence[_LightJob],
    bounds: SceneBounds,
    steps: _Steps,
    known: _KnownLines,
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
    job: _LightJob,
    bounds: SceneBounds,
    steps: _Steps,
    kept_bytes: int,
    likely_faces: LikelyFaces,
    is_reflected: bool,
) -> PlannedPass:
    """kept_bytes: of other lights' maps"""
    light, pass_name, settings, view_count = job.light, job.pass_name, job.settings, job.view_count
    if job.skipped is not None:
        reason, surface_value = job.skipped
        return PlannedPass(light.name, pass_name, runs=False, reason=reason, surface_value=surface_value)
    if not job.casts:
        return PlannedPass(
            light.name,
            pass_name,
            runs=True,
            reason="lights reflected surfaces without shadows",
            view_count=view_count,
            map_resolution_px=settings.map_resolution_px,
            needs_maps=False,
        )
    is_filtered, (batch_count, round_count) = job.is_filtered, steps
    if job.sealed_by is not None:
        view_count = _sealed_sample_count(light, settings, batch_count)
    taps = round_count * max(settings.blocker_sample_count, settings.filter_sample_count)
    sample_count = taps if is_filtered else view_count
    look_ups_ms = cost.resolve_ms(snapshot, settings, max(sample_count, round_count), round_count)
    reason = _describe(light) if light.has_size else f"{_describe(light)} without size: one view, a hard shadow"
    if job.sealed_by is not None:
        return PlannedPass(
            light.name,
            pass_name,
            runs=True,
            reason=(
                f"{reason}; no map needed: {job.sealed_by!r} closes around it and lets none of its light into the picture "
                f"(switch off the shadow of {job.sealed_by!r} if it should)"
            ),
            view_count=view_count,
            map_resolution_px=settings.map_resolution_px,
            needs_maps=False,
            is_sealed=True,
            predicted_ms=look_ups_ms,
        )
    if not may_shadow(snapshot, light, bounds, job.receiver_boxes.reshape(-1, 3), sample_count):
        return PlannedPass(
            light.name,
            pass_name,
            runs=True,
            reason=f"{reason}; {NO_MAP_REASON}",
            view_count=view_count,
            map_resolution_px=settings.map_resolution_px,
            needs_maps=False,
            # its light is looked up by other samples than views
            method=Method.PCSS if is_filtered else Method.MVR,
            predicted_ms=look_ups_ms,
        )
    key = is_reflected, light.name, settings.map_resolution_px
    if key not in likely_faces:
        likely_faces[key] = _likely_faces(snapshot, light, bounds, job.places_ws, settings.map_resolution_px)
    faces, face_count = likely_faces[key]
    has_cut_outs = any(snapshot.meshes[index].opacity_map is not None for index in _caster_meshes(snapshot, light))
    map_bytes = len(faces) * BYTES_PER_TEXEL * settings.map_resolution_px**2 * (view_count == 1 and not has_cut_outs)
    is_kept = 0 < map_bytes <= (settings.replay_buffer_mib << 20) - kept_bytes
    # where there are fewer views than batches each batch shows one again
    turns = 1 if is_kept else batch_count
    # what a map that is to be kept was made of is let go of
    estimates = cost.estimate_methods(snapshot, light, max(view_count, turns), settings, bounds, faces, turns, is_replayed=not map_bytes)
    look_ups_ms = cost.filter_ms(snapshot, settings, round_count) if is_filtered else face_count * look_ups_ms
    if settings.method is Method.AUTO:
        # what the rasterizer draws into splatted maps loses half a texel at every outline, and lace is nothing but outlines
        methods = AUTO_METHODS + GPU_AUTO_METHODS * (settings.hardware is Hardware.GPU)
        handicap = {m: POINTS_HANDICAP if m in GPU_AUTO_METHODS else 1.0 for m in methods}
        method = min((m for m in methods if not (has_cut_outs and m.shrinks_cut_outs)), key=lambda m: estimates[m] * handicap[m])
        other = max(methods, key=lambda m: estimates[m]) if method is Method.MVR else Method.MVR
        note = " (no points, no holes)" * (method is Method.MICRO)
        times = max(estimates[other] / max(estimates[method], 1e-9), 1.0)
        reason += f"; {method.value}{note} about {times:.1f} times faster than {other.value} here"
    else:
        method = settings.method
        reason += f"; {method.value} as asked"
        if has_cut_outs and method.shrinks_cut_outs:
            reason += ", though cut-outs lose half a texel at their outlines"
        if is_filtered:
            reason += f": one map, {settings.blocker_sample_count} + {settings.filter_sample_count} samples of it for every eye sample"
    return PlannedPass(
        light.name,
        pass_name,
        runs=True,
        reason=reason,
        method=method,
        points=settings.points if method.uses_points else None,
        point_generation=settings.point_generation,
        view_count=view_count,
        map_resolution_px=settings.map_resolution_px,
        predicted_ms=estimates[method] + look_ups_ms,
        kept_map_bytes=map_bytes * is_kept,
    )


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


def _visible_places(camera: Camera, boxes: np.ndarray) -> np.ndarray:
    """(n, 3) places in boxes, (m, 8, 3) world space, on a coarse lattice, as far as they are in the camera's view."""
    largest = np.argsort(-np.ptp(boxes, axis=1).max(axis=1), kind="stable")
    boxes = boxes[largest[:MAX_LATTICE_BOXES]]
    steps = min(max(int((MAX_LATTICE_PLACES / max(len(boxes), 1)) ** (1 / 3)), 2), LATTICE_STEPS)
    u = np.linspace(0, 1, steps)
    lattice = np.stack(np.meshgrid(u, u, u, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    # corner i of a box lies at bit k of i along axis k (core/bounds.py)
    edges = boxes[:, [1, 2, 4]] - boxes[:, :1]
    places = (boxes[:, :1] + lattice[:, 0] @ edges).reshape(-1, 1, 3)
    return places[_may_be_in_picture(camera, places), 0]


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


def instances_in_picture(snapshot: SceneSnapshot, bounds: SceneBounds) -> np.ndarray:
    """(instance_count,) bool: what the camera may see"""
    return snapshot.instances.visible_to_camera & _may_be_in_picture(snapshot.camera, bounds.corners_ws)


def _may_be_in_picture(camera: Camera, corners_ws: np.ndarray) -> np.ndarray:
    """(instance_count,) bool: boxes that are not wholly outside one side of the camera's view."""
    view_from_world = np.linalg.inv(camera.world_from_view)
    p = corners_ws @ view_from_world[:3, :3].T + view_from_world[:3, 3]
    # mirrored cameras have them the other way round
    (left, right), (bottom, top) = sorted(camera.window[:2]), sorted(camera.window[2:])
    depth = -p[..., 2]
    scale = np.ones_like(depth) if camera.is_orthographic else depth
    y = p[..., 1] - camera.skew * p[..., 0]
    sides = [
        depth - camera.clip_start_m,
        camera.clip_end_m - depth,
        p[..., 0] - left * scale,
        right * scale - p[..., 0],
        y - bottom * scale,
        top * scale - y,
    ]
    return np.logical_and.reduce([(side >= 0).any(axis=-1) for side in sides])
