"""One light's share of the streamed loop: its samples, fitted faces, method per face and running sums."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..device.interface import ComputeKernel, Device, Texture, TextureFormat
from ..device.owned import Owned, Shared
from .bounds import cullable_instances
from .fit import FittedFace, fit_light, has_thin_walls, light_hull, receiver_cone
from .light_plan import NO_MAP_REASON, PlannedPass
from .methods import depth_map_method
from .methods.base import DepthMapMethod, FaceJob
from .methods.shared import SharedByFaces
from .pass_set import PassStatistics
from .passes.accumulate import (
    MIN_EARLY_SETTLING_EYE_SHARE,
    MIN_EARLY_SETTLING_VIEWS,
    MIN_SETTLING_BATCHES,
    MIN_SETTLING_EYE_SHARE,
    MIN_SETTLING_VIEWS,
    STATE_LIT,
    PassAccumulator,
)
from .passes.eye import EyePass
from .passes.percentage_closer import PERCENTAGE_CLOSER, LightTaps, light_radius_m
from .passes.resolve import DELIVERED_FLAGS, FIRST_FACE, LAST_FACE, LIT_WINDOW, RESOLVE, TILE_FACES, UNKNOWN_WINDOW, WAS_LIT
from .passes.scene_data import SceneData
from .passes.shadow_maps import MAX_BATCH_VIEWS, DepthMaps, face_table, samples_table, views_table
from .plan import RenderPlan
from .reach import Receivers, select_receivers
from .reflections.work import Hits, ReflectionWork
from .sampling import light_samples, sample_weights
from .scene import Light, LightShape
from .settings import Method
from .steps import Allocation, Steps, compiling, run_steps
from .stopwatch import Stopwatch

LightFace = tuple[FittedFace, np.ndarray, DepthMapMethod | None]
"""with its table for the kernels; without a method where nothing casts"""
Places = tuple[np.ndarray, np.ndarray]
"""positions and normals of an eye G-buffer, (height, width, 4) each"""
UNUSED_SUMS_PX = (24, 24)
"""Small, and neither they nor their tiles a power of two, as few pictures are: for those Mesa's software rasterizer would translate
kernels once more."""
MAX_TEXEL_GROWTH = 1.1
"""of a light's maps by reaching over what reflectors show as well; one step of the ladder of texel sizes is 1.09"""


@dataclass(frozen=True)
class LightFit:
    """A light's views, fitted to surfaces."""

    faces: list[FittedFace]
    is_cube: bool
    culled: np.ndarray
    """(instance_count,) bool of `cullable_instances`"""
    samples_m: np.ndarray
    """(view_count, 3) of `sampling.light_samples`"""
    sample_weights: np.ndarray
    """(view_count,)"""
    has_thin_walls: bool
    """of `fit.has_thin_walls`"""
    known: np.ndarray
    """(instance_count,) bool: instances of which some of the surfaces is"""

    def texel_growth(self, wider: LightFit) -> float:
        """How many times as large texels are that reach over more than these surfaces."""
        before, after = (
            {face.views.face.index: max(face.views.texel_tangent) for face in fit.faces if face.views.map_width_px} for fit in (self, wider)
        )
        if self.is_cube != wider.is_cube:
            return max(after.values(), default=0.0) / max(before.values(), default=math.inf)
        return max((after.get(index, 0.0) / tangent for index, tangent in before.items()), default=0.0)


def fit_views(planned: PlannedPass, light: Light, plan: RenderPlan, scene_data: SceneData, receivers: Receivers) -> LightFit:
    snapshot, light = scene_data.snapshot, _as_it_casts(light, planned, scene_data)
    cone = receiver_cone(light, receivers) if light.shape.is_omni and light.has_size else None
    samples_m, taps = light_samples(light, planned.view_count, cone), _taps(planned, light, plan)
    pixels = scene_data.eye_pixels if planned.method is Method.EPR else None
    searched_m = taps.samples_m if taps else None
    faces, is_cube = fit_light(snapshot, light, samples_m, plan.bounds, receivers, planned.map_resolution_px, pixels, searched_m)
    hull = None if light.shape is LightShape.SUN else light_hull(light, samples_m)
    culled = cullable_instances(snapshot, plan.bounds, hull)
    is_thin = has_thin_walls(snapshot, light, plan.bounds, faces)
    known = np.zeros(len(snapshot.instances), bool)
    known[receivers.instances] = True
    return LightFit(faces, is_cube, culled, samples_m, sample_weights(light, samples_m, cone), is_thin, known)


