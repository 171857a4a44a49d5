"""Cubes of reflectors from one cloud of triangles and points a frame (Gavane & Watson 2022, "Improving View Independent Rendering" and
"Eye-Based Point Rendering").

`ivir`: what takes few texels becomes points, as dense as the nearest cube needs them. `epr`: what is small is a splat, clipped by
its triangle; nothing is denser than the eye's pixels on the way by the reflector. Of what is far below a sample both keep only
some, at random, and each cube leaves out more of it the farther away it is: a triangle has one random number for all. What is
large is splatted tile by tile. 64-bit atomics are not used: depths come first and then the smallest number of a triangle at that
depth, the same in every run. Points that are to be shaded themselves are kept, not splatted.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...device.interface import EMPTY_DEPTH_BITS, LINEAR_TEXTURE_WIDTH, Texture, TextureFormat
from ...device.owned import Owned
from ..bounds import SceneBounds, cullable_instances
from ..errors import UsageError
from ..eye_pixels import nearest_pixel_m
from ..passes.reflected_points import (
    COLLECT_REFLECTED,
    COUNTER_COUNT,
    MAX_BATCH_CUBES,
    MAX_CUBES,
    SPLAT_POINTS_OF_CLOUD,
    SPLAT_TILES_OF_CLOUD,
    SPLAT_TRIANGLES_OF_CLOUD,
    TEXELS_PER_POINT,
    TEXELS_PER_TRIANGLE,
    TILE_TEXELS,
)
from ..passes.reflection_maps import ReflectionMap, ReflectionMaps
from ..passes.scene_data import WORK_GROUP_SIZE, WorkTable
from ..passes.shaded_points import CUBES_PER_TEXEL, SMALLEST_CUBE_TEXELS, CubesOfPoints, PointCloud, bytes_per_point
from ..reflections.reflectors import Reflector
from ..settings import ReflectionMethod, ReflectionWords, Settings
from ..steps import compiling
from .linear_store import LinearStore

BATCH_TEXELS = 1 << 22
"""of the cubes that are splatted at once, 8 bytes each; a single cube may have more"""
MAX_TRIANGLES = 1 << 24
"""of a portion: tiles name them by a float32"""
MAX_TILES = (1 << 31) // TILE_TEXELS - 1
"""of a portion: each has an invocation for every row, numbered by an int"""
NOT_COVERED = 0xFFFFFFFF
FIRST_TILE_CAPACITY = 1 << 16
FIRST_POINT_CAPACITY = 1 << 16
BYTES_PER_TEXEL = 16


@dataclass(frozen=True)
class Cube:
    """One of those that share a cloud."""

    number: int
    """among the frame's maps"""
    drawn: ReflectionMap
    eye_pixel_m: float
    """width of the eye's pixels at the cube's centre, less for what the reflector's own size may bring nearer; may be negative"""


@dataclass(frozen=True)
class _Portion:
    """Work groups that are in the cloud together."""

    first_group: int
    group_count: int

    @property
    def halves(self) -> list[_Portion]:
        """the second first"""
        half = self.group_count // 2
        return [_Portion(self.first_group + half, self.group_count - half), _Portion(self.first_group, half)]


@dataclass(frozen=True)
class _Splatted:
    """Where a batch's cubes are."""

    cubes: list[Cube]
    first_texels: np.ndarray
    depths: Texture
    numbers: Texture
    masks: Texture


def clouds(maps: ReflectionMaps, reflectors: Iterable[Reflector], bounds: SceneBounds, settings: Settings) -> list[ReflectedPoints]:
    """Of the cubes that have not been drawn and are not the rasterizer's, one for each method. reflectors: whose maps they are"""
    numbers = {id(each): number for number, each in maps.pending.items() if each.method is not ReflectionMethod.MVR}
    found: dict[ReflectionMethod, list[Cube]] = {}
    for reflector in reflectors:
        corners_ws = bounds.corners_ws[reflector.instances].reshape(-1, 3)
        for drawn in reflector.maps:
            if id(drawn) in numbers:
                eye_pixel_m = nearest_pixel_m(maps.scene_data.eye_pixels, corners_ws, drawn.center_ws)
                found.setdefault(drawn.method, []).append(Cube(numbers[id(drawn)], drawn, eye_pixel_m))
    return [ReflectedPoints(maps, cubes, bounds, settings, method) for method, cubes in found.items()]


