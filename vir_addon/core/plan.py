"""What the scene calls for, decided before any GPU work: one line per light with its reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..device.interface import Device
from . import cost
from .batches import MAX_EYE_SAMPLES, eye_samples_of_batch, light_batch_count, most_eye_samples_for
from .bounds import SceneBounds, compute_bounds
from .enclosure import CameraShell, camera_shells
from .errors import SceneError, UsageError
from .frustum import instances_in_picture, visible_places
from .light_plan import (
    KnownLines,
    LightJob,
    LikelyFaces,
    PlannedPass,
    Steps,
    if_sealed,
    known_lines,
    light_job,
    plan_lights,
    reflected_light_job,
)
from .material import BLACK
from .pass_set import unique_pass_names
from .passes.eye import least_visibility_size
from .reflections.reflectors import PlannedReflections, choose_reflectors
from .reflections.rounds import least_ray_batches, plan_rounds, wanted_rounds
from .sampling import pixel_offsets
from .scene import Light, SceneSnapshot, has_same_picture
from .settings import Effect, Hardware, Method, PointGeneration, ReflectionFilter, Settings

NO_LIGHT_NOTE = "no light is rendered in this frame and view layer: shadows are white"
SHARED_MAPS_NOTE = (
    "shadows may differ a little from those made without reflections: lights' maps may reach over what reflectors show as well"
)


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
    picture_px: tuple[int, int]
    """width and height"""
    visibility_px: tuple[int, int]
    """of the largest texture that the picture calls for (`least_visibility_size`)"""
    notes: tuple[str, ...] = ()
    """what the user should know, the snapshot's notes included"""
    predicted_ms: float = 0.0
    reflections: PlannedReflections | None = None
    """None: not asked for"""
    reflected_lights: tuple[PlannedPass, ...] = ()
    """what lights surfaces that are seen in reflectors, shadows of all of the scene included; none where nothing reflects"""
    has_surroundings: bool = True
    """Something but lights lights what reflectors show, if any are asked for: surfaces that shine, or the world, unless something closes
    around the camera."""

    @property
    def needs_eye(self) -> bool:
        """Whether anything depends on what pixels see: constant passes of value 1 are the same on surfaces and background."""
        reflects = self.reflections is not None and self.reflections.runs
        return reflects or any(planned.runs or planned.surface_value != 1 for planned in self.passes)

    @property
    def is_combined(self) -> bool:
        """Whether lights lie beside each other in the combined pass, so that it counts how much each delivers."""
        return sum(planned.runs for planned in self.passes) > 1

    @property
    def steps(self) -> Steps:
        return Steps(self.batch_count, self.batch_count * self.eye_samples_per_batch)

    def has_same_steps(self, other: RenderPlan) -> bool:
        """Whether passes of both are made in the same batches, and with the same settings."""
        own, others = (
            (each.settings, each.batch_count, each.eye_samples_per_batch, each.eye_sample_count, each.edge_sample_count)
            for each in (self, other)
        )
        return own == others


@dataclass
class PlannedOnce:
    """What plans of one snapshot share that differ in nothing but views and map resolution; the first that needs it fills it."""

    likely_faces: LikelyFaces = field(default_factory=dict)
    reflections: PlannedReflections | None = None
    """with the bounces that are asked for, which memory for rounds may lessen"""
    shells: list[CameraShell] | None = None
    """around the camera, where something asks for them"""


