"""The reflections' share of the streamed loop: maps of the reflectors once a frame; rays, what they meet and its light in every round."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...device.interface import ComputeKernel, Device, Texture, TextureFormat
from ...device.owned import Owned
from ..material_program import typical_value
from ..methods.reflected_points import ReflectedPoints, clouds
from ..pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME, ReflectionStatistics
from ..passes.accumulate import ERROR_TILE_PX
from ..passes.emitters import Emitters
from ..passes.eye import EyePass, GBuffer
from ..passes.needed_texels import FILTER_NEEDED, MARK_NEEDED, NEEDED_SURFACES, NeededMarks, NeededPlaces
from ..passes.reflection_maps import BYTES_PER_TEXEL, ReflectionMaps
from ..passes.reflections import (
    ADD_REFLECTIONS,
    HIT_MATERIALS,
    LIGHT_BY_EMITTERS,
    LIGHT_BY_SURROUNDINGS,
    LIGHT_HITS,
    MARCH_REFLECTIONS,
    NO_RAY,
    REFLECT,
    REFLECTED_BEHIND,
    REFLECTED_BY_DIRECTION,
    REFLECTED_NOTHING,
    REFLECTED_OUT_OF_VIEW,
    REFLECTED_SURFACE,
    REFLECTION_ERROR,
    SHOW_REFLECTIONS,
)
from ..passes.scene_data import SceneData
from ..passes.shaded_maps import FILL_TEXELS, LOOK_UP_SHADED, TEXEL_SURFACES, ShadedMaps, ShadedPlaces
from ..passes.shaded_points import ShadedPoints
from ..passes.surface_data import SurfaceData
from ..passes.tiles import TILE_PX, Tiles, grid_shape, spread_to_pixels, with_neighbours
from ..picture import Shown
from ..plan import RenderPlan
from ..sampling import pixel_offsets, poisson_offsets, shuffled_unit_square_points, stable_seed
from ..settings import ADAPTIVE_STEP, RECURSIVE_SAMPLES, ReflectionFilter, ReflectionLookUp, ReflectionMethod
from ..steps import Allocation, HostWork, Steps, compiling
from ..stopwatch import Stopwatch
from .reflector_passes import ReflectorPasses
from .reflectors import PlannedReflections, bytes_per_texel, memory_for_maps, reflects, with_met
from .rounds import samples_per_round
from .seen_places import SeenPlaces

DRAWN = (Shown.REFLECTION, Shown.REFLECTION_COLOR, Shown.REFLECTED)
"""as numbered for SHOW_REFLECTIONS"""
FITTED_BATCHES = 4
"""that lights' maps are fitted to, where rough surfaces send rays elsewhere in each"""
LEAST_SETTLING_VIEWS = 4
"""of a light: a pixel whose rays agree after fewer has the noise of these few, which all rays of a batch share"""
PLACES_MARGIN = 1.1
"""room for places that other rounds' samples need: a little more or less than the first's"""
MAX_FITTED_HITS = 1 << 23
"""places that are kept of them"""


@dataclass(frozen=True)
class Hits:
    """What the rays of one bounce met, of one of a batch's eye samples."""

    part: int
    buffer: GBuffer
    seen_from: Texture
    """positions of where the rays began"""
    scatterings: Texture
    glosses: Texture
    sums: Texture
    """what a light brings, as RESOLVE sums it over faces"""
    texels: ShadedPlaces | None = None
    """where they are those of maps or points, not of rays"""