class ReflectedPoints:
    def __init__(self, maps: ReflectionMaps, cubes: list[Cube], bounds: SceneBounds, settings: Settings, method: ReflectionMethod) -> None:
        self.maps, self.cubes, self.bounds, self.settings = maps, cubes, bounds, settings
        self.scene_data, self.device = maps.scene_data, maps.device
        self.flags = ["EYE_DENSITY"] * (method is ReflectionMethod.EPR)
        self.collect_flags = [*self.flags, *["POINTS"] * (method is ReflectionMethod.IVIR)]
        self.culling_area = settings.culling_area_texels * settings.stochastic_culling
        self.spacing_scale = settings.points_per_eye_pixel**-0.5
        """of samples, to the width of the eye's pixels"""
        self.triangle_count = 0
        """triangles in the cloud"""
        self.point_count = 0
        self.most_bytes = 0
        """held at a time"""
        self.keeps_points = settings.reflection_words is not ReflectionWords.NUMBERS
        """Points are not splatted here: they are shaded first."""
        if self.keeps_points and len(cubes) > MAX_CUBES:
            # those of a second cloud would take the place of the first one's; plans have 64 reflectors' and 16 groups' at most
            raise UsageError(f"points that are shaded themselves serve {MAX_CUBES} cubes, not {len(cubes)}: choose words of numbers")
        self._kept = Owned()
        self._counts = (0, 0)
        self._held: _Portion | None = None

    def drawing(self) -> Generator[None, None, None]:
        """In steps, on the device's thread."""
        for first in range(0, len(self.cubes), MAX_CUBES):
            yield from self._drawing(self.cubes[first : first + MAX_CUBES])

    def _drawing(self, cubes: list[Cube]) -> Generator[None, None, None]:
        """Those of one cloud."""
        shown = np.unique(np.concatenate([cube.drawn.instances for cube in cubes]))
        opaque = shown[~self.scene_data.cut_out[shown]]
        with Owned() as temporary:
            self.work: WorkTable = temporary.own(self.scene_data.work_table(opaque, np.ones(len(self.scene_data.cut_out), bool)))
            budget_texels = (self.settings.replay_buffer_mib << 20) // (2 * BYTES_PER_TEXEL)
            budget_texels = min(budget_texels, self.device.max_texture_size_px * LINEAR_TEXTURE_WIDTH)
            self._tile_limit = min(budget_texels, MAX_TILES)
            self._limits = min(budget_texels // TEXELS_PER_TRIANGLE, MAX_TRIANGLES), budget_texels // TEXELS_PER_POINT
            self.counters = temporary.own(self.device.create_texture(COUNTER_COUNT, 1, TextureFormat.R32UI))
            self.triangles = temporary.own(LinearStore(self.device, TEXELS_PER_TRIANGLE * min(self.work.triangle_count, self._limits[0])))
            # drivers clear what they hand out: a tenth of a second for a large list
            yield
            self.points = temporary.own(LinearStore(self.device, TEXELS_PER_POINT * FIRST_POINT_CAPACITY))
            yield
            self.tiles = temporary.own(LinearStore(self.device, FIRST_TILE_CAPACITY))
            self._cloud_table = self._table(cubes, np.zeros(len(cubes), np.int64))
            self._cloud_cube_count = len(cubes)
            self._held = None
            portions = yield from self._planning_portions()
            if self.keeps_points:
                self._check_kept(len(portions))
            capacities = self.triangles.texel_count // TEXELS_PER_TRIANGLE, self.points.texel_count // TEXELS_PER_POINT
            rows = [-(-capacity // LINEAR_TEXTURE_WIDTH) for capacity in capacities]
            self._came_first = [temporary.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, each, TextureFormat.R32UI)) for each in rows]
            for batch in _batches(cubes):
                yield from self._drawing_batch(batch, portions)
            if self.keeps_points:
                self._kept = temporary.pop_all()

    def _check_kept(self, portion_count: int) -> None:
        limit = (self.settings.reflection_map_mib << 20) // bytes_per_point(len(self.cubes))
        if portion_count > 1 or self.point_count > limit:
            raise UsageError(
                f"{self.point_count:,} points that are shaded themselves take more memory than "
                f"{self.settings.reflection_map_mib} MiB, as much as maps of reflectors may take: allow more of it, or choose "
                "smaller cubes or words of numbers"
            )

    def points_to_shade(self) -> PointCloud:
        """Where they are kept, once drawn; until `release`."""
        bases = np.concatenate([[0], np.cumsum([each.texel_count for each in self.maps.maps])])
        first_texels = np.array([bases[cube.number] for cube in self.cubes]) // SMALLEST_CUBE_TEXELS
        batches = []
        for first in range(0, len(self.cubes), CUBES_PER_TEXEL):
            part = slice(first, first + CUBES_PER_TEXEL)
            batches.append(CubesOfPoints(self._table(self.cubes[part], first_texels[part]), self._masks(self.cubes[part])))
        numbers = [cube.number for cube in self.cubes]
        table = self._table(self.cubes, first_texels)
        return PointCloud(self.points.texture, self.point_count, self.work.texture, self.culling_area, numbers, table, batches)

    def release(self) -> None:
        self._kept.close()

    def _table(self, cubes: list[Cube], first_texels: np.ndarray) -> np.ndarray:
        """(2 n, 4) rows of CUBES"""
        rows = np.zeros((len(cubes), 2, 4))
        rows[:, 0, :3] = [cube.drawn.center_ws for cube in cubes]
        rows[:, 0, 3] = [2 / cube.drawn.width_px for cube in cubes]
        rows[:, 1, 0] = [cube.drawn.near_m for cube in cubes]
        rows[:, 1, 1] = [cube.eye_pixel_m * self.spacing_scale for cube in cubes]
        rows[:, 1, 2] = first_texels
        rows[:, 1, 3] = [cube.drawn.width_px for cube in cubes]
        return rows.reshape(-1, 4)

    # the cloud

    def _planning_portions(self) -> Generator[None, None, list[_Portion]]:
        kernel = yield from compiling(self.device, COLLECT_REFLECTED, *self.collect_flags)
        if not self.device.has_run(kernel):
            # software rasterizers translate it then, which takes as long as the rest
            self._collect(_Portion(0, 0))
        pending, portions = [_Portion(0, self.work.group_count)], []
        while pending:
            yield
            portion = pending.pop()
            counts = self._collect(portion)
            stores = ((self.triangles, TEXELS_PER_TRIANGLE), (self.points, TEXELS_PER_POINT))
            if any(count > limit for count, limit in zip(counts, self._limits, strict=True)) and portion.group_count > 1:
                pending += portion.halves
                continue
            short = [
                (store, texels * count) for (store, texels), count in zip(stores, counts, strict=True) if texels * count > store.texel_count
            ]
            for store, texel_count in short:
                store.reserve(texel_count)
            if short:
                counts = self._collect(portion)
            portions.append(portion)
            self.triangle_count += counts[0]
            self.point_count += counts[1]
        return portions

    def _collect(self, portion: _Portion) -> tuple[int, int]:
        """Returns how many triangles and points the portion has; the cloud holds them if it has room for them."""
        self.device.fill(self.counters, 0)
        self.device.compute_kernel(COLLECT_REFLECTED, *self.collect_flags).dispatch_linear(
            max(portion.group_count, 1) * WORK_GROUP_SIZE,
            **self.scene_data.bindings,
            work_table=self.work.texture,
            first_group=portion.first_group,
            group_count=portion.group_count,
            counters=self.counters,
            cloud_triangles=self.triangles.texture,
            points=self.points.texture,
            triangle_capacity=self.triangles.texel_count // TEXELS_PER_TRIANGLE,
            point_capacity=self.points.texel_count // TEXELS_PER_POINT,
            cubes=self._cloud_table,
            cube_count=self._cloud_cube_count,
            eye_pixel_angle=self._eye_pixel_angle,
            culling_area=self.culling_area,
        )
        triangle_count, point_count, _ = (int(count) for count in self.device.read(self.counters)[0])
        self._counts, self._held = (triangle_count, point_count), portion
        return self._counts

    @property
    def _eye_pixel_angle(self) -> float:
        return self.scene_data.eye_pixels.angle_rad * self.spacing_scale

    # batches of cubes

    def _drawing_batch(self, cubes: list[Cube], portions: list[_Portion]) -> Generator[None, None, None]:
        sizes = [cube.drawn.face_count * cube.drawn.width_px * cube.drawn.height_px for cube in cubes]
        first_texels = np.cumsum([0, *sizes])
        rows = -(-int(first_texels[-1]) // LINEAR_TEXTURE_WIDTH)
        with Owned() as temporary:
            depths, numbers = (temporary.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, TextureFormat.R32UI)) for _ in range(2))
            masks = temporary.own(self.device.upload_array(self._masks(cubes)))
            self.device.fill(depths, EMPTY_DEPTH_BITS)
            self.device.fill(numbers, NOT_COVERED)
            batch = _Splatted(cubes, first_texels[:-1], depths, numbers, masks)
            portions = yield from self._splatting_depths(batch, portions)
            for portion in portions:
                yield
                self._hold(portion)
                if len(portions) > 1:
                    # depths do not change, but what came first in them is known only of the portion before
                    yield from self._splatting_cloud(batch, is_numbering=False)
                yield from self._splatting_cloud(batch, is_numbering=True)
            lists = [depths, numbers, *self._came_first, *(store.texture for store in (self.triangles, self.points, self.tiles))]
            self.most_bytes = max(self.most_bytes, sum(each.byte_count for each in lists))
            for cube, first_texel in zip(cubes, first_texels, strict=False):
                yield from self.maps.storing_splatted(cube.number, depths, numbers, int(first_texel), self.work.texture)

    def _splatting_depths(self, batch: _Splatted, portions: list[_Portion]) -> Generator[None, None, list[_Portion]]:
        """Returns portions of which none has more tiles in the batch's cubes than there is memory for."""
        pending, fitting = portions[::-1], []
        while pending:
            yield
            portion = pending.pop()
            self._hold(portion)
            if (yield from self._splatting_cloud(batch, is_numbering=False)):
                fitting.append(portion)
            else:
                pending += portion.halves
        return fitting

    def _hold(self, portion: _Portion) -> None:
        if self._held is not portion:
            self._collect(portion)

    def _splatting_cloud(self, batch: _Splatted, *, is_numbering: bool) -> Generator[None, None, bool]:
        """Pauses where a kernel is compiled. Returns False where it has more tiles than it should; then it is not splatted, or not all
        of it."""
        bindings = {
            "cubes": self._table(batch.cubes, batch.first_texels),
            "nearest_depths": batch.depths,
            "nearest_numbers": batch.numbers,
            "is_numbering": int(is_numbering),
        }
        culled = {"cube_masks": batch.masks, "cube_count": len(batch.cubes), "culling_area": self.culling_area}
        yield from compiling(self.device, SPLAT_TRIANGLES_OF_CLOUD, *self.flags)
        if not self._splat_triangles(**bindings, **culled):
            return False
        (yield from compiling(self.device, SPLAT_TILES_OF_CLOUD)).dispatch_linear(
            TILE_TEXELS * self._batch_tile_count,
            **bindings,
            cloud_triangles=self.triangles.texture,
            tiles=self.tiles.texture,
            tile_count=self._batch_tile_count,
        )
        if self._counts[1] and not self.keeps_points:
            (yield from compiling(self.device, SPLAT_POINTS_OF_CLOUD)).dispatch_linear(
                self._counts[1],
                **bindings,
                **culled,
                points=self.points.texture,
                point_count=self._counts[1],
                came_first=self._came_first[1],
            )
        return True

    def _splat_triangles(self, **bindings: Any) -> bool:
        """As of `_splatting_cloud`"""
        while True:
            self.device.fill(self.counters, 0)
            self.device.compute_kernel(SPLAT_TRIANGLES_OF_CLOUD, *self.flags).dispatch_linear(
                self._counts[0],
                **bindings,
                cloud_triangles=self.triangles.texture,
                triangle_count=self._counts[0],
                came_first=self._came_first[0],
                tiles=self.tiles.texture,
                tile_capacity=self.tiles.texel_count,
                counters=self.counters,
                eye_pixel_angle=self._eye_pixel_angle,
            )
            if bindings["is_numbering"]:
                return True
            self._batch_tile_count = int(self.device.read(self.counters)[0, 2])
            if self._batch_tile_count <= self.tiles.texel_count:
                return True
            if self._batch_tile_count > self._tile_limit and self._held is not None and self._held.group_count > 1:
                return False
            self.tiles.reserve(self._batch_tile_count)

    def _masks(self, cubes: list[Cube]) -> np.ndarray:
        """(instance_count, 4): bits of the cubes that leave an instance out, and of those that need not see its back faces"""
        snapshot = self.scene_data.snapshot
        masks = np.zeros((len(snapshot.instances), 4))
        corners = np.array([[(k >> axis & 1) * 2 - 1 for axis in range(3)] for k in range(8)])
        for k, cube in enumerate(cubes):
            is_shown = np.zeros(len(masks), bool)
            is_shown[cube.drawn.instances] = True
            masks[~is_shown, 0] += 1 << k
            # what reaches within the near planes is cut open there
            eyes_ws = cube.drawn.center_ws + cube.drawn.near_m * corners
            masks[cullable_instances(snapshot, self.bounds, eyes_ws), 1] += 1 << k
        return masks


def _batches(cubes: list[Cube]) -> Iterator[list[Cube]]:
    batch: list[Cube] = []
    texel_count = 0
    for cube in cubes:
        own = cube.drawn.face_count * cube.drawn.width_px * cube.drawn.height_px
        if batch and (len(batch) == MAX_BATCH_CUBES or texel_count + own > BATCH_TEXELS):
            yield batch
            batch, texel_count = [], 0
        batch.append(cube)
        texel_count += own
    if batch:
        yield batch