def plan(
    snapshot: SceneSnapshot,
    settings: Settings,
    before: tuple[SceneSnapshot, RenderPlan] | None = None,
    once: PlannedOnce | None = None,
) -> RenderPlan:
    """Decide per light. before: what was planned, and how; the answer is the same without, and takes longer where little has changed.
    once: shared by plans of one snapshot that differ in nothing but views and map resolution, so that each light's faces are fitted,
    reflectors chosen and what closes around the camera looked for once.

    Raises UsageError for lights that the scene does not have, SceneError when the scene has no light that can be rendered, and
    none elsewhere.
    """
    once = PlannedOnce() if once is None else once
    lights, absent = _chosen_lights(snapshot, settings)
    # a light keeps its pass's name in frames that lack another
    names = unique_pass_names([*(light.name for light in snapshot.lights), *snapshot.lights_elsewhere])
    if before is not None and (before[1].settings != settings or not has_same_picture(snapshot, before[0])):
        before = None
    bounds = compute_bounds(snapshot) if before is None else before[1].bounds
    in_picture = instances_in_picture(snapshot, bounds)
    is_reflecting = Effect.REFLECTION in settings.effects
    jobs: list[LightJob] = []
    if Effect.SHADOW in settings.effects:
        places_ws = visible_places(snapshot.camera, bounds.corners_ws[in_picture])
        jobs = [light_job(snapshot, light, names[light.name], settings, bounds, in_picture, places_ws) for light in lights]
    if once.shells is None:
        once.shells = camera_shells(snapshot, bounds) if is_reflecting or any(job.skipped is None for job in jobs) else []
    # as seen in the picture: what reflectors show may be within what the camera sees from outside
    jobs = [if_sealed(snapshot, job, bounds, once.shells) for job in jobs]
    has_surroundings = is_reflecting and _has_surroundings(snapshot, once.shells)
    reflections: PlannedReflections | None = None
    reflected_jobs: list[LightJob] = []
    if is_reflecting:
        if once.reflections is None:
            once.reflections = _plan_reflections(snapshot, settings, bounds, in_picture, has_surroundings)
        reflections = once.reflections
        if reflections.runs:
            wanted = (reflected_light_job(snapshot, light, names[light.name], settings, bounds) for light in snapshot.lights)
            reflected_jobs = [job for job in wanted if job is not None]
    notes = list(snapshot.notes)
    notes += [NO_LIGHT_NOTE] if Effect.SHADOW in settings.effects and not lights else []
    notes += [f"{name!r} is not rendered in this frame and view layer: its pass is white" for name in absent]
    steps = _plan_steps(snapshot, settings, jobs, reflected_jobs, reflections)
    batches = Steps(steps.batch_count, steps.batch_count * steps.eye_samples_per_batch)
    known: KnownLines = {}
    if before is not None and batches == before[1].steps:
        known = known_lines(snapshot.lights, before[0].lights, before[1].passes, before[1].reflected_lights)
    passes, reflected_lights = plan_lights(snapshot, jobs, reflected_jobs, bounds, batches, known, once.likely_faces)
    passes = tuple(sorted([*passes, *(_absent_pass(name, names[name]) for name in absent)], key=lambda planned: planned.light_name))
    # as if each light had two sets of maps: whether one serves both is known when surfaces are
    lights_ms = sum(planned.predicted_ms for planned in [*passes, *reflected_lights])
    predicted_ms = lights_ms + cost.eye_ms(snapshot, settings, steps.eye_sample_count)
    picture_px = snapshot.width_px, snapshot.height_px
    if reflections is not None:
        reflections = replace(reflections, bounces=steps.bounces)
        predicted_ms += reflections.predicted_ms
    return RenderPlan(
        settings=settings,
        bounds=bounds,
        passes=passes,
        batch_count=steps.batch_count,
        eye_samples_per_batch=steps.eye_samples_per_batch,
        eye_sample_count=steps.eye_sample_count,
        edge_sample_count=min(steps.eye_sample_count, steps.most_edge_samples),
        most_edge_samples=steps.most_edge_samples,
        picture_px=picture_px,
        visibility_px=least_visibility_size(picture_px, pixel_offsets(snapshot.pixel_filter, steps.eye_sample_count)),
        notes=(*notes, *steps.notes),
        predicted_ms=predicted_ms,
        reflections=reflections,
        reflected_lights=reflected_lights,
        has_surroundings=has_surroundings,
    )


class _FrameSteps(NamedTuple):
    batch_count: int
    eye_samples_per_batch: int
    eye_sample_count: int
    most_edge_samples: int
    bounces: int
    """of reflections"""
    notes: tuple[str, ...]


def _plan_steps(
    snapshot: SceneSnapshot,
    settings: Settings,
    jobs: list[LightJob],
    reflected_jobs: list[LightJob],
    reflections: PlannedReflections | None,
) -> _FrameSteps:
    """In how many batches a frame comes, and with how many eye samples each: as the light of most views calls for, and reflections' rays.

    jobs: of the shadow passes; reflected_jobs: of lights in what reflectors show
    """
    running = [job for job in [*jobs, *reflected_jobs] if job.skipped is None]
    # a light that needs no map takes the steps of those that do
    view_counts = [job.view_count for job in [job for job in running if job.sealed_by is None] or running]
    most_views = max(view_counts, default=0)
    has_passes = any(job.skipped is None for job in jobs)
    only_reflects = _only_reflects(has_passes, reflections)
    reflects = reflections is not None and reflections.runs
    # reflections trace rays for each
    most_edge_samples = MAX_EYE_SAMPLES if reflects else most_eye_samples_for(snapshot, most_views, settings)
    batch_count = 1
    if most_views:
        batch_count = light_batch_count(most_views, settings.map_resolution_px, settings, only_reflects, most_edge_samples)

    def eye_samples_of(batch_count: int) -> int:
        return 1 if only_reflects else eye_samples_of_batch(most_views, batch_count, settings, most_edge_samples)

    bounces = 0 if reflections is None else reflections.bounces
    notes: tuple[str, ...] = ()
    if reflects:
        rounds = plan_rounds(snapshot, settings, bounces, batch_count, view_counts, eye_samples_of)
        batch_count, eye_samples_per_batch, bounces = rounds.batch_count, rounds.rounds_per_batch, rounds.bounces
        notes = (*([rounds.note] if rounds.note else []), *[SHARED_MAPS_NOTE] * has_passes)
    else:
        eye_samples_per_batch = eye_samples_of(batch_count)
    most_eye_samples = max(most_edge_samples, settings.reflection_sample_count * reflects)
    if only_reflects and settings.reflection_filter is not ReflectionFilter.EYE:
        most_eye_samples = 1
    eye_sample_count = min(batch_count * eye_samples_per_batch, most_eye_samples)
    return _FrameSteps(batch_count, eye_samples_per_batch, eye_sample_count, most_edge_samples, bounces, notes)