def fit_places(planned: PlannedPass, light: Light, plan: RenderPlan, scene_data: SceneData, places: Places) -> LightFit:
    return fit_views(planned, light, plan, scene_data, select_receivers(*places, light, _beyond_px(scene_data)))


def _beyond_px(scene_data: SceneData) -> float:
    """How far from pixels' centres their samples may be; those of shared visibility are moved by a quarter of a pixel at most"""
    width_px = scene_data.snapshot.pixel_filter.width_px
    return width_px / 2 + 0.25 if width_px else 0.0


def fit_both(
    own: PlannedPass, joint: PlannedPass, light: Light, plan: RenderPlan, scene_data: SceneData, in_picture: Places, reflected: Places
) -> tuple[LightFit, bool]:
    """To the picture and to what reflectors show, True; or to the picture alone, False, where maps that reach over both would have
    larger texels. own: as planned for the picture; joint: for both"""
    seen, shown = (select_receivers(*places, light, _beyond_px(scene_data)) for places in (in_picture, reflected))
    fit = fit_views(own, light, plan, scene_data, seen)
    both = Receivers(
        np.concatenate([seen.points_ws, shown.points_ws]),
        seen.margin,
        max(seen.gap_tangent, shown.gap_tangent),
        np.concatenate([seen.beyond_ws, shown.beyond_ws]),
        np.union1d(seen.instances, shown.instances),
    )
    wider = fit_views(joint, light, plan, scene_data, both)
    if fit.texel_growth(wider) > MAX_TEXEL_GROWTH:
        return fit, False
    if shown.margin > seen.margin:
        # what is looked at in larger steps has a wider margin, which says nothing of where it lies
        wider = fit_views(joint, light, plan, scene_data, replace(both, margin=shown.margin))
    return wider, True


class MapStore(Shared):
    """Textures that all lights share because only one batch uses them at a time."""

    def __init__(self, device: Device, width: int, height: int, plan: RenderPlan) -> None:
        """To be followed by `allocating`."""
        self.device, self._size, self._round_count = device, (width, height), plan.eye_samples_per_batch
        self._maps: dict[int, DepthMaps] = {}
        self._width_px = self._height_px = 1
        with Owned() as owned:
            self.shared = owned.own(SharedByFaces(device, plan.settings))
            self.batch_sums: list[Texture] = []
            """of each round of a batch"""
            self.no_maps: Texture = owned.own(device.create_texture(1, 1, TextureFormat.R32UI))
            """what kernels are bound to where they read no map"""
            self._owned = owned.pop_all()

    def allocating(self) -> Generator[None, None, None]:
        """Create what is as large as the picture."""
        width, height = self._size
        allocation, zeros = Allocation(self._owned), np.zeros((height, width, 4), np.float32)
        for _ in range(self._round_count):
            self.batch_sums.append((yield from allocation.keeping(self.device.upload_texture, zeros)))

    def make_room(self, width_px: int, height_px: int) -> None:
        """To be told of all maps of a frame before the first are asked for: those that the picture decides the size of share a texture with
        larger ones."""
        self._width_px, self._height_px = max(self._width_px, width_px), max(self._height_px, height_px)

    def maps(self, view_count: int) -> DepthMaps:
        maps = self._maps.get(view_count)
        if maps is None or maps.width_px < self._width_px or maps.height_px < self._height_px:
            if maps is not None:
                maps.release()
            maps = self._maps[view_count] = DepthMaps(self.device, self._width_px, self._height_px, view_count)
        return maps

    def _free(self) -> None:
        for maps in self._maps.values():
            maps.release()
        self._owned.close()


