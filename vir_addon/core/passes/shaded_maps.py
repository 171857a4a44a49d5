"""Reflectors' maps as published before shading was deferred: what every texel sees is shaded, whoever looks at it, and mip-mapped.

Places and light of texels are textures laid out as the maps' texels are, so kernels that shade what rays meet shade them as well.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored
from ...device.interface import LINEAR_TEXTURE_WIDTH, Device, Texture, TextureFormat
from ...device.owned import Owned
from .reflection_maps import HEADER_DEFINE, MAP_LEVELS, MAP_NUMBER, MAP_TEXTURES, ReflectionMaps
from .reflections import (
    DIRECTIONS,
    NO_RAY,
    NORMALS,
    ORIGINS,
    POSITIONS,
    RADIANCES,
    REFLECTED_BY_DIRECTION,
    REFLECTED_NOTHING,
    SURFACES,
    THROUGHPUTS,
)
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES
from .tiles import SIZE_CONSTANTS, TILE_DEFINES, TILE_PX, TILE_TEXTURES, WALK_CONSTANTS, Tiles, grid_shape

TEXEL_SURFACES = ComputeDeclaration(
    name="texel_surfaces",
    text="what the centres of a map's texels see",
    source="texel_surfaces.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        **SCENE_TEXTURES,
        **MAP_TEXTURES,
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
    },
    images={
        "positions": Stored("RGBA32F", "write", POSITIONS),
        "normals": Stored("RGBA32F", "write", NORMALS),
        "surfaces": Stored("RGBA32F", "write", SURFACES),
        "ray_origins": Stored("RGBA32F", "write", ORIGINS),
        "ray_directions": Stored("RGBA32F", "write", DIRECTIONS),
        "throughputs": Stored("RGBA32F", "write", THROUGHPUTS),
    },
    constants={"map_number": MAP_NUMBER},
    defines={
        **SCENE_DEFINES,
        **HEADER_DEFINE,
        "REFLECTED_NOTHING": REFLECTED_NOTHING,
        "REFLECTED_BY_DIRECTION": REFLECTED_BY_DIRECTION,
    },
)

SHADED_TEXT = "light that every texel of every map shows"
SHADED_LEVELS = ComputeDeclaration(
    name="shaded_levels",
    text="a coarser level of what a map's texels show",
    source="shaded_levels.comp.glsl",
    local_size=(8, 8, 1),
    textures={"map_headers": MAP_TEXTURES["map_headers"]},
    images={"radiances": Stored("RGBA32F", "read_write", SHADED_TEXT)},
    constants={"map_number": MAP_NUMBER, "level": Constant("int", "which level is made, from 1")},
    defines=HEADER_DEFINE,
)

LOOK_UP_SHADED = ComputeDeclaration(
    name="look_up_shaded",
    text="looks shaded maps up in rays' directions",
    source="look_up_shaded.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        "map_headers": MAP_TEXTURES["map_headers"],
        "shaded": Sampled("sampler2D", SHADED_TEXT),
        "ray_origins": Sampled("sampler2D", ORIGINS),
        "ray_directions": Sampled("sampler2D", DIRECTIONS),
        "throughputs": Sampled("sampler2D", THROUGHPUTS),
        **TILE_TEXTURES,
    },
    images={"radiances": Stored("RGBA32F", "write", RADIANCES)},
    constants={**SIZE_CONSTANTS, **WALK_CONSTANTS},
    defines={**HEADER_DEFINE, **TILE_DEFINES, "MAP_LEVELS": MAP_LEVELS},
)


SHADED_BYTES_PER_TEXEL = 10 * 16
"""of the textures of ShadedPlaces"""
FILL_TEXELS = ComputeDeclaration(
    name="fill_texels",
    text="sets every texel of a texture to the same",
    source="fill_texels.comp.glsl",
    local_size=(8, 8, 1),
    images={"filled": Stored("RGBA32F", "write", "what is filled")},
    constants={
        "width": Constant("int", "of the texture"),
        "height": Constant("int", "of the texture"),
        "fourth": Constant("float", "the fourth channel; the others are 0"),
    },
)


class ShadedPlaces:
    """Textures of places that are shaded as what rays meet is: where they are, as which rays see them, and what they show."""

    def __init__(self, device: Device, height: int, is_used: np.ndarray) -> None:
        """LINEAR_TEXTURE_WIDTH wide; is_used: (rows, columns) bool, tiles that hold any"""
        self.device, self.is_used = device, is_used
        self.size = LINEAR_TEXTURE_WIDTH, height
        with Owned() as owned:

            def texture(fourth: float = 0.0) -> Texture:
                made = owned.own(device.create_texture(*self.size, TextureFormat.RGBA32F))
                self._fill(made, fourth)
                return made

            self.normals, self.surfaces, self.scatterings, self.glosses = (texture() for _ in range(4))
            self.sums, self.radiances = texture(), texture()
            self.rays = {name: texture() for name in ("ray_origins", "ray_directions", "throughputs")}
            self.positions = texture(-1.0)
            self.tiles = owned.own(Tiles(device, is_used))
            self._owned = owned.pop_all()

    def forget(self) -> None:
        """From now on no place is used."""
        self._fill(self.positions, -1.0)
        self._fill(self.surfaces, float(NO_RAY))

    def _fill(self, filled: Texture, fourth: float) -> None:
        width, height = self.size
        kernel = self.device.compute_kernel(FILL_TEXELS)
        kernel.dispatch_grid(self.size, filled=filled, width=width, height=height, fourth=fourth)

    def count_shaded(self) -> int:
        """Places on a surface."""
        return int((self.device.read(self.positions)[..., 3] >= 0).sum())

    def release(self) -> None:
        self._owned.close()


class ShadedMaps(ShadedPlaces):
    """What the texels of some maps see and show."""

    def __init__(self, maps: ReflectionMaps, numbers: Iterable[int]) -> None:
        """numbers: of the maps that are shaded"""
        self.maps = maps
        self.numbers = sorted(numbers)
        height = maps.texels.height
        is_used = np.zeros(grid_shape(LINEAR_TEXTURE_WIDTH, height), bool)
        base = 0
        for number, each in enumerate(maps.maps):
            if number in self.numbers:
                last = base + each.face_count * each.width_px * each.height_px - 1
                is_used[base // LINEAR_TEXTURE_WIDTH // TILE_PX : last // LINEAR_TEXTURE_WIDTH // TILE_PX + 1] = True
            base += each.texel_count
        super().__init__(maps.device, height, is_used)

    def find_surfaces(self) -> None:
        """Once the maps are drawn."""
        kernel = self.device.compute_kernel(TEXEL_SURFACES)
        for number in self.numbers:
            each = self.maps.maps[number]
            kernel.dispatch_grid(
                (each.width_px, each.face_count * each.height_px),
                **self.maps.scene_data.bindings,
                **self.maps.bindings,
                **self.rays,
                corner_normals=self.maps.scene_data.corner_normals,
                positions=self.positions,
                normals=self.normals,
                surfaces=self.surfaces,
                map_number=number,
            )

    def make_levels(self) -> None:
        """Once the finest is shaded."""
        kernel = self.device.compute_kernel(SHADED_LEVELS)
        for number in self.numbers:
            each = self.maps.maps[number]
            for level in range(1, MAP_LEVELS):
                kernel.dispatch_grid(
                    (each.width_px >> level, each.face_count * (each.height_px >> level)),
                    map_headers=self.maps.headers,
                    radiances=self.radiances,
                    map_number=number,
                    level=level,
                )
