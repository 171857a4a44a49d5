"""Points that are shaded themselves and splatted with their colours, as published (Gavane & Watson 2022, "Improving View Independent
Rendering", section 5.1): bits of the views that see each, and words of what the texels of cubes show.

point_views   ceil(cubes / CUBES_PER_TEXEL) texels a point: a bit for every face of every cube, FACES_PER_CHANNEL to a channel
words         of every texel of the maps, laid out as they are: 13 bits of depth above 19 of colour, or 32 of colour where `depths` has
              32 of depth; EMPTY_WORD: no point is seen

What is too large for points is in the maps already: its texels are shaded as those of other shaded maps are, and points stand before them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table
from ...device.interface import LINEAR_TEXTURE_WIDTH, Texture, TextureFormat
from ..settings import ReflectionWords
from .reflected_points import CUBE_COUNT, CUBES, CULLING_AREA, MAX_CUBES, POINTS_TEXT, SPLAT_TRIANGLES_OF_CLOUD, TEXELS_PER_POINT
from .reflection_maps import BYTES_PER_TEXEL, HEADER_DEFINE, MAP_LEVELS, MAP_NUMBER, MAP_SIZE_STEP_PX, MAP_TEXTURES
from .reflections import DIRECTIONS, NORMALS, ORIGINS, POSITIONS, REFLECTED_BY_DIRECTION, SURFACES, THROUGHPUTS
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE
from .shaded_maps import SHADED_BYTES_PER_TEXEL, SHADED_TEXT, TEXEL_SURFACES, ShadedMaps, ShadedPlaces
from .shadow_maps import WORK_TABLE
from .tiles import TILE_PX, grid_shape

FACES_PER_CHANNEL = 24
"""bits that a float32 holds"""
CUBES_PER_TEXEL = 4 * FACES_PER_CHANNEL // 6
EMPTY_WORD = 0xFFFFFFFF
STEPS = 8190
"""of depth in packed words, as lib/words.glsl has them"""
SMALLEST_CUBE_TEXELS = sum(6 * MAP_SIZE_STEP_PX**2 >> 2 * level for level in range(MAP_LEVELS))
"""of all levels; those of wider ones are multiples of it, which float32 tells apart"""

POINT_COUNT = Constant("int", "points in the cloud")
POINTS = Sampled("sampler2D", POINTS_TEXT)
VIEW_CONSTANTS = {
    "view_texels": Constant("int", "texels of bits a point"),
    "view_texel": Constant("int", "which of them is the batch's"),
}
VIEWS_TEXT = "bits of the views that see a point"
WORDS_TEXT = "a word of every texel of every map"
SHOWN = Sampled("sampler2D", "light that the places show")

POINT_SURFACES = ComputeDeclaration(
    name="point_surfaces",
    text="points of the cloud as places to be shaded",
    source="point_surfaces.comp.glsl",
    textures={
        **SCENE_TEXTURES,
        "corner_normals": TEXEL_SURFACES.textures["corner_normals"],
        "work_table": WORK_TABLE,
        "points": POINTS,
    },
    images={
        "positions": Stored("RGBA32F", "write", POSITIONS),
        "normals": Stored("RGBA32F", "write", NORMALS),
        "surfaces": Stored("RGBA32F", "write", SURFACES),
        "ray_origins": Stored("RGBA32F", "write", ORIGINS),
        "ray_directions": Stored("RGBA32F", "write", DIRECTIONS),
        "throughputs": Stored("RGBA32F", "write", THROUGHPUTS),
    },
    constants={"point_count": POINT_COUNT, "cube_count": CUBE_COUNT},
    tables={"cubes": CUBES, "map_numbers": Table(MAX_CUBES // 4, "numbers of the cubes among all maps, four a row")},
    defines={**SCENE_DEFINES, "WORK_GROUP_SIZE": WORK_GROUP_SIZE, "REFLECTED_BY_DIRECTION": REFLECTED_BY_DIRECTION},
)

POINT_VIEWS = ComputeDeclaration(
    name="point_views",
    text="which views see each point",
    source="point_views.comp.glsl",
    textures={"points": POINTS, "cube_masks": SPLAT_TRIANGLES_OF_CLOUD.textures["cube_masks"]},
    images={"point_views": Stored("RGBA32F", "write", VIEWS_TEXT)},
    constants={"point_count": POINT_COUNT, "cube_count": CUBE_COUNT, "culling_area": CULLING_AREA, **VIEW_CONSTANTS},
    tables={"cubes": CUBES},
    defines={"FACES_PER_CHANNEL": FACES_PER_CHANNEL},
)

DEPTH_CONSTANTS = {
    "nearest_m": Constant("float", "depth of step 0"),
    "steps_per_octave": Constant("float", "steps of depth while it doubles"),
}

BEGIN_DEPTHS = ComputeDeclaration(
    name="begin_depths",
    text="depths of what a map's texels see before points",
    source="begin_words.comp.glsl",
    local_size=(8, 8, 1),
    textures={"map_headers": MAP_TEXTURES["map_headers"], "positions": Sampled("sampler2D", POSITIONS)},
    images={"begun": Stored("R32UI", "write", "bits of the smallest depth")},
    constants={"map_number": MAP_NUMBER},
    defines=HEADER_DEFINE,
)
BEGIN_PACKED = replace(
    BEGIN_DEPTHS,
    name="begin_packed",
    text="words of what a map's texels see before points",
    textures={**BEGIN_DEPTHS.textures, "shown": SHOWN},
    images={"begun": Stored("R32UI", "write", WORDS_TEXT)},
    constants={"map_number": MAP_NUMBER, **DEPTH_CONSTANTS},
    defines={**HEADER_DEFINE, "PACKED": 1},
)

_SPLAT_DEFINES = {"FACES_PER_CHANNEL": FACES_PER_CHANNEL, "SMALLEST_CUBE_TEXELS": SMALLEST_CUBE_TEXELS}
_WORDS = Stored("R32UI", "atomic", WORDS_TEXT)
SPLAT_PACKED = ComputeDeclaration(
    name="splat_packed",
    text="splats shaded points, depth and colour in one word",
    source="splat_words.comp.glsl",
    textures={"points": POINTS, "point_views": Sampled("sampler2D", VIEWS_TEXT), "shown": SHOWN},
    images={"words": _WORDS},
    constants={"point_count": POINT_COUNT, **VIEW_CONSTANTS, **DEPTH_CONSTANTS},
    tables={"cubes": CUBES},
    defines={**_SPLAT_DEFINES, "PACKED": 1},
)
SPLAT_WIDE = replace(
    SPLAT_PACKED,
    name="splat_wide",
    text="splats shaded points: depths, then colours at them",
    images={"words": _WORDS, "depths": Stored("R32UI", "atomic", "bits of the smallest depth")},
    constants={
        "point_count": POINT_COUNT,
        **VIEW_CONSTANTS,
        "is_coloring": Constant("int", "1: depths are known, and colours are written"),
    },
    defines=_SPLAT_DEFINES,
)

TAKE_PACKED = ComputeDeclaration(
    name="take_packed",
    text="what a map's texels show by their packed words",
    source="take_words.comp.glsl",
    local_size=(8, 8, 1),
    textures={"map_headers": MAP_TEXTURES["map_headers"], "words": Sampled("usampler2D", WORDS_TEXT)},
    images={"radiances": Stored("RGBA32F", "write", SHADED_TEXT)},
    constants={"map_number": MAP_NUMBER},
    defines={**HEADER_DEFINE, "PACKED": 1},
)
TAKE_WIDE = replace(TAKE_PACKED, name="take_wide", text="what a map's texels show by their words of colour", defines=HEADER_DEFINE)


def bytes_per_point(cube_count: int) -> int:
    """Of a cloud's points that are shaded: themselves, what is kept of each place, and the bits of views."""
    return BYTES_PER_TEXEL * (TEXELS_PER_POINT + _view_texels(cube_count)) + SHADED_BYTES_PER_TEXEL