def _plan_reflections(
    snapshot: SceneSnapshot, settings: Settings, bounds: SceneBounds, in_picture: np.ndarray, has_surroundings: bool
) -> PlannedReflections:
    planned = choose_reflectors(snapshot, bounds, settings, in_picture)
    predicted_ms = 0.0
    if planned.runs:
        predicted_ms = cost.reflections_ms(snapshot, settings, planned, settings.reflection_sample_count, has_surroundings)
    return replace(planned, predicted_ms=predicted_ms)


def _has_surroundings(snapshot: SceneSnapshot, shells: Sequence[CameraShell]) -> bool:
    """shells: of the camera, beyond which no ray looks"""
    if any(material.emission != BLACK for material in snapshot.materials):
        return True
    visible = snapshot.instances.visible_in_reflections
    is_closed = any(visible is None or visible[shell.instance] for shell in shells)
    return snapshot.world is not None and max(snapshot.world.radiance) > 0 and not is_closed


def settings_for(device: Device, settings: Settings) -> Settings:
    """The same settings, predicting for what this device is: plans made with them choose what is quickest there."""
    return replace(settings, hardware=Hardware.SOFTWARE if device.is_software else Hardware.GPU)


def check_device(render_plan: RenderPlan, device: Device) -> None:
    """UsageError when the device lacks what a planned method or the picture's size needs; to be asked before any work is done."""
    _check_picture_size(render_plan, device)
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
            count = light_batch_count(most_views, px, render_plan.settings, only_reflects, render_plan.most_edge_samples)
            return least_ray_batches(wanted_rounds(render_plan.settings), count) if reflects else count

        fitting_px = next(px for px in range(resolution_px, 0, -1) if px * math.ceil(mapped_views / batches_of(px)) <= limit_px)
        raise UsageError(
            f"a batch of maps of {resolution_px} px is {height_px} px high, and the device's largest texture {limit_px} px: "
            f"choose a map resolution of {fitting_px} or less"
        )


def _check_picture_size(render_plan: RenderPlan, device: Device) -> None:
    limit_px = device.max_texture_size_px
    if not render_plan.needs_eye or max(render_plan.visibility_px) <= limit_px:
        return
    width_px, height_px = render_plan.picture_px
    margin_px = max(render_plan.visibility_px) - max(width_px, height_px)
    raise UsageError(
        f"the picture is {width_px} x {height_px} px, and the device can do {limit_px - margin_px} px in width and height, its largest "
        "texture less the pixel filter's margins: choose a lower resolution, or render parts with a render region that crops"
    )


def _only_reflects(has_passes: bool, reflections: PlannedReflections | None) -> bool:
    """Whether maps are made for what reflectors show alone."""
    return reflections is not None and reflections.runs and not has_passes


def _chosen_lights(snapshot: SceneSnapshot, settings: Settings) -> tuple[list[Light], list[str]]:
    """And the names of those that were asked for and are not rendered here, but elsewhere."""
    lights, absent = list(snapshot.lights), []
    if settings.light_names is not None:
        wanted = set(settings.light_names)
        known = {light.name for light in lights} | set(snapshot.lights_elsewhere)
        missing = [name for name in settings.light_names if name not in known]
        if missing:
            has = ", ".join(map(repr, sorted(known))) or "none"
            raise UsageError(f"no light named {', '.join(map(repr, missing))} is rendered; the scene has {has}")
        lights = [light for light in lights if light.name in wanted]
        absent = [name for name in snapshot.lights_elsewhere if name in wanted] if Effect.SHADOW in settings.effects else []
    if not lights and Effect.SHADOW in settings.effects and not snapshot.lights_elsewhere:
        left_out = "".join(f"; {item.object_name} is left out: {item.reason}" for item in snapshot.left_out if item.is_light)
        raise SceneError(f"scene {snapshot.scene_name!r} has no light that is rendered; add a light or enable one for rendering{left_out}")
    return lights, absent


def _absent_pass(light_name: str, pass_name: str) -> PlannedPass:
    return PlannedPass(light_name, pass_name, runs=False, reason="skipped: not rendered in this frame and view layer")
