"""Eye-based deferred shading as published (Gavane & Watson 2022 b, "Eye-Based Point Rendering", sections 4.1.2 and 4.1.3): of the texels of
cubes those are shaded, once each, that any of the picture's samples asks for.

All samples of a pixel are reflected from one eye sample, by the gradient of its normal. A first walk over the picture marks the texels
in their directions, these are listed and shaded, as places of their own, and a second walk filters what they show. Where a pixel shows
many texels, blocks of them share a place, their middle, as in the paper those that a splat covers refer to one point: so shading goes by
the eye's pixels.

needed        of every texel of every map: not 0 where it is needed, once it is listed 1 + the number of its place
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table
from ...device.interface import LINEAR_TEXTURE_WIDTH, Texture, TextureFormat
from ..settings import MAX_REFLECTION_SAMPLES
from .reflection_maps import HEADER_DEFINE, MAP_LEVELS, MAP_NUMBER, MAP_TEXTURES, ReflectionMaps
from .reflections import COLORS, RADIANCES, REFLECT
from .shaded_maps import SHADED_BYTES_PER_TEXEL, TEXEL_SURFACES, ShadedPlaces
from .surface_data import SURFACE_FLAGS, WORLD_FLAGS
from .tiles import SIZE_CONSTANTS, TILE_PX, WALK_CONSTANTS, grid_shape

NEEDED_TEXT = "of every texel of every map: 0: no sample needs it; otherwise 1 + the number of its place, once it has one"

MARK_NEEDED = ComputeDeclaration(
    name="mark_needed",
    text="marks the texels that see a surface in the directions of all of a pixel's samples",
    source="reflect_samples.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures={**{name: each for name, each in REFLECT.textures.items() if name != "settled"}, **MAP_TEXTURES},
    images={"needed": Stored("R32UI", "write", NEEDED_TEXT), "colors": Stored("RGBA32F", "write", COLORS)},
    constants={
        **SIZE_CONSTANTS,
        **WALK_CONSTANTS,
        "sample_count": Constant("int", "samples of a pixel"),
        "places_per_pixel": Constant("float", "that are shaded for a pixel of the eye"),
    },
    tables={
        "eye": REFLECT.tables["eye"],
        "samples": Table(MAX_REFLECTION_SAMPLES, "where in the pixel, from the eye's sample (pixels), and which facet (unit square)"),
    },
    flags=SURFACE_FLAGS,
    defines={
        **{name: each for name, each in REFLECT.defines.items() if name != "MAP_NUMBERS"},
        **HEADER_DEFINE,
        "MAP_LEVELS": MAP_LEVELS,
        "FILTERED": 1,
        "MARKING": 1,
    },
)
FILTER_NEEDED = replace(
    MARK_NEEDED,
    name="filter_needed",
    text="the mean of what the texels in the directions of all of a pixel's samples show",
    textures={
        **MARK_NEEDED.textures,
        "needed": Sampled("usampler2D", NEEDED_TEXT),
        "shown": Sampled("sampler2D", "light that the places show"),
    },
    images={"radiances": Stored("RGBA32F", "write", RADIANCES)},
    flags={**SURFACE_FLAGS, **WORLD_FLAGS},
    defines={name: each for name, each in MARK_NEEDED.defines.items() if name != "MARKING"},
)
NEEDED_SURFACES = replace(
    TEXEL_SURFACES,
    name="needed_surfaces",
    text="what the centres of those of a map's texels see that are needed",
    source="needed_surfaces.comp.glsl",
    local_size=(64, 1, 1),
    textures={**TEXEL_SURFACES.textures, "listed": Sampled("sampler2D", "four a texel: a place's texel within its map")},
    images={**TEXEL_SURFACES.images, "needed": Stored("R32UI", "write", NEEDED_TEXT)},
    constants={
        "map_number": MAP_NUMBER,
        "first": Constant("int", "the first of the map's places"),
        "count": Constant("int", "of its places"),
    },
)


class NeededMarks:
    """Which texels of some maps are needed."""

    def __init__(self, maps: ReflectionMaps, numbers: Iterable[int]) -> None:
        """numbers: of the maps"""
        self.maps, self.device = maps, maps.device
        self.numbers = sorted(numbers)
        self.texture = self.device.create_texture(LINEAR_TEXTURE_WIDTH, maps.texels.height, TextureFormat.R32UI)

    def clear(self) -> None:
        self.device.fill(self.texture, 0)

    def read(self) -> dict[int, np.ndarray]:
        """Map number -> (n,) int64 its marked texels, of the finest level: where they stand in its list, in order."""
        marks = self.device.read(self.texture).ravel()
        found, base = {}, 0
        for number, each in enumerate(self.maps.maps):
            if number in self.numbers:
                found[number] = np.flatnonzero(marks[base : base + each.face_count * each.width_px * each.height_px])
            base += each.texel_count
        return found

    def release(self) -> None:
        self.texture.release()


class NeededPlaces(ShadedPlaces):
    """Room for so many places."""

    def __init__(self, marks: NeededMarks, count: int) -> None:
        self.marks = marks
        height = max(1, -(-count // LINEAR_TEXTURE_WIDTH))
        super().__init__(marks.device, height, np.ones(grid_shape(LINEAR_TEXTURE_WIDTH, height), bool))
        self.capacity = LINEAR_TEXTURE_WIDTH * height

    @property
    def byte_count(self) -> int:
        return SHADED_BYTES_PER_TEXEL * self.capacity

    def find_surfaces(self, texels: dict[int, np.ndarray]) -> None:
        """texels: as of `NeededMarks.read`, no more than there is room for"""
        self.forget()
        numbers = np.concatenate([np.zeros(0), *texels.values()])
        rows = np.zeros((-(-len(numbers) // 4), 4), np.float32)
        rows.ravel()[: len(numbers)] = numbers
        listed: Texture = self.device.upload_array(rows)
        kernel, maps = self.device.compute_kernel(NEEDED_SURFACES), self.marks.maps
        first = 0
        for number, own in texels.items():
            if len(own):
                kernel.dispatch_linear(
                    len(own),
                    **maps.scene_data.bindings,
                    **maps.bindings,
                    **self.rays,
                    corner_normals=maps.scene_data.corner_normals,
                    positions=self.positions,
                    normals=self.normals,
                    surfaces=self.surfaces,
                    needed=self.marks.texture,
                    listed=listed,
                    map_number=number,
                    first=first,
                    count=len(own),
                )
            first += len(own)
        listed.release()