def _view_texels(cube_count: int) -> int:
    return -(-cube_count // CUBES_PER_TEXEL)


@dataclass(frozen=True)
class CubesOfPoints:
    """Some of the cubes that points are splatted into."""

    table: np.ndarray
    """(2 n, 4) rows of CUBES"""
    masks: np.ndarray
    """(instance_count, 4): bits of the cubes that leave an instance out, and of those that need not see its back faces"""


@dataclass(frozen=True)
class PointCloud:
    """All points of the cubes that share them."""

    points: Texture
    count: int
    work_table: Texture
    culling_area: float
    numbers: Sequence[int]
    """of the cubes among all maps"""
    table: np.ndarray
    """(2 n, 4) rows of CUBES, all of them"""
    batches: Sequence[CubesOfPoints]
    """CUBES_PER_TEXEL cubes each; the third of their tables' second rows: the cube's first texel in SMALLEST_CUBE_TEXELS"""


class ShadedPoints(ShadedPlaces):
    """What points show, and the words of texels."""

    def __init__(self, texels: ShadedMaps, cloud: PointCloud, words: ReflectionWords) -> None:
        """texels: of the maps that the points are splatted into"""
        self.texels, self.cloud, self.is_packed = texels, cloud, words is ReflectionWords.PACKED
        self.maps = texels.maps
        height = max(1, -(-cloud.count // LINEAR_TEXTURE_WIDTH))
        is_used = np.zeros(grid_shape(LINEAR_TEXTURE_WIDTH, height), bool)
        is_used[: -(-height // TILE_PX)] = True
        super().__init__(self.maps.device, height, is_used)
        self._view_texels = _view_texels(len(cloud.numbers))
        drawn = [self.maps.maps[number] for number in cloud.numbers]
        nearest_m, farthest_m = min(each.near_m for each in drawn), max(each.reach_m for each in drawn)
        self._depth_steps = {"nearest_m": nearest_m, "steps_per_octave": STEPS / math.log2(farthest_m / nearest_m)}
        with self._owned as owned:

            def texture(texture_format: TextureFormat, rows: int) -> Texture:
                return owned.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, texture_format))

            self.views = texture(TextureFormat.RGBA32F, max(1, -(-self._view_texels * cloud.count // LINEAR_TEXTURE_WIDTH)))
            self.words = texture(TextureFormat.R32UI, texels.size[1])
            self.depths = None if self.is_packed else texture(TextureFormat.R32UI, texels.size[1])
            self._owned = owned.pop_all()

    @property
    def byte_count(self) -> int:
        """Of points, places and words."""
        held = [self.views, self.words, self.cloud.points] + ([] if self.depths is None else [self.depths])
        width, height = self.size
        return sum(each.byte_count for each in held) + SHADED_BYTES_PER_TEXEL * width * height

    def find_surfaces(self) -> None:
        """Once the maps' own texels are found."""
        cloud = self.cloud
        map_numbers = np.zeros(-(-len(cloud.numbers) // 4) * 4)
        map_numbers[: len(cloud.numbers)] = cloud.numbers
        self.device.compute_kernel(POINT_SURFACES).dispatch_linear(
            cloud.count,
            **self.maps.scene_data.bindings,
            **self.rays,
            corner_normals=self.maps.scene_data.corner_normals,
            work_table=cloud.work_table,
            points=cloud.points,
            positions=self.positions,
            normals=self.normals,
            surfaces=self.surfaces,
            point_count=cloud.count,
            cube_count=len(cloud.numbers),
            cubes=cloud.table,
            map_numbers=map_numbers.reshape(-1, 4),
        )
        for number, batch in enumerate(cloud.batches):
            masks = self.device.upload_array(batch.masks)
            self.device.compute_kernel(POINT_VIEWS).dispatch_linear(
                cloud.count,
                points=cloud.points,
                cube_masks=masks,
                point_views=self.views,
                point_count=cloud.count,
                cube_count=len(batch.table) // 2,
                culling_area=cloud.culling_area,
                view_texels=self._view_texels,
                view_texel=number,
                cubes=batch.table,
            )
            masks.release()
        if self.depths is not None:
            self._begin(BEGIN_DEPTHS, self.depths)
            self._splat(SPLAT_WIDE, depths=self.depths, is_coloring=0)

    def splat(self) -> None:
        """Into the maps' texels, once all of both are shaded."""
        if self.depths is None:
            self._begin(BEGIN_PACKED, self.words, shown=self.texels.radiances, **self._depth_steps)
            self._splat(SPLAT_PACKED, **self._depth_steps)
        else:
            self.device.fill(self.words, EMPTY_WORD)
            self._splat(SPLAT_WIDE, depths=self.depths, is_coloring=1)
        self._walk_maps(TAKE_PACKED if self.is_packed else TAKE_WIDE, words=self.words, radiances=self.texels.radiances)

    def _begin(self, declaration: ComputeDeclaration, begun: Texture, **bindings: object) -> None:
        self._walk_maps(declaration, positions=self.texels.positions, begun=begun, **bindings)

    def _walk_maps(self, declaration: ComputeDeclaration, **bindings: object) -> None:
        kernel = self.device.compute_kernel(declaration)
        for number in self.cloud.numbers:
            each = self.maps.maps[number]
            size = each.width_px, each.face_count * each.height_px
            kernel.dispatch_grid(size, map_headers=self.maps.headers, map_number=number, **bindings)

    def _splat(self, declaration: ComputeDeclaration, **bindings: object) -> None:
        for number, batch in enumerate(self.cloud.batches):
            self.device.compute_kernel(declaration).dispatch_linear(
                self.cloud.count,
                points=self.cloud.points,
                point_views=self.views,
                shown=self.radiances,
                words=self.words,
                point_count=self.cloud.count,
                view_texels=self._view_texels,
                view_texel=number,
                cubes=batch.table,
                **bindings,
            )