class ReflectionWork:
    def __init__(
        self,
        planned: PlannedReflections,
        plan: RenderPlan,
        scene_data: SceneData,
        surfaces: SurfaceData,
        emitters: Emitters,
        eye: EyePass,
    ) -> None:
        self.plan, self.scene_data, self.eye = plan, scene_data, eye
        self.device: Device = scene_data.device
        width, height = self.size = eye.size
        parts = range(plan.eye_samples_per_batch)
        self.round_count = 0
        self._is_counted = False
        self.of_reflectors: ReflectorPasses | None = None
        """where asked for, from the first round on"""
        self.tiles_shown = np.zeros(grid_shape(width, height), bool)
        """(rows, columns) of the picture that show a reflector"""
        round_count = plan.batch_count * len(parts)
        self.is_lazy = plan.settings.reflection_look_up is ReflectionLookUp.LAZY
        self.samples_per_round = samples_per_round(plan.settings, round_count)
        """rays of a pixel, one after another in what follows"""
        ray_count = round_count * self.samples_per_round
        sequences = [shuffled_unit_square_points(ray_count, stable_seed(f"reflection {k}")) for k in range(2 * planned.bounces)]
        self.samples = np.stack(sequences, axis=1).reshape(ray_count, 2, planned.bounces, 2)
        """of facets and of directions that light comes from: (rays, 2, bounces, 2)"""
        snapshot = surfaces.snapshot
        self.filter = plan.settings.reflection_filter
        self.is_adaptive = self.filter is ReflectionFilter.ADAPTIVE
        self.places_px = np.zeros((ray_count, 2))
        """(rays, 2) where in their pixels rays are from, but for those that are from where the eye's samples are"""
        if self.filter is not ReflectionFilter.EYE:
            self.places_px = poisson_offsets(snapshot.pixel_filter, ray_count)
        self.offsets_px = pixel_offsets(snapshot.pixel_filter, plan.eye_sample_count)
        self.recursive_rounds = _recursive_rounds(self.filter, round_count)
        self.least_rounds = len(parts) * _least_batches(plan)
        """before which no pixel settles"""
        self._followed = [0] * len(parts)
        """bounces of each part's round"""
        self.statistics = ReflectionStatistics(bounces=planned.bounces)
        self.hits: list[list[Hits]] = []
        """from `preparing` on, as what else rays are kept in: of each of a batch's eye samples, bounce by bounce"""
        zeros = np.zeros((height, width, 4), np.float32)
        self._emitters, self.emitter_count = emitters, emitters.triangle_count
        self._lit_tiles: dict[tuple[int, ShadedPlaces | None], Tiles] = {}
        self._drawn = Owned()
        """maps, which instances have which, and what shines"""
        with Owned() as owned:
            self.materials = owned.own(surfaces.share())
            self.settled = owned.own(self.device.upload_texture(zeros if self.is_adaptive else zeros[:1, :1]))
            self.sums = {name: owned.own(self.device.upload_texture(zeros)) for name in ("radiance_sums", "color_sums")}
            # made beforehand: errors are asked for when a render is closed, also one that ended because there is no memory
            tiles = (-(-width // ERROR_TILE_PX), -(-height // ERROR_TILE_PX))
            self._error_sums = owned.own(self.device.create_texture(*tiles, TextureFormat.RGBA32F))
            owned.callback(self._forget_maps)
            self._use(planned)
            self.tiles = Tiles(self.device, np.ones(self.tiles_shown.shape, bool))
            self.texel_hits: list[Hits] = []
            """where maps are shaded whole: of their texels and, where there are such, of points"""
            self.shaded_maps: ShadedMaps | None = None
            self.shaded_points: ShadedPoints | None = None
            self.kept_points: ReflectedPoints | None = None
            """to be shaded themselves"""
            self.marks: NeededMarks | None = None
            """with `is_lazy`, as what follows"""
            self.places: NeededPlaces | None = None
            self._of_samples: dict[str, object] = {}
            """what both walks over a round's samples take"""
            self._of_places = Owned()
            owned.callback(self._forget_places)
            self._owned = owned.pop_all()

    def _allocating(self) -> Generator[None, None, None]:
        """Create what rays are kept in."""
        width, height = self.size
        create, allocation = self.device.create_texture, Allocation(self._owned)

        def keeping() -> Generator[None, None, Texture]:
            return allocation.keeping(create, width, height, TextureFormat.RGBA32F)

        parts, zeros = range(self.plan.eye_samples_per_batch), np.zeros((height, width, 4), np.float32)
        self.rays: dict[str, Texture] = {}
        for name in ("ray_origins", "ray_directions", "throughputs"):
            self.rays[name] = yield from keeping()
        self.surfaces = yield from keeping()
        self.radiances: list[Texture] = []
        self.colors: list[Texture] = []
        for part in parts:
            self.radiances.append((yield from keeping()))
            self.colors.append((yield from keeping()))
            self.hits.append([])
            seen_from = self.eye.buffers[part].positions
            for _ in range(self.planned.bounces):
                # RESOLVE asks for neighbours, and beyond the tiles nothing is written
                normals = yield from allocation.keeping(self.device.upload_texture, zeros)
                buffer = GBuffer((yield from keeping()), normals)
                hits = Hits(part, buffer, seen_from, (yield from keeping()), (yield from keeping()), (yield from keeping()))
                self.hits[part].append(hits)
                seen_from = buffer.positions

    def drawing_maps(self, stopwatch: Stopwatch) -> Steps:
        return stopwatch.stages("reflection maps", self._drawing())

    def _drawing(self) -> Generator[None, None, None]:
        """Maps that have not been drawn; those that are splatted share a cloud."""
        yield from self.maps.drawing()
        for cloud in clouds(self.maps, self.planned.reflectors, self.plan.bounds, self.plan.settings):
            yield from cloud.drawing()
            self.statistics.cloud_triangle_count += cloud.triangle_count
            self.statistics.point_count += cloud.point_count
            if cloud.keeps_points and cloud.point_count:
                self.kept_points = self._drawn.own(cloud)
        self.maps.end_drawing()

    def _use(self, planned: PlannedReflections, drawn_before: ReflectionMaps | None = None) -> None:
        """drawn_before: the first of the maps"""
        with Owned() as owned:
            maps = owned.own(ReflectionMaps(self.scene_data, self.plan.bounds, planned.maps, *planned.other_maps(), drawn_before))
            instance_count = len(self.scene_data.snapshot.instances)
            instance_maps = owned.own(self.device.upload_array(planned.instance_maps(instance_count)))
            table = owned.own(self.device.upload_array(self._emitters.beside_maps(planned.maps_without(instance_count))))
            self._forget_maps()
            self._drawn = owned.pop_all()
        self.planned, self.maps, self.instance_maps, self.emitters = planned, maps, instance_maps, table
        self.statistics.map_count = len(planned.maps)
        self.statistics.map_texel_count = sum(each.texel_count for each in planned.maps)
        self.statistics.map_bytes = self.statistics.map_texel_count * bytes_per_texel(self.plan.settings)
        self.statistics.look_up = self.plan.settings.reflection_look_up.value
        self.statistics.splatted_map_count = sum(each.method is not ReflectionMethod.MVR for each in planned.maps)

    def _forget_maps(self) -> None:
        self._drawn.close()

    def preparing(self, offsets: list[int], stopwatch: Stopwatch) -> Steps:
        """Draw maps and trace the first batch: what shows of other reflectors decides which of these have maps. offsets: as of `tracing`"""
        yield from stopwatch.stages("upload", self._allocating())
        while True:
            yield from self.drawing_maps(stopwatch)
            if self.is_lazy:
                yield from compiling(self.device, FILL_TEXELS)
                yield from compiling(self.device, NEEDED_SURFACES)
                self.marks = self._owned.own(NeededMarks(self.maps, self._seen_maps))
            elif self.plan.settings.reflection_look_up is ReflectionLookUp.SHADED:
                yield from compiling(self.device, FILL_TEXELS)
                yield from compiling(self.device, TEXEL_SURFACES)
                with stopwatch.stage("reflection maps"):
                    self._shade_texels()
            yield from self.tracing(offsets, 0, stopwatch)
            if self.planned.bounces == 1 or not self.planned.waiting:
                break
            with stopwatch.stage("read-back"):
                waiting = np.zeros(len(self.scene_data.snapshot.instances), bool)
                waiting[np.concatenate([each.instances for each in self.planned.waiting])] = True
                places = [self.read_hits(hits)[0] for hits in self.all_hits if hits is not self.hits[hits.part][-1]]
                hits = SeenPlaces(places, waiting, len(self.hits))
            settings = memory_for_maps(self.device, self.plan.settings)
            met = self.planned, self.scene_data.snapshot, self.plan.bounds, settings, hits
            planned: PlannedReflections = yield stopwatch.host_work("fit", with_met, *met)
            if planned is self.planned:
                break
            self._use(planned, self.maps)
            self._is_counted = False
        self.statistics.reflectors = self.planned.settled().texts

    def find_tiles(self, seen: Sequence[np.ndarray]) -> None:
        """Work only where a reflector is, or may be at other sub-pixel offsets. seen: instances of some eye G-buffers, (height, width)
        each, -1: none"""
        shows = self.planned.instance_maps(len(self.scene_data.snapshot.instances))[:, 0] >= 0
        pixels = np.logical_or.reduce([(each >= 0) & shows[np.maximum(each, 0).astype(np.int64)] for each in seen])
        rows, columns = self.tiles_shown.shape
        padded = np.zeros((rows * TILE_PX, columns * TILE_PX), bool)
        padded[: pixels.shape[0], : pixels.shape[1]] = pixels
        self.tiles_shown = with_neighbours(padded.reshape(rows, TILE_PX, columns, TILE_PX).any(axis=(1, 3)))
        tiles = Tiles(self.device, self.tiles_shown)
        self.tiles.release()
        self.tiles = tiles

    def _shade_texels(self) -> None:
        """From now on what the maps for what the eye sees show is what lights are looked up for."""
        maps = self.shaded_maps = self._owned.own(ShadedMaps(self.maps, self._seen_maps))
        maps.find_surfaces()
        places: list[ShadedPlaces] = [maps]
        if self.kept_points is not None:
            words = self.plan.settings.reflection_words
            points = self.shaded_points = self._owned.own(ShadedPoints(maps, self.kept_points.points_to_shade(), words))
            points.find_surfaces()
            places.append(points)
            self.statistics.map_bytes += points.byte_count
        self.texel_hits = [_hits_of_places(each) for each in places]

    @property
    def _seen_maps(self) -> set[int]:
        """numbers of the maps for what the eye sees"""
        own = self.planned.instance_maps(len(self.scene_data.snapshot.instances))[:, 0]
        return {int(number) for number in own if number >= 0}

    def lit_tiles(self, turn: int, hits: Hits) -> Tiles:
        """The hits' tiles for RESOLVE. turn: as of TURN_DEFINES"""
        key = turn, hits.texels
        if key not in self._lit_tiles:
            owned = self._owned if self.places is None else self._of_places
            shown = self.tiles_shown if hits.texels is None else hits.texels.is_used
            numbers = np.broadcast_to((float(turn), 0.0), (*shown.shape, 2))
            self._lit_tiles[key] = owned.own(Tiles(self.device, shown, numbers))
        return self._lit_tiles[key]

    def tracing(self, offsets: list[int], batch: int, stopwatch: Stopwatch) -> Steps:
        """Rays of a batch's eye samples, kernel by kernel: some take a second to compile. offsets: numbers of their sub-pixel offsets"""
        for part, offset in enumerate(offsets):
            seen = {**self.eye.buffers[part]._asdict(), "surfaces": self.eye.triangles[part]}
            round_number = batch * len(offsets) + part
            self._followed[part] = self.planned.bounces if self.recursive_rounds[round_number] else 1
            if self.plan.settings.reflection_look_up.shades_texels:
                reflecting = (
                    self._marking(seen, offset, round_number) if self.is_lazy else self._reflecting(seen, part, 0, offset, round_number)
                )
                yield from stopwatch.stages("reflect", reflecting)
                for hits in self.texel_hits:
                    yield from stopwatch.stages("reflect", self._meeting(hits, 0, round_number))
                continue
            for bounce, hits in enumerate(self._hits_of(part)):
                yield from stopwatch.stages("reflect", self._reflecting(seen, part, bounce, offset, round_number))
                yield from stopwatch.stages("reflect", self._meeting(hits, bounce, round_number))
                seen = {**hits.buffer._asdict(), "surfaces": self.surfaces}

    def _reflecting(self, seen: dict[str, Texture], part: int, bounce: int, offset: int, round_number: int) -> Generator[None, None, None]:
        """seen: the surfaces that reflect"""
        facet, _ = self.samples[round_number % len(self.samples), :, bounce]
        place_px = self.places_px[round_number % len(self.places_px)] - self.offsets_px[offset]
        how = [] if bounce else ["FROM_EYE", *["FILTERED"] * (self.filter is not ReflectionFilter.EYE), *self._adaptive_flags]
        yield from self._walking(
            (yield from compiling(self.device, REFLECT, *self.materials.flags, *how)),
            **self.scene_data.bindings,
            **self.materials.bindings,
            **seen,
            **self.rays,
            corner_normals=self.scene_data.corner_normals,
            instance_maps=self.instance_maps,
            colors=self.colors[part],
            bounce=bounce,
            sample_x=facet[0],
            sample_y=facet[1],
            place_x=place_px[0],
            place_y=place_px[1],
            share=len(self.recursive_rounds) / self.recursive_rounds.sum() if bounce == 1 else 1.0,
            settled=self.settled,
            eye=self.eye.eye_table(offset),
        )
        yield

    def _marking(self, seen: dict[str, Texture], offset: int, round_number: int) -> Generator[None, None, None]:
        """Which texels the samples of a round need, and what these see. seen: as of `_reflecting`"""
        assert self.marks is not None
        rays = slice(round_number * self.samples_per_round, (round_number + 1) * self.samples_per_round)
        self._of_samples = {
            **self.scene_data.bindings,
            **self.materials.bindings,
            **seen,
            "corner_normals": self.scene_data.corner_normals,
            "instance_maps": self.instance_maps,
            "map_headers": self.maps.headers,
            "map_texels": self.maps.texels,
            "places_per_pixel": self.plan.settings.points_per_eye_pixel,
            "eye": self.eye.eye_table(offset),
            "samples": np.hstack([self.places_px[rays] - self.offsets_px[offset], self.samples[rays, 0, 0]]),
            "sample_count": self.samples_per_round,
        }
        self.marks.clear()
        kernel = yield from compiling(self.device, MARK_NEEDED, *self.materials.flags)
        marked = {"needed": self.marks.texture, "colors": self.colors[0]}
        yield from self._walking(kernel, **self._of_samples, **marked)
        yield
        texels = self.marks.read()
        count = sum(len(each) for each in texels.values())
        if self.places is None or count > self.places.capacity:
            self._forget_places()
            self.places = self._of_places.own(NeededPlaces(self.marks, math.ceil(PLACES_MARGIN * count)))
            self.texel_hits = [_hits_of_places(self.places)]
            self.statistics.map_bytes = self._lazy_bytes
        self.places.find_surfaces(texels)
        yield

    @property
    def _lazy_bytes(self) -> int:
        """of maps, marks and places"""
        assert self.marks is not None and self.places is not None
        return self.statistics.map_texel_count * BYTES_PER_TEXEL + self.marks.texture.byte_count + self.places.byte_count

    def _forget_places(self) -> None:
        self._of_places.close()
        self._lit_tiles.clear()

    def _meeting(self, hits: Hits, bounce: int, round_number: int) -> Generator[None, None, None]:
        """What rays meet, or what was met before by all texels or points, and what surroundings bring to it."""
        flags = ["BY_DIRECTION"] * (self.plan.settings.reflection_look_up is not ReflectionLookUp.MARCH)
        part, texels = hits.part, hits.texels
        _, light = self.samples[round_number * self.samples_per_round % len(self.samples), :, bounce]
        rays, radiances = (self.rays, self.radiances[part]) if texels is None else (texels.rays, texels.radiances)
        seen = {**hits.buffer._asdict(), "surfaces": self.surfaces if texels is None else texels.surfaces}
        if texels is None:
            yield from self._walking(
                (yield from compiling(self.device, MARCH_REFLECTIONS, *flags)),
                **self.scene_data.bindings,
                **self.maps.bindings,
                **seen,
                **rays,
                corner_normals=self.scene_data.corner_normals,
            )
            yield
        yield from self._walking(
            (yield from compiling(self.device, HIT_MATERIALS, *self.materials.flags, *self.materials.world_flags)),
            texels,
            **self.scene_data.bindings,
            **self.materials.bindings,
            **seen,
            corner_normals=self.scene_data.corner_normals,
            ray_directions=rays["ray_directions"],
            throughputs=rays["throughputs"],
            instance_maps=self.instance_maps,
            scatterings=hits.scatterings,
            glosses=hits.glosses,
            radiances=radiances,
            bounce=bounce,
        )
        if not self._is_counted:
            self._count_found()
        if not self.plan.has_surroundings:
            return
        around: dict[str, object] = {
            **self.scene_data.bindings,
            **self.materials.bindings,
            **self.maps.bindings,
            **hits.buffer._asdict(),
            **rays,
            "scatterings": hits.scatterings,
            "glosses": hits.glosses,
            "radiances": radiances,
            "emitters": self.emitters,
            "instance_maps": self.instance_maps,
            "bounce": bounce + self.planned.bounces,
            "is_last": int(bounce == self.planned.bounces - 1),
            "sample_x": light[0],
            "sample_y": light[1],
        }
        yield
        shown = [*self.materials.world_flags, *self.materials.emission_flags, *["EMISSION"] * self.materials.has_emission]
        yield from self._walking((yield from compiling(self.device, LIGHT_BY_SURROUNDINGS, *shown, *flags)), texels, **around)
        if self.emitter_count:
            yield
            yield from self._walking(
                (yield from compiling(self.device, LIGHT_BY_EMITTERS, *self.materials.emission_flags)),
                texels,
                **around,
                instance_count=len(self.scene_data.snapshot.instances),
                emitter_count=self.emitter_count,
            )

    def _walking(self, kernel: ComputeKernel, texels: ShadedPlaces | None = None, /, **bindings: object) -> Generator[None, None, None]:
        """The picture, or texels of maps."""
        walked = self if texels is None else texels
        width, height = walked.size
        return walked.tiles.walking(kernel, width=width, height=height, **bindings)

    def _count_found(self) -> None:
        """What became of the first rays, those of one eye sample."""
        self._is_counted = True
        if self.texel_hits:
            reflects = self.device.read(self.colors[0])[..., 3] > 0
            self.statistics.ray_count = int(reflects[spread_to_pixels(self.tiles_shown, *self.size)].sum()) * self.samples_per_round
            self.statistics.by_direction_share = 1.0
            self.statistics.shaded_count = sum(hits.texels.count_shaded() for hits in self.texel_hits if hits.texels is not None)
            return
        found = self.device.read(self.surfaces)[..., 3].astype(np.int64)
        shown = found[spread_to_pixels(self.tiles_shown, *self.size)]
        counts = np.bincount(shown, minlength=REFLECTED_BEHIND + 1)
        ray_count = int(counts.sum() - counts[NO_RAY])
        self.statistics.ray_count = ray_count
        self.statistics.found_share = float(counts[REFLECTED_SURFACE] / max(ray_count, 1))
        self.statistics.by_direction_share = float(counts[REFLECTED_BY_DIRECTION] / max(ray_count, 1))
        self.statistics.behind_share = float(counts[REFLECTED_BEHIND] / max(ray_count, 1))
        self.statistics.shaded_count = int(counts[[REFLECTED_SURFACE, REFLECTED_BY_DIRECTION, REFLECTED_BEHIND]].sum())
        self.statistics.left_share = float((counts[REFLECTED_NOTHING] + counts[REFLECTED_OUT_OF_VIEW]) / max(ray_count, 1))

    @property
    def _adaptive_flags(self) -> list[str]:
        return ["ADAPTIVE"] * self.is_adaptive

    def mean_ray_count(self) -> float:
        """First rays of a pixel that shows a reflector, so far."""
        if not self.is_adaptive:
            return float(self.round_count * self.samples_per_round)
        shown = self.device.read(self.sums["color_sums"])[..., 3] > 0
        settled = self.device.read(self.settled)[shown, 0]
        return float(np.where(settled > 0, settled, self.round_count).mean()) if len(settled) else 0.0

    def read_hits(self, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
        """(height, width, 4) positions and normals; what lies outside of the tiles was never written, and is background"""
        if hits.texels is not None:
            return self.device.read(hits.buffer.positions), self.device.read(hits.buffer.normals)
        width, height = self.size
        positions = self.device.read(hits.buffer.positions).copy()
        positions[~spread_to_pixels(self.tiles_shown, width, height)] = (0.0, 0.0, 0.0, -1.0)
        return positions, self.device.read(hits.buffer.normals)

    def gathering_hits(
        self, offsets: list[int], stopwatch: Stopwatch
    ) -> Generator[HostWork | None, Any, tuple[list[np.ndarray], list[np.ndarray]]]:
        """Positions and normals, as of `read_hits`, of all that the first batch's rays meet and, from rough surfaces, those of some other
        batches. Leaves the first batch traced."""
        batches = [0]
        if any(reflects(each) and typical_value(each.roughness).max() > 0 for each in self.scene_data.snapshot.materials):
            # the sequence is even: these are spread over the lobe
            batches = [k * self.plan.batch_count // FITTED_BATCHES for k in range(min(FITTED_BATCHES, self.plan.batch_count))]
        positions, normals = [], []
        width, height = self.size
        step = max(1, math.isqrt(width * height * len(batches) * len(self.hits) * self.planned.bounces // MAX_FITTED_HITS))
        for batch in [*batches[1:], 0]:
            if len(batches) > 1:
                yield from self.tracing(offsets, batch, stopwatch)
            for hits in self.all_hits:
                with stopwatch.stage("read-back"):
                    pair = self.read_hits(hits)
                positions.append(pair[0][::step, ::step].copy())
                normals.append(pair[1][::step, ::step].copy())
                yield None
        return positions, normals

    @property
    def all_hits(self) -> Iterator[Hits]:
        """Of the current batch."""
        for part in range(len(self.hits)):
            yield from self._hits_of(part)

    def _hits_of(self, part: int) -> list[Hits]:
        return self.texel_hits or self.hits[part][: self._followed[part]]

    def adding_light(self, hits: Hits, flags: list[str], **light: object) -> Generator[None, None, None]:
        """flags, light: of LIGHT_HITS"""
        yield from self._walking(
            (yield from compiling(self.device, LIGHT_HITS, *flags)),
            hits.texels,
            **hits.buffer._asdict(),
            seen_from=hits.seen_from,
            scatterings=hits.scatterings,
            glosses=hits.glosses,
            batch_sums=hits.sums,
            radiances=self.radiances[hits.part] if hits.texels is None else hits.texels.radiances,
            **light,
        )

    def end_batch(self, stopwatch: Stopwatch) -> None:
        """All lights are in: add the batch's rounds to the passes."""
        width, height = self.size
        with stopwatch.stage("reflect"):
            if self.marks is not None and self.places is not None:
                kernel = self.device.compute_kernel(FILTER_NEEDED, *self.materials.flags, *self.materials.world_flags)
                shown = {"needed": self.marks.texture, "shown": self.places.radiances, "radiances": self.radiances[0]}
                self.tiles.dispatch(kernel, width=width, height=height, **self._of_samples, **shown)
            if self.shaded_maps is not None:
                texels = self.shaded_maps
                if self.shaded_points is not None:
                    self.shaded_points.splat()
                texels.make_levels()
                of_maps = {"map_headers": self.maps.headers, "shaded": texels.radiances}
                kernel = self.device.compute_kernel(LOOK_UP_SHADED)
                self.tiles.dispatch(kernel, width=width, height=height, **of_maps, **self.rays, radiances=self.radiances[0])
            kernel = self.device.compute_kernel(ADD_REFLECTIONS, *self._adaptive_flags)
            for part, (radiances, colors) in enumerate(zip(self.radiances, self.colors, strict=True)):
                sums = {**self.sums, "settled": self.settled, "round_number": self.round_count, "least_rounds": self.least_rounds}
                self.tiles.dispatch(kernel, width=width, height=height, radiances=radiances, colors=colors, **sums)
                self.round_count += 1
                if self.plan.settings.per_reflector:
                    self._add_to_reflectors(part)

    def _add_to_reflectors(self, part: int) -> None:
        if self.of_reflectors is None:
            snapshot = self.scene_data.snapshot
            self.of_reflectors = ReflectorPasses(snapshot, self.planned.instance_maps(len(snapshot.instances))[:, 0] >= 0)
        instances = self.device.read(self.eye.buffers[part].positions)[..., 3]
        radiances, colors = (self.device.read(textures[part]) for textures in (self.radiances, self.colors))
        self.of_reflectors.add(radiances, colors, instances, spread_to_pixels(self.tiles_shown, *self.size))

    def draw(self, picture: Texture, shown: Shown) -> None:
        """Into a texture of the picture's size."""
        width, height = self.size
        self.device.compute_kernel(SHOW_REFLECTIONS).dispatch_grid(
            self.size,
            **self.sums,
            picture=picture,
            width=width,
            height=height,
            round_count=max(self.round_count, 1),
            shown=DRAWN.index(shown if shown is not Shown.ALL else Shown.REFLECTED),
        )

    def compute_error(self) -> float:
        """RMS over pixels that show a reflector of the standard error of the luminance that reflections add to the picture; infinite
        before there are two rounds."""
        if self.round_count < 2:
            return math.inf
        width, height = self.size
        self.device.compute_kernel(REFLECTION_ERROR, *self._adaptive_flags).dispatch_grid(
            (self._error_sums.width, self._error_sums.height),
            **self.sums,
            settled=self.settled,
            tile_sums=self._error_sums,
            width=width,
            height=height,
            round_count=self.round_count,
        )
        squared, count = self.device.read(self._error_sums)[..., :2].astype(np.float64).sum(axis=(0, 1))
        return math.sqrt(squared / count) if count else 0.0

    def read(self) -> dict[str, np.ndarray]:
        """Pass name -> (height, width, 3) float32"""
        radiance, color = (self.device.read(self.sums[name])[..., :3] for name in ("radiance_sums", "color_sums"))
        reflection = np.divide(radiance, color, out=np.zeros_like(radiance), where=color > 0)
        of_reflectors = {} if self.of_reflectors is None else self.of_reflectors.read(self.round_count)
        return {REFLECTION_PASS_NAME: reflection, REFLECTION_COLOR_PASS_NAME: color / max(self.round_count, 1), **of_reflectors}

    def release(self) -> None:
        self.tiles.release()
        self._owned.close()


def _hits_of_places(places: ShadedPlaces) -> Hits:
    buffer = GBuffer(places.positions, places.normals)
    return Hits(0, buffer, places.rays["ray_origins"], places.scatterings, places.glosses, places.sums, places)


def _least_batches(plan: RenderPlan) -> int:
    """Of which every light has shown LEAST_SETTLING_VIEWS of its views, or all that it has."""
    counts = [planned.view_count for planned in (*plan.passes, *plan.reflected_lights) if planned.runs and planned.view_count]
    # of fewer views than batches each batch has one
    return max((math.ceil(min(count, LEAST_SETTLING_VIEWS) / max(count / plan.batch_count, 1.0)) for count in counts), default=0)


def _recursive_rounds(kind: ReflectionFilter, round_count: int) -> np.ndarray:
    """(round_count,) bool: whose rays go on from what they met"""
    follows = np.ones(round_count, bool)
    if kind is ReflectionFilter.POISSON and round_count > RECURSIVE_SAMPLES:
        follows[:] = False
        follows[np.arange(RECURSIVE_SAMPLES) * round_count // RECURSIVE_SAMPLES] = True
    elif kind is ReflectionFilter.ADAPTIVE:
        # as large a share of them, whenever a pixel settles
        follows = np.arange(round_count) % ADAPTIVE_STEP == 0
    return follows