class FaceTurns:
    """Which dispatches of a batch look a tile up: only those of faces that its surfaces are seen in, and one in any case."""

    def __init__(self, masks: list[int], tile_faces: np.ndarray) -> None:
        """masks: faces of each dispatch, a bit each; tile_faces: (rounds, rows, columns) those of every tile"""
        self.masks = masks
        self.sees = np.stack([(tile_faces & mask) != 0 for mask in masks], axis=1)
        """(rounds, dispatches, rows, columns) bool"""
        self.sees[:, 0] |= ~self.sees.any(axis=1)
        self._late_faces = np.zeros(self.sees.shape, np.int64)

    def skipped_by(self, index: int, part: int) -> int:
        """How many rounds are through in a batch when this dispatch of this round begins."""
        return part if index == len(self.masks) - 1 else 0

    def begin_late(self, index: int, part: int, tiles: np.ndarray, were_lit: np.ndarray) -> None:
        """These tiles, (rows, columns) bool, take part from this dispatch of this round on. What those before it would have found is as
        it was, all lit or all dark (of background: dark); rounds that are through stay without them.

        They take part in all dispatches that are left: what they show at this batch's offsets is known only now, and so their
        rounds end in their order, the first of them with what the tile has missed.
        """
        for each in range(len(self.sees)):
            start = index if each >= part else index + 1
            self.sees[each, :start, tiles] = False
            self.sees[each, start:, tiles] = True
            if start < len(self.masks):
                self._late_faces[each, start, tiles] = sum(self.masks[:start]) | WAS_LIT * were_lit[tiles]

    def of(self, index: int, part: int) -> np.ndarray:
        """(rows, columns) int64 as of TURN_DEFINES; -1: none in this dispatch"""
        sees = self.sees[part]
        first = FIRST_FACE * ~sees[:index].any(axis=0)
        last = LAST_FACE * ~sees[index + 1 :].any(axis=0)
        return np.where(sees[index], self._late_faces[part, index] | first | last, -1)


