"""One cloud of triangles and points for the cubes of all reflectors: the kernels that collect it and splat it.

cloud_triangles   three texels a triangle: corners (world space), counter-clockwise seen from the front; w: its owner
points            two texels a point: position (world space) and packed normal; its owner, and the area that it stands for
owner             number among the triangles of the work table (WORK_GROUP_SIZE a group) in 16-bit halves, 16 random bits above
                  these, and instance number
nearest_depths, nearest_numbers
                  of every texel of a batch's cubes, face by face, from where the cube's first one is
"""

from __future__ import annotations

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table
from .reflection_maps import NEAREST_DEPTHS_TEXT, NEAREST_NUMBERS_TEXT
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE
from .shadow_maps import PORTION_CONSTANTS, WORK_TABLE

MAX_CUBES = 256
"""of a cloud: two texels each in a uniform block"""
MAX_BATCH_CUBES = 24
"""that are splatted into at once: bits that a float32 holds"""
TILE_TEXELS = 16
"""along a side of the tiles that large triangles are splatted in"""
TEXELS_PER_TRIANGLE, TEXELS_PER_POINT = 3, 2
COUNTER_COUNT = 3

CUBES = Table(2 * MAX_CUBES, "two rows a cube: centre and width of a texel (tangent); near depth, eye's pixel there (m), first texel, side")
CUBE_COUNT = Constant("int", "cubes")
EYE_PIXEL_ANGLE = Constant("float", "of the eye's pixels; with EYE_DENSITY")
CULLING_AREA = Constant("float", "share of a sample's area below which triangles are culled at random; 0: none")
TRIANGLES_TEXT = "three texels a triangle: corners and owner"
POINTS_TEXT = "two texels a point: position and packed normal; owner and area"
TILES_TEXT = "a texel a tile: triangle of the cloud, cube and face, column, row"
EYE_DENSITY = {"EYE_DENSITY": "no denser than the eye's pixels, on the way by the reflector"}
COUNTERS = Stored("R32UI", "atomic", "texel 0: triangles, 1: points, 2: tiles")

COLLECT_REFLECTED = ComputeDeclaration(
    name="collect_reflected",
    text="collects what cubes of reflectors show as triangles and points",
    source="collect_reflected.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures={**SCENE_TEXTURES, "work_table": WORK_TABLE},
    images={
        "counters": COUNTERS,
        "cloud_triangles": Stored("RGBA32F", "write", TRIANGLES_TEXT),
        "points": Stored("RGBA32F", "write", POINTS_TEXT),
    },
    constants={
        **PORTION_CONSTANTS,
        "cube_count": CUBE_COUNT,
        "eye_pixel_angle": EYE_PIXEL_ANGLE,
        "culling_area": CULLING_AREA,
        "triangle_capacity": Constant("int", "triangles that the cloud holds"),
        "point_capacity": Constant("int", "points that it holds"),
    },
    tables={"cubes": CUBES},
    flags={**EYE_DENSITY, "POINTS": "triangles of few texels become points"},
    defines={**SCENE_DEFINES, "WORK_GROUP_SIZE": WORK_GROUP_SIZE},
)

_SPLAT_IMAGES = {
    "nearest_depths": Stored("R32UI", "atomic", NEAREST_DEPTHS_TEXT),
    "nearest_numbers": Stored("R32UI", "atomic", NEAREST_NUMBERS_TEXT),
}
_CAME_FIRST = Stored("R32UI", "read_write", "of every triangle or point: bits of the cubes in which nothing came before it")
_SPLAT_CONSTANTS = {"is_numbering": Constant("int", "1: depths are known, and numbers are written")}

SPLAT_TRIANGLES_OF_CLOUD = ComputeDeclaration(
    name="splat_triangles_of_cloud",
    text="splats triangles into the cubes of a batch, lists tiles of large ones",
    source="splat_triangles_of_cloud.comp.glsl",
    textures={
        "cloud_triangles": Sampled("sampler2D", TRIANGLES_TEXT),
        "cube_masks": Sampled(
            "sampler2D", "of every instance: bits of the batch's cubes that leave it out, and of those that need not see its back faces"
        ),
    },
    images={**_SPLAT_IMAGES, "came_first": _CAME_FIRST, "counters": COUNTERS, "tiles": Stored("RGBA32F", "write", TILES_TEXT)},
    constants={
        **_SPLAT_CONSTANTS,
        "cube_count": CUBE_COUNT,
        "eye_pixel_angle": EYE_PIXEL_ANGLE,
        "culling_area": CULLING_AREA,
        "triangle_count": Constant("int", "triangles in the cloud"),
        "tile_capacity": Constant("int", "tiles that the list holds"),
    },
    tables={"cubes": CUBES},
    flags=EYE_DENSITY,
    defines={"TILE_TEXELS": TILE_TEXELS},
)

SPLAT_TILES_OF_CLOUD = ComputeDeclaration(
    name="splat_tiles_of_cloud",
    text="splats tiles of large triangles into the cubes of a batch",
    source="splat_tiles_of_cloud.comp.glsl",
    textures={"cloud_triangles": Sampled("sampler2D", TRIANGLES_TEXT), "tiles": Sampled("sampler2D", TILES_TEXT)},
    images=_SPLAT_IMAGES,
    constants={**_SPLAT_CONSTANTS, "tile_count": Constant("int", "tiles in the list")},
    tables={"cubes": CUBES},
    defines={"TILE_TEXELS": TILE_TEXELS},
)

SPLAT_POINTS_OF_CLOUD = ComputeDeclaration(
    name="splat_points_of_cloud",
    text="splats points into the cubes of a batch",
    source="splat_points_of_cloud.comp.glsl",
    textures={"points": Sampled("sampler2D", POINTS_TEXT), "cube_masks": SPLAT_TRIANGLES_OF_CLOUD.textures["cube_masks"]},
    images={**_SPLAT_IMAGES, "came_first": _CAME_FIRST},
    constants={
        **_SPLAT_CONSTANTS,
        "cube_count": CUBE_COUNT,
        "culling_area": CULLING_AREA,
        "point_count": Constant("int", "points in the cloud"),
    },
    tables={"cubes": CUBES},
)
