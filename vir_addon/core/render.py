"""The streamed loop: a generator that can be stopped after any batch.

    for every batch
        eye G-buffers at the next sub-pixel offsets, each for a share of the views
        rays that reflectors of the picture send on, and the surfaces that they meet
        for every light
            clear and fill the maps of the batch's views, face by face; look every pixel up, and what rays met; add to the running sums

Lights take turns inside a batch, so that all passes are equally far at every step.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from ..device.interface import Device, Texture
from ..device.owned import Owned
from .frustum import instances_in_picture
from .light_plan import PlannedPass
from .light_work import LightFit, LightWork, MapStore, Places, fit_both, fit_places
from .pass_set import (
    COMBINED_PASS_NAME,
    REFLECTION_COLOR_PASS_NAME,
    REFLECTION_PASS_NAME,
    PassSet,
    PassStatistics,
    ReflectionStatistics,
    SetStatistics,
)
from .passes.accumulate import pass_image
from .passes.emitters import Emitters, has_same_emitters, no_emitters, pack_emitters
from .passes.eye import EyePass, compiling_eye
from .passes.scene_data import SceneData, SceneGeometry, pack_geometry
from .passes.surface_data import SurfaceData, pack_surfaces
from .picture import Shown
from .plan import RenderPlan, check_device
from .reflections.reflectors import FOR_MEMORY, PlannedReflections, choose_reflectors, memory_for_maps, reflecting_instances
from .reflections.seen_places import SeenPlaces
from .reflections.work import ReflectionWork
from .sampling import pixel_offsets
from .scene import SceneSnapshot, has_same_meshes, has_same_picture, has_same_surfaces, is_same_light
from .settings import Effect, ReflectionLookUp
from .steps import HostWork, Steps, run_steps, send_step
from .stopwatch import OnStage, Stopwatch

LEAST_SEEN_SAMPLES = 4
"""of a pixel, by which reflectors are found"""


@dataclass
class Progress:
    """The state after a batch of views. `passes` is complete and valid at every step; it only gets better."""

    batches_done: int
    batches_total: int
    views_done: int
    """light samples looked up so far, of all passes"""
    views_total: int
    elapsed_s: float
    seconds_left: float
    """predicted from the batches so far"""
    _renderer: Renderer = field(repr=False)
    _kept: dict[str, np.ndarray] | None = field(default=None, repr=False)
    _error_estimate: float | None = field(default=None, repr=False)

    @property
    def error_estimate(self) -> float:
        """The largest error estimate of the passes so far, worked out when asked for; infinite before there are two rounds."""
        if self._error_estimate is None:
            self._error_estimate = self._renderer.device.run(self._renderer.update_errors)
        return self._error_estimate

    @property
    def statistics(self) -> SetStatistics:
        """With the error estimates of the passes so far."""
        _ = self.error_estimate
        statistics = self._renderer.statistics
        statistics.flat_triangle_count = self._renderer.snapshot.flat_triangle_count
        return statistics

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """pass name -> float32, (height, width) or of reflections (height, width, 3), row 0 at the bottom. Read back from the device
        when asked for, so ask before the next step; the last step can be asked after the generator has ended or been closed as well."""
        return self._renderer.read_passes() if self._kept is None else self._kept

    def keep(self) -> None:
        """Read back what the device is about to forget."""
        _ = self.error_estimate
        self._kept = self._renderer.read_passes()

    @property
    def pass_set(self) -> PassSet:
        return PassSet(self.passes, self.statistics)


def render(snapshot: SceneSnapshot, plan: RenderPlan, device: Device, on_stage: OnStage | None = None) -> Generator[Progress, None, None]:
    """Yield after every batch. Closing the generator releases the device's memory. UsageError if the device lacks what the plan needs.

    on_stage: told what is being done, also before the first batch. With a device that has a thread of its own, a KeyboardInterrupt
    of the caller's ends the work there with the current stage.
    """
    yield from cast(Generator[Progress, None, None], render_in_steps(snapshot, plan, device, on_stage, pauses=False))


def render_in_steps(
    snapshot: SceneSnapshot, plan: RenderPlan, device: Device, on_stage: OnStage | None = None, *, pauses: bool = True
) -> Generator[Progress | None, None, None]:
    """`render` for who has to do something else on the device's thread: where it pauses within a batch, and before the first, it yields
    None."""
    check_device(plan, device)
    with contextlib.closing(Renderer(snapshot, plan, device, on_stage)) as renderer:
        start = time.perf_counter()
        if pauses:
            yield from _pausing(renderer.preparing(), device)
        else:
            device.run(renderer.prepare)
        prepared_s = time.perf_counter() - start
        for batch in range(plan.batch_count):
            if pauses:
                yield from _pausing(renderer.rendering(batch), device)
            else:
                device.run(renderer.render_batch, batch)
            elapsed_s = time.perf_counter() - start
            share_done = (batch + 1) / plan.batch_count
            progress = Progress(
                batches_done=batch + 1,
                batches_total=plan.batch_count,
                views_done=round(renderer.views_total * share_done),
                views_total=renderer.views_total,
                elapsed_s=elapsed_s,
                seconds_left=(elapsed_s - prepared_s) * (1 / share_done - 1),
                _renderer=renderer,
            )
            try:
                yield progress
            except GeneratorExit:
                progress.keep()
                raise
        progress.keep()


def _pausing(steps: Steps, device: Device) -> Generator[None, None, None]:
    answer, has_ended = None, False
    try:
        while not has_ended:
            host_work, has_ended = device.run(send_step, steps, answer)
            answer = host_work() if host_work is not None else None
            yield
    finally:
        device.run(steps.close)


class Renderer:
    """What lives as long as one frame is rendered."""

    def __init__(
        self,
        snapshot: SceneSnapshot,
        plan: RenderPlan,
        device: Device,
        on_stage: OnStage | None = None,
        previous: Renderer | None = None,
    ) -> None:
        """previous: on the same device; what it has that is still right is shared, down to the passes of lights that nothing has changed
        for. Close it afterwards."""
        self.snapshot, self.plan, self.device = snapshot, plan, device
        self.stopwatch = Stopwatch(device, on_stage)
        self.reflects = plan.reflections is not None and plan.reflections.runs
        self.views_total = self._count_views()
        self.offsets_px = pixel_offsets(snapshot.pixel_filter, plan.eye_sample_count)
        self.surface_share_sum = np.zeros((snapshot.height_px, snapshot.width_px), np.float32)
        self.batches_done = 0
        self.works: list[LightWork] = []
        self.scene_data: SceneData | None = None
        self.eye: EyePass | None = None
        self.store: MapStore | None = None
        self.surfaces: SurfaceData | None = None
        self.emitters: Emitters | None = None
        self.reflections: ReflectionWork | None = None
        self._owned = Owned()
        self._current_offsets: list[int] = []
        self._eye_settling_count = 0
        self.statistics = SetStatistics(
            device=f"{device.name}: {device.description}",
            object_count=len(set(snapshot.instances.object_index.tolist())),
            instance_count=len(snapshot.instances),
            unique_triangle_count=snapshot.unique_triangle_count,
            instanced_triangle_count=snapshot.instanced_triangle_count,
            eye_sample_count=plan.eye_sample_count,
            stage_ms=self.stopwatch.shared_ms,
            left_out_object_count=len({item.object_name for item in snapshot.left_out if item.instance_count}),
            left_out_instance_count=sum(item.instance_count for item in snapshot.left_out),
            dropped_vertex_count=sum(item.vertex_count for item in snapshot.left_out),
            dropped_triangle_count=sum(item.triangle_count for item in snapshot.left_out),
            left_out=[item.text for item in snapshot.left_out],
            notes=list(plan.notes),
        )
        self.stopwatch.shared_ms["extract"] = snapshot.extract_ms
        if previous is not None:
            device.run(self._share, previous)

    def _share(self, previous: Renderer) -> None:
        is_same_picture = has_same_picture(self.snapshot, previous.snapshot)
        if previous.scene_data is not None and is_same_picture:
            self.scene_data = self._owned.own(previous.scene_data.share())
        elif previous.scene_data is not None and has_same_meshes(self.snapshot, previous.snapshot):
            self.scene_data = self._owned.own(SceneData(self.snapshot, self.device, previous.scene_data.geometry))
        if previous.surfaces is not None and has_same_surfaces(self.snapshot, previous.snapshot):
            self.surfaces = self._owned.own(previous.surfaces.share())
        if previous.emitters is not None and has_same_emitters(self.snapshot, previous.snapshot):
            self.emitters = previous.emitters
        if self.reflects or previous.reflects:
            # what reflectors show depends on all of the scene, and lights on what they show
            return
        if not (self.plan.has_same_steps(previous.plan) and self.surface_share_sum.shape == previous.surface_share_sum.shape):
            return
        if previous.store is not None:
            self.store = self._owned.own(previous.store.share())
        if previous.eye is not None and is_same_picture:
            self.eye = self._owned.own(previous.eye.share())
            self.eye.want_all()
            if self.plan.is_combined and not previous.plan.is_combined:
                return  # a light that was alone has settled where it would not beside others
            lights = {light.name: light for light in self.snapshot.lights}
            works = [work for work in previous.works if work.is_between_batches and work.planned in self.plan.passes]
            same = [work for work in works if is_same_light(work.given_light, lights[work.planned.light_name])]
            self.works = [self._owned.own(work.share()) for work in same]

    def _planned_lights(self) -> dict[str, PlannedPass]:
        """Light name -> how its maps are made: as what reflectors show needs them, where they show anything."""
        in_picture = {planned.light_name: planned for planned in self.plan.passes if planned.runs}
        return in_picture | {planned.light_name: planned for planned in self.plan.reflected_lights if self.reflects}

    def _count_views(self) -> int:
        return sum(planned.view_count for planned in self._planned_lights().values()) or self.plan.batch_count * self.reflects

    def _seeing_positions(self, eye: EyePass) -> Generator[HostWork | None, Any, list[np.ndarray]]:
        """Returns (height, width, 4) each, of the first eye samples, those of the first batch first: what is thinner than a pixel is missed
        by most of them. Leaves the first batch's in the eye's buffers."""
        batch_count = min(-(-LEAST_SEEN_SAMPLES // self.plan.eye_samples_per_batch), self.plan.batch_count)
        positions: list[np.ndarray] = []
        for batch in reversed(range(batch_count)):
            yield from self._rendering_eye(eye, batch)
            with self.stopwatch.stage("read-back"):
                positions = [*(self.device.read(buffer.positions) for buffer in eye.buffers), *positions]
            yield None
        return positions

    def _finding_reflectors(self, positions: list[np.ndarray]) -> Generator[HostWork | None, Any, PlannedReflections]:
        """Returns reflections as some eye samples call for them."""
        snapshot, bounds = self.snapshot, self.plan.bounds
        settings = memory_for_maps(self.device, self.plan.settings)

        def choose() -> PlannedReflections:
            seen = SeenPlaces(positions, reflecting_instances(snapshot), len(positions))
            return choose_reflectors(snapshot, bounds, settings, instances_in_picture(snapshot, bounds), seen)

        found: PlannedReflections = yield self.stopwatch.host_work("fit", choose)
        if settings != self.plan.settings and any(why in each.reason for each in found.reflectors for why in FOR_MEMORY):
            self.statistics.notes.append(
                f"reflectors' maps are smaller than asked: the device's largest texture holds {settings.reflection_map_mib} MiB of them"
            )
        assert self.plan.reflections is not None
        # there may be no memory for more
        return replace(found, bounces=min(found.bounces, self.plan.reflections.bounces))

    def prepare(self) -> None:
        run_steps(self.preparing())

    def preparing(self) -> Steps:
        """All that comes before the first batch."""
        for planned in self.plan.passes:
            if not planned.runs:
                self.statistics.passes.append(PassStatistics(planned.pass_name, planned.light_name, "none", planned.reason))
        if not self.plan.needs_eye:
            return
        if self.scene_data is None:
            meshes = self.snapshot.meshes
            rows = yield self.stopwatch.host_work("upload", pack_geometry, meshes)
            with self.stopwatch.stage("upload"), Owned() as temporary:
                geometry = temporary.own(SceneGeometry(meshes, self.device, rows))
                self.scene_data = self._owned.own(SceneData(self.snapshot, self.device, geometry))
            yield None
        if self.eye is None:
            yield from self.stopwatch.stages("upload", compiling_eye(self.device, self.reflects))
        with self.stopwatch.stage("upload"):
            if self.eye is None:
                samples_per_batch, texel_count = self.plan.eye_samples_per_batch, self.plan.settings.visibility_texel_count
                eye = EyePass(self.scene_data, self.plan.bounds, self.offsets_px, samples_per_batch, self.reflects, texel_count)
                self.eye = self._owned.own(eye)
        yield None
        if self.store is None:
            store = self._owned.own(MapStore(self.device, self.snapshot.width_px, self.snapshot.height_px, self.plan))
            yield from self.stopwatch.stages("upload", store.allocating())
            self.store = store  # shared with other renderers once it is whole
        yield from self._preparing_works(self.scene_data, self.eye, self.store)

    def _preparing_works(self, scene_data: SceneData, eye: EyePass, store: MapStore) -> Steps:
        shared = {work.planned.light_name: work for work in self.works}
        self.works = []
        planned_lights = self._planned_lights().values()
        new = [planned for planned in planned_lights if planned.light_name not in shared]
        seen: list[np.ndarray] = []
        if self.reflects:
            seen = yield from self._seeing_positions(eye)
        elif new or not shared:
            yield from self._rendering_eye(eye, 0)
        if new or self.reflects:
            with self.stopwatch.stage("read-back"):
                in_picture = seen[0] if seen else self.device.read(eye.buffers[0].positions), self.device.read(eye.buffers[0].normals)
        reflected: Places | None = None
        if self.reflects:
            in_sight = yield from self._finding_reflectors(seen)
            self.reflects = in_sight.runs
            if self.reflects:
                reflected = yield from self._preparing_reflections(in_sight, scene_data, eye, seen)
            else:
                self.statistics.reflections = ReflectionStatistics(bounces=in_sight.bounces, reflectors=in_sight.settled().texts)
                self.statistics.notes.append(
                    "nothing reflects: what reflectors show in the picture is hidden behind other surfaces, or next to nothing"
                )
                planned_lights = self._planned_lights().values()
                self.views_total = self._count_views()
        for planned in planned_lights:
            if planned.light_name in shared:
                self.works.append(shared[planned.light_name])
            else:
                yield from self._preparing_light(planned, scene_data, store, in_picture, reflected)
        self.statistics.passes += [work.statistics for work in self.works if work.has_pass]
        self.statistics.passes.sort(key=lambda statistics: statistics.light_name)

    def _preparing_light(
        self, planned: PlannedPass, scene_data: SceneData, store: MapStore, in_picture: Places, reflected: Places | None
    ) -> Steps:
        """One work for the picture and what reflectors show, or two where maps that reach over both would have larger texels."""
        light = next(light for light in self.snapshot.lights if light.name == planned.light_name)
        own = next((each for each in self.plan.passes if each.runs and each.light_name == light.name), None)
        arguments = light, self.plan, scene_data
        sets: list[tuple[PlannedPass, LightFit, bool, bool]] = []
        own_ms: dict[str, float] = {}
        serves_both = False
        if own is not None:
            with self.stopwatch.billed_to(own_ms, light.name):
                if reflected is None or own.is_sealed:
                    fit = yield self.stopwatch.host_work("points", fit_places, own, *arguments, in_picture)
                else:
                    fit, serves_both = yield self.stopwatch.host_work("points", fit_both, own, planned, *arguments, in_picture, reflected)
            sets.append((planned if serves_both else own, fit, True, serves_both))
        if reflected is not None and not serves_both:
            fit = yield self.stopwatch.host_work("points", fit_places, planned, *arguments, reflected)
            sets.append((planned, fit, False, True))
        for made_as, fit, has_pass, lights_reflections in sets:
            work = self._owned.own(LightWork(made_as, *arguments, store, has_pass, lights_reflections))
            if has_pass:
                work.statistics.stage_ms |= own_ms
            self.works.append(work)
            with self._billed_to(work):
                yield from work.fitting(fit, self.stopwatch)
            yield None

    def _preparing_reflections(
        self, planned: PlannedReflections, scene_data: SceneData, eye: EyePass, seen: list[np.ndarray]
    ) -> Generator[HostWork | None, Any, Places]:
        """Returns what reflectors show. seen: positions of `_seeing_positions`"""
        if self.surfaces is None:
            rows = yield self.stopwatch.host_work("upload", pack_surfaces, self.snapshot)
            with self.stopwatch.stage("upload"):
                self.surfaces = self._owned.own(SurfaceData(self.snapshot, self.device, rows))
            yield None
        # by direction alone nothing would hide what shines
        emitters = no_emitters(self.snapshot)
        if self.plan.settings.reflection_look_up is ReflectionLookUp.MARCH:
            if self.emitters is None:
                self.emitters = yield self.stopwatch.host_work("upload", pack_emitters, self.snapshot)
            emitters = self.emitters
        with self.stopwatch.stage("upload"):
            reflections = self.reflections = self._owned.own(ReflectionWork(planned, self.plan, scene_data, self.surfaces, emitters, eye))
            self.statistics.reflections = reflections.statistics
        reflections.find_tiles([positions[..., 3] for positions in seen])
        yield None
        yield from reflections.preparing(self._current_offsets, self.stopwatch)
        positions, normals = yield from reflections.gathering_hits(self._current_offsets, self.stopwatch)
        if not self.plan.passes:
            # nobody looks at the rest of the picture any more
            eye.want_only(reflections.tiles_shown)
        together: Places = yield self.stopwatch.host_work("points", lambda: (np.concatenate(positions), np.concatenate(normals)))
        return together

    def _billed_to(self, work: LightWork) -> contextlib.AbstractContextManager[None]:
        """What lights only reflections has no pass of its own."""
        return self.stopwatch.billed_to(work.statistics.stage_ms, work.light.name) if work.has_pass else contextlib.nullcontext()

    def _rendering_eye(self, eye: EyePass, batch: int) -> Generator[None, None, None]:
        first = batch * self.plan.eye_samples_per_batch
        offsets = [(first + part) % self.plan.eye_sample_count for part in range(self.plan.eye_samples_per_batch)]
        if offsets != self._current_offsets:
            self._current_offsets = []
            yield from self.stopwatch.stages("eye G-buffer", eye.rendering(offsets, batch))
            self._current_offsets = offsets

    def render_batch(self, batch: int) -> None:
        run_steps(self.rendering(batch))

    def rendering(self, batch: int) -> Steps:
        """A batch of all passes that have not had it, light by light."""
        self.batches_done += 1
        due = [work for work in self.works if work.batches_done <= batch]
        if self.eye is None or (self.works and not due):
            return
        yield from self._rendering_eye(self.eye, batch)
        if self.reflections is not None and batch > 0:
            yield from self.reflections.tracing(self._current_offsets, batch, self.stopwatch)
        if self.plan.passes and not any(work.has_pass for work in self.works):
            # only for passes that are constant on surfaces, which still have to be told from the background
            self.surface_share_sum += self.device.read(self.eye.buffers[0].positions)[..., 3] >= 0
        for work in due:
            yield None
            with self._billed_to(work):
                yield from work.rendering(batch, self.eye, self.stopwatch, self.reflections if work.lights_reflections else None)
        if self.reflections is not None:
            self.reflections.end_batch(self.stopwatch)
        shown = [work for work in due if work.has_pass]
        settling_count = min((work.accumulator.settling_count for work in shown), default=0)
        if settling_count > self._eye_settling_count:
            wanted = [work.accumulator.looked_up for work in shown]
            if self.reflections is not None:
                wanted.append(self.reflections.tiles_shown)
            self.eye.want_only(np.any(wanted, axis=0))
            self._eye_settling_count = settling_count

    def update_errors(self) -> float:
        shown = [work for work in self.works if work.has_pass]
        for work in shown:
            work.statistics.error_estimate = work.accumulator.compute_error()
        errors = [work.statistics.error_estimate for work in shown]
        if self.reflections is not None:
            self.reflections.statistics.error_estimate = self.reflections.compute_error()
            self.reflections.statistics.rays_per_pixel = self.reflections.mean_ray_count()
            errors.append(self.reflections.statistics.error_estimate)
        return max(errors, default=0.0)

    def views_done(self, batches_done: int) -> int:
        """Light samples looked up after so many batches; lights that were taken over may have had more."""
        if not self.works:
            return round(self.views_total * batches_done / self.plan.batch_count)
        views = {work.light.name: work.planned.view_count * work.batches_done for work in self.works}  # of a light with two works once
        return round(sum(views.values()) / self.plan.batch_count)

    def draw_shadows(self, picture: Texture, light_name: str | None) -> bool:
        """Without reading anything back: the combined pass, or one light's, into a texture of the picture's size, as of `COMBINE_PASSES`.
        False if there is nothing to draw: no light, or not this one, has its pass made."""
        shown = [work for work in self.works if work.has_pass and light_name in (None, work.light.name)]
        for number, work in enumerate(shown):
            weight = self._combined_weight(work) if light_name is None else 1.0
            work.accumulator.add_to(picture, weight, is_first=number == 0)
        return bool(shown)

    def draw_reflections(self, picture: Texture, shown: Shown) -> bool:
        """Likewise what reflectors show, as of `SHOW_REFLECTIONS`. False if nothing reflects."""
        if self.reflections is None:
            return False
        self.reflections.draw(picture, shown)
        return True

    def _combined_weight(self, work: LightWork) -> float:
        """What a light's running sums count in the combined pass: its strength per look-up, of which lights with more views have more,
        without the light's own unit of distance. A light of negative strength counts as much as a positive one, so that the pass stays
        between 0 and 1."""
        return abs(work.light.strength) / work.look_up_count / work.reference_m**2

    def read_passes(self) -> dict[str, np.ndarray]:
        return self.device.run(self._read_passes)

    def _read_passes(self) -> dict[str, np.ndarray]:
        shape = (self.snapshot.height_px, self.snapshot.width_px)
        images: dict[str, np.ndarray] = {}
        combined = [np.zeros(shape, np.float64), np.zeros(shape, np.float64)]
        surface_share = self.surface_share_sum / max(self.batches_done, 1)
        with self.stopwatch.stage("read-back"):
            shown = [work for work in self.works if work.has_pass]
            for work in shown:
                shadowed, delivered, received_share = work.accumulator.read(is_combined=len(shown) > 1)
                # a light's receivers need not be all surfaces
                surface_share = np.maximum(surface_share, received_share)
                images[work.planned.pass_name] = pass_image(shadowed, delivered, received_share)
                weight = self._combined_weight(work)
                combined[0] += weight * shadowed
                combined[1] += weight * delivered
        for planned in self.plan.passes:
            if not planned.runs:
                images[planned.pass_name] = (1 - surface_share * (1 - planned.surface_value)).astype(np.float32)
        if shown:
            images[COMBINED_PASS_NAME] = pass_image(combined[0], combined[1], surface_share)
        elif Effect.SHADOW in self.plan.settings.effects:
            images[COMBINED_PASS_NAME] = np.ones(shape, np.float32)
        if self.reflections is not None:
            images |= self.reflections.read()
        elif self.plan.reflections is not None:
            images |= {name: np.zeros((*shape, 3), np.float32) for name in (REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME)}
        return dict(sorted(images.items()))

    def close(self) -> None:
        # an interrupted caller may have left the device's thread at work
        self.stopwatch.stop()
        self.device.run(self._owned.close)