class LightWork(Shared):
    def __init__(
        self,
        planned: PlannedPass,
        light: Light,
        plan: RenderPlan,
        scene_data: SceneData,
        store: MapStore,
        has_pass: bool = True,
        lights_reflections: bool = False,
    ) -> None:
        """has_pass: whether the picture is looked up; lights_reflections: whether what reflectors show is"""
        snapshot = scene_data.snapshot
        self.has_pass, self.lights_reflections = has_pass, lights_reflections
        self.planned, self.plan, self.scene_data, self.store = planned, plan, scene_data, store
        self.given_light, self.light = light, _as_it_casts(light, planned, scene_data)
        """as the snapshot has it, and with what casts for it here"""
        self.device = scene_data.device
        self.batches_done = 0
        self.is_between_batches = False
        """fitted, and not in the middle of a batch"""
        self.taps = _taps(planned, self.light, plan)
        self.look_up = RESOLVE
        self.resolve_flags = list(planned.method.resolve_flags)
        if self.light.shape.is_omni:
            has_sphere = planned.view_count > 1 or self.taps is not None
            self.resolve_flags += ["OMNI"] + ["SPHERE"] * has_sphere + ["CONE"] * (self.light.shape is LightShape.SPOT)
        if self.light.shape is LightShape.SUN:
            self.resolve_flags.append("ORTHOGRAPHIC")
        if self.light.is_spread_limited:
            self.resolve_flags.append("SPREAD")
        if planned.is_sealed:
            self.resolve_flags.append("SEALED")
        if self.light.receivers is not None:
            self.resolve_flags.append("RECEIVER_LINKING")
        with Owned() as owned:
            # kernels are bound to sums also where nothing is added
            size = (snapshot.width_px, snapshot.height_px) if has_pass else UNUSED_SUMS_PX
            self.accumulator = owned.own(PassAccumulator(self.device, *size))
            self._owned = owned.pop_all()
        self.statistics = PassStatistics(
            planned.pass_name,
            planned.light_name,
            planned.method_text,
            planned.reason,
            view_count=planned.view_count,
            map_resolution_px=planned.map_resolution_px,
        )
        self.samples_m, self.sample_weights = np.zeros((planned.view_count, 3)), np.ones(planned.view_count)
        """of the fit"""
        self.faces: list[LightFace] = []
        self.mapped: list[LightFace] = []
        """those that dispatches are for"""
        self.masks: list[int] = []
        """faces that each of these dispatches looks up, a bit each"""
        self.reference_m = 1.0
        """distance at which the light delivers 1 in the running sums, which keeps them near 1 in scenes of any scale"""

    def fit(self, positions: np.ndarray, normals: np.ndarray, stopwatch: Stopwatch) -> None:
        """Fit the views to the surfaces of an eye G-buffer, (height, width, 4) each, and make what all batches share."""
        with stopwatch.stage("points"):
            fit = fit_places(self.planned, self.light, self.plan, self.scene_data, (positions, normals))
        run_steps(self.fitting(fit, stopwatch))

    def fitting(self, fit: LightFit, stopwatch: Stopwatch) -> Steps:
        """Make what all batches share, face by face."""
        if self.light.shape is not LightShape.SUN:
            self.reference_m = max((fitted.views.far_m for fitted in fit.faces), default=1.0)
        self.samples_m, self.sample_weights = fit.samples_m, fit.sample_weights
        rows = np.zeros((len(fit.known), 4), np.float32)
        rows[:, 0] = 1.0 if self.light.receivers is None else self.light.receivers
        rows[:, 1] = fit.known
        self.receivers = self._owned.own(self.device.upload_array(rows))
        self.faces = [self._face(fitted, fit.culled) for fitted in fit.faces]
        if self.taps and self.faces:
            self.look_up = PERCENTAGE_CLOSER
            self.statistics.blocker_sample_count, self.statistics.filter_sample_count = self.taps.counts
        # faces without casters need no map: the first dispatch looks them up too, or one of their own if there is no other
        self.mapped = [face for face in self.faces if face[2] is not None] or self.faces[:1]
        self.masks = [1 << fitted.views.face.index for fitted, _, _ in self.mapped]
        if self.mapped:
            self.masks[0] |= sum(1 << fitted.views.face.index for fitted, _, method in self.faces if method is None)
        if fit.is_cube and (len(self.masks) > 1 or self.taps):
            self.resolve_flags.append("MANY_FACES")
        elif fit.is_cube:
            # faces without casters need not be told apart from the one with a map
            self.resolve_flags.append("LIT_BEYOND")
        if fit.has_thin_walls and self.planned.method.tells_planes:
            self.resolve_flags.append("THIN_WALLS")
        for _, _, method in self.faces:
            if method is not None:
                yield from stopwatch.stages("points", method.preparing())
        for fitted in fit.faces:
            self.store.make_room(fitted.views.map_width_px, fitted.views.map_height_px)
        self.statistics.map_resolution_px = max(
            (max(fitted.views.map_width_px, fitted.views.map_height_px) for fitted in fit.faces), default=0
        )
        if not any(method for _, _, method in self.faces):
            self.statistics.method = "none"
            if self.planned.needs_maps:
                self.statistics.reason = f"{self.planned.reason}; {NO_MAP_REASON}"
        self._update_statistics()
        self.is_between_batches = True

    def _face(self, fitted: FittedFace, culled: np.ndarray) -> LightFace:
        table = face_table(fitted.views, self.light, self.reference_m)
        if not len(fitted.caster_indices):
            return fitted, table, None
        job = FaceJob(self.scene_data, fitted, table, culled, self.light, self.samples_m, self.plan.settings, self.store.shared)
        return fitted, table, self._owned.own(depth_map_method(self.planned, job))

    def _update_statistics(self) -> None:
        methods = [method for _, _, method in self.faces if method is not None]
        self.statistics.face_count = len(self.faces)
        self.statistics.settled_share = self.accumulator.settled_share
        for field in methods[0].counts() if methods else ():
            setattr(self.statistics, field, sum(method.counts()[field] for method in methods))
        self.statistics.portion_count = max((method.portion_count for method in methods), default=1)
        self.statistics.caster_triangle_count = max((method.caster_triangle_count for method in methods), default=0)

    def batch_views(self, batch: int) -> range:
        """The views of a batch. A light with fewer views than there are batches shows one of them again in each."""
        views, batches = self.planned.view_count, self.plan.batch_count
        if views < batches:
            return range(batch % views, batch % views + 1)
        return range(batch * views // batches, (batch + 1) * views // batches)

    @property
    def look_up_count(self) -> int:
        """How often a pixel asks all of this light's batches whether it sees the light, in all of its eye samples."""
        parts, batches = self.plan.eye_samples_per_batch, range(self.plan.batch_count)
        return sum(len(_views_of_part(len(self.batch_views(batch)), part, parts)) for batch in batches for part in range(parts))

    @property
    def largest_batch(self) -> int:
        """views; batches may differ by one, and share their maps"""
        return -(-self.planned.view_count // self.plan.batch_count)

    def render_batch(self, batch: int, eye: EyePass, stopwatch: Stopwatch) -> None:
        run_steps(self.rendering(batch, eye, stopwatch))

    def rendering(self, batch: int, eye: EyePass, stopwatch: Stopwatch, reflections: ReflectionWork | None = None) -> Steps:
        """`render_batch`, pausing between filling maps and looking them up. reflections: what they show is looked up as well"""
        self.is_between_batches = False
        selected = self.batch_views(batch)
        if self.has_pass:
            self.accumulator.begin_batch(len(eye.buffers))
        turns: FaceTurns | None = None
        for index, (_, _, method) in enumerate(self.mapped):
            maps = self.store.no_maps
            if method is not None:
                maps = (yield from stopwatch.stages("splat or raster", self._mapping(method, selected))).texture
            rounds = self._rounds(eye, index, maps, batch)
            if reflections is not None:
                for hits in reflections.all_hits:
                    yield from stopwatch.stages("light reflections", self._lighting_hits(reflections, hits, index, rounds[hits.part]))
            if not self.has_pass:
                continue
            turns = yield from stopwatch.stages("resolve", self._resolving(batch, eye, turns, index, rounds))
        if self.has_pass and not self.faces:
            # nothing visible is reached; surfaces still have to be told from the background
            yield from stopwatch.stages("resolve", self._resolving_nothing(eye))
        if self.has_pass and (self._may_settle(batch) or self._may_settle_early(batch)):
            with stopwatch.stage("resolve"):
                self.accumulator.settle(*eye.buffers[-1], early=not self._may_settle(batch), is_combined=self.plan.is_combined)
        self._update_statistics()
        self.batches_done, self.is_between_batches = batch + 1, True

    def _mapping(self, method: DepthMapMethod, selected: range) -> Generator[None, None, DepthMaps]:
        yield from method.getting_ready(selected)
        return method.maps_of(selected, self._lent_maps)

    def _resolving(
        self, batch: int, eye: EyePass, turns: FaceTurns | None, index: int, rounds: list[dict[str, Any]]
    ) -> Generator[None, None, FaceTurns]:
        """Look the picture up in the maps of a face, pausing where a kernel was compiled. turns: of the batch, if they are known; they are
        what it returns"""
        if turns is None:
            turns = FaceTurns(self.masks, np.array([self._tile_faces(look_up) for look_up in rounds]))
        for part, look_up in enumerate(rounds):
            if not self.accumulator.looked_up.all():
                kernel = yield from self._compiling("PROBES")
                yield from self._reopening_changed(kernel, batch, eye, turns, index, part, look_up)
            yield from self._looking_up(part, turns.of(index, part), look_up)
        return turns

    def _resolving_nothing(self, eye: EyePass) -> Generator[None, None, None]:
        nothing = {"map_face": 0, "face_mask": 0, "depth_maps": self.store.no_maps}
        empty = {name: np.zeros((1, 4)) for name in ("face", "views", "samples")}
        only_turn = np.full(self.accumulator.looked_up.shape, FIRST_FACE | LAST_FACE)
        for part in range(len(eye.buffers)):
            yield from self._looking_up(part, only_turn, {**self._round(eye, part, 0), **empty, **nothing})

    def _looking_up(self, part: int, turns: np.ndarray, look_up: dict[str, Any]) -> Generator[None, None, None]:
        kernel = yield from self._compiling()
        with Owned() as temporary:
            tiles = temporary.own(self.accumulator.tiles_to_look_up(part, turns))
            yield from tiles.walking(kernel, **self._bound(look_up))

    def _lent_maps(self) -> DepthMaps:
        return self.store.maps(self.largest_batch)

    def _lighting_hits(self, reflections: ReflectionWork, hits: Hits, index: int, look_up: dict[str, Any]) -> Generator[None, None, None]:
        """Look what reflectors show up in the maps of a face. look_up: of the hits' eye sample"""
        tiles = reflections.lit_tiles(FIRST_FACE if index == 0 else 0, hits)
        width, height = hits.buffer.positions.width, hits.buffer.positions.height
        # what reflectors show is no mean over samples in which those that nothing is known of could be left out
        has_no_edges = self.look_up is PERCENTAGE_CLOSER or "LIT_BEYOND" in self.resolve_flags
        kernel = yield from self._compiling(*["LIT_BEYOND"] * (not has_no_edges))
        look_up_of_hits = {**look_up, **hits.buffer._asdict(), "batch_sums": hits.sums, "width": width, "height": height}
        yield from tiles.walking(kernel, **self._bound(look_up_of_hits))
        if index == len(self.mapped) - 1:
            points = self._light_points(look_up)
            yield from reflections.adding_light(
                hits,
                [flag for flag in self.resolve_flags if flag in DELIVERED_FLAGS],
                light_rgb=self._irradiance_of_sum(look_up["view_count"]),
                face=look_up["face"],
                light_points=points,
                point_count=len(points),
                lamp=_lamp_table(self.light),
                point_reach=_lamp_radius_m(self.light) / math.sqrt(self.planned.view_count),
            )

    def _light_points(self, look_up: dict[str, Any]) -> np.ndarray:
        """(n, 4) of LIGHT_HITS, those that a round looks up; some of the filter's of a light that is looked up by taps"""
        if self.taps:
            return look_up["light_points"][look_up["search_count"] :][:MAX_BATCH_VIEWS]
        selected = slice(look_up["first_view"], look_up["first_view"] + look_up["view_count"])
        points = look_up["samples"][selected].copy()
        if self.light.shape is not LightShape.SUN:
            points[:, :3] = look_up["views"][0::2, :3][selected]
        return points

    def _irradiance_of_sum(self, view_count: int) -> tuple[float, float, float]:
        red, green, blue = self.light.strength_rgb or 3 * (self.light.strength,)
        scale = 1 / (view_count * self.reference_m**2)
        return red * scale, green * scale, blue * scale

    def _may_settle_early(self, batch: int) -> bool:
        """Once, before that."""
        return (
            self._has_to_settle(batch)
            and not self.accumulator.settling_count
            and len(self.batch_views(batch)) >= MIN_EARLY_SETTLING_VIEWS
            and self._seen_eye_share(batch) >= MIN_EARLY_SETTLING_EYE_SHARE
        )

    def _may_settle(self, batch: int) -> bool:
        """Once, as soon as enough is known."""
        return (
            self._has_to_settle(batch)
            and batch + 1 >= MIN_SETTLING_BATCHES
            and (self.batch_views(batch).stop >= MIN_SETTLING_VIEWS or batch + 1 >= self.planned.view_count)
            and self._seen_eye_share(batch) >= MIN_SETTLING_EYE_SHARE
        )

    def _seen_eye_share(self, batch: int) -> float:
        """Of the frame's eye samples, of those at most that anti-aliasing takes."""
        return (batch + 1) * self.plan.eye_samples_per_batch / self.plan.edge_sample_count

    def _has_to_settle(self, batch: int) -> bool:
        """Not when no batch is left to gain from it."""
        return (
            self.plan.settings.is_adaptive
            and len(self.faces) > 0
            and not self.accumulator.has_settled
            and batch + 1 < self.plan.batch_count
        )

    def _round(self, eye: EyePass, part: int, view_count: int) -> dict[str, Any]:
        """What RESOLVE is bound to for one of a batch's eye samples, but for what the face brings."""
        width, height = eye.size
        views = _views_of_part(view_count, part, len(eye.buffers))
        return {
            **eye.buffers[part]._asdict(),
            "batch_sums": self.store.batch_sums[part],
            "first_view": views.start,
            "view_count": len(views),
            "receivers": self.receivers,
            "round_sums": self.accumulator.round_sums,
            "disagreeing": self.accumulator.disagreeing,
            "probed_light": self.accumulator.probed_light,
            "rounds_before": self.accumulator.rounds_before(part),
            "width": width,
            "height": height,
        }

    def _rounds(self, eye: EyePass, index: int, maps: Texture, batch: int) -> list[dict[str, Any]]:
        """What RESOLVE is bound to for each of a batch's eye samples while the maps are those of a face."""
        fitted, table, method = self.mapped[index]
        selected = self.batch_views(batch)
        face = {
            "depth_maps": maps,
            "face": table,
            "views": _looked_up_views(fitted, selected),
            "samples": samples_table(fitted.views, self.sample_weights, selected),
            "map_face": fitted.views.face.index,
            "face_mask": self.masks[index],
        }
        parts = range(len(eye.buffers))
        taps: list[dict[str, Any]] = [{} for _ in parts]
        if self.taps:
            nearest_m = fitted.views.far_m if method is None else method.nearest_m
            taps = [self.taps.bindings(fitted.views.face, nearest_m, batch * len(parts) + part) for part in parts]
        return [{**self._round(eye, part, len(selected)), **face, **taps[part]} for part in parts]

    def _tile_faces(self, look_up: dict[str, Any]) -> np.ndarray:
        """(rows, columns) uint32: a bit for every face that the tile's surfaces are seen in"""
        rows, columns = self.accumulator.looked_up.shape
        if len(self.masks) == 1:
            return np.full((rows, columns), self.masks[0], np.uint32)
        names = ("positions", "width", "height", "first_view", "view_count", "face", "samples")
        with Owned() as temporary:
            tile_faces = temporary.own(self.device.create_texture(columns, rows, TextureFormat.R32UI))
            kernel = self.device.compute_kernel(TILE_FACES)
            kernel.dispatch_grid((columns, rows), tile_faces=tile_faces, **{name: look_up[name] for name in names})
            return self.device.read(tile_faces)

    def _reopening_changed(
        self, kernel: ComputeKernel, batch: int, eye: EyePass, turns: FaceTurns, index: int, part: int, look_up: dict[str, Any]
    ) -> Generator[None, None, None]:
        """Look settled tiles up at a few pixels, at others in every batch, and go on with those that are not what they were."""
        with Owned() as temporary:
            sees = turns.sees[part]
            tiles = temporary.own(self.accumulator.tiles_to_probe(sees[index], is_first_face=~sees[:index].any(axis=0)))
            if not tiles.count:
                return
            self.device.fill(self.accumulator.disagreeing, 0)
            yield from tiles.probing(kernel, batch, **self._bound(look_up))
        were_lit = self.accumulator.tile_states == STATE_LIT
        reopened = self.accumulator.reopen(turns.skipped_by(index, part))
        eye.want_also(reopened)
        turns.begin_late(index, part, reopened, were_lit)

    def _compiling(self, *flags: str) -> Generator[None, None, ComputeKernel]:
        return compiling(self.device, self.look_up, *self.resolve_flags, *flags)

    def _bound(self, look_up: dict[str, Any]) -> dict[str, Any]:
        """What of a round this light's kernel is bound to; finding tiles' faces takes other parts of it."""
        return {name: bound for name, bound in look_up.items() if name in self.look_up.binding_names}

    def _free(self) -> None:
        self._owned.close()


def _as_it_casts(light: Light, planned: PlannedPass, scene_data: SceneData) -> Light:
    """Nothing casts for what needs no maps."""
    if light.casts_shadow and not planned.is_sealed:
        return light
    return replace(light, blockers=np.zeros(len(scene_data.snapshot.instances), bool))


def _looked_up_views(fitted: FittedFace, selected: range) -> np.ndarray:
    """`views_table` for looking up: windows of views that need no map, whatever others leave in it, are where no receiver is: of those that
    nothing casts before on one side, of those that know no receiver in this face on the other."""
    table, part = views_table(fitted.views, selected), slice(selected.start, selected.stop)
    table[1::2, 0][~fitted.seen_by_view[part].any(axis=1)] = LIT_WINDOW
    table[1::2, 0][~fitted.has_receivers[part]] = UNKNOWN_WINDOW
    return table


def _taps(planned: PlannedPass, light: Light, plan: RenderPlan) -> LightTaps | None:
    """Of a light with size that has one map."""
    if planned.method is not Method.PCSS or not light.has_size:
        return None
    return LightTaps(light, plan.settings, plan.batch_count * plan.eye_samples_per_batch)


def _views_of_part(view_count: int, part: int, parts: int) -> range:
    """Of a batch's views those that one of its eye samples looks up. These share them evenly; each has all if there are fewer."""
    return range(part * view_count // parts, (part + 1) * view_count // parts) if view_count >= parts else range(view_count)


def _lamp_radius_m(light: Light) -> float:
    """Suns: the chord from their middle to their rim on the unit sphere, where a disc of that radius has as much area as they have solid
    angle"""
    return 2 * math.sin(math.atan(light.size_x_m / 2) / 2) if light.shape is LightShape.SUN else light_radius_m(light)


def _lamp_table(light: Light) -> np.ndarray:
    """(4, 4) rows of `lamp` in LIGHT_HITS"""
    kind = {LightShape.RECTANGLE: 0, LightShape.ELLIPSE: 1, LightShape.SUN: 3}.get(light.shape, 2)
    half_x_m, half_y_m = light.size_x_m / 2, light.size_y_m / 2
    if not light.shape.is_area:
        half_x_m = half_y_m = _lamp_radius_m(light)
    area = 4 * half_x_m * half_y_m if light.shape is LightShape.RECTANGLE else math.pi * half_x_m * half_y_m
    x, y, z, center = light.world_from_light[:3].T
    return np.array([[*center, kind], [*x, half_x_m], [*y, half_y_m], [*-z, area]])
