"""Small triangles: the kernels that collect them once a face and rasterize them into the depth maps of every batch."""

from __future__ import annotations

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE
from .shadow_maps import (
    DEPTH_MAPS_ATOMIC,
    FACE_TABLE,
    FRONT_FACE,
    ORTHOGRAPHIC_FLAG,
    PORTION_CONSTANTS,
    SEEN_SPACE_CONSTANTS,
    SEEN_SPACE_TABLES,
    VIEW_COUNT,
    VIEWS_TABLE,
    WORK_TABLE,
)

GATHERED_TRIANGLES_TEXT = (
    "three texels a triangle, its corners in face space, those of small ones with FRONT_FACE as x/z and y/z in texels and 1/z, "
    "with ORTHOGRAPHIC as x and y in texels and z; w: instance, of small ones 1 if any view sees their front, otherwise 0"
)
SMALL_EXTENT_TEXELS = 11.0
"""Edge functions of corners in 256ths of a texel stay below 2^24, which float32 holds exactly."""
BLOCK_TEXELS = 16
"""each way, of the parts of a map that the list is ordered by"""
KEPT_TRIANGLES_TEXT = f"{GATHERED_TRIANGLES_TEXT}; of second corners the block of texels that the first one is in"
BLOCK_COUNTS_TEXT = "device array: small triangles of each block of texels of the batch's first map"

GATHER_TRIANGLES = ComputeDeclaration(
    name="gather_triangles",
    text="culls and places the triangles that cast into a face's maps and parts small ones from large ones",
    source="gather_triangles.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures={
        **SCENE_TEXTURES,
        "work_table": WORK_TABLE,
    },
    images={
        "counters": Stored("R32UI", "atomic", "texel 0: small triangles, 1: large ones"),
        "gathered_triangles": Stored("RGBA32F", "write", GATHERED_TRIANGLES_TEXT),
    },
    constants={
        **PORTION_CONSTANTS,
        **SEEN_SPACE_CONSTANTS,
        "triangle_capacity": Constant("int", "triangles that the list holds"),
    },
    tables={**SEEN_SPACE_TABLES, "face": FACE_TABLE},
    flags={**ORTHOGRAPHIC_FLAG, "FRONT_FACE": FRONT_FACE},
    defines={**SCENE_DEFINES, "SMALL_EXTENT_TEXELS": SMALL_EXTENT_TEXELS},
)

KEEP_SEEN_TRIANGLES = ComputeDeclaration(
    name="keep_seen_triangles",
    text="leaves out small triangles that no view of a batch is near to seeing",
    source="keep_seen_triangles.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures={
        "gathered_triangles": Sampled("sampler2D", GATHERED_TRIANGLES_TEXT),
        "depth_maps": Sampled("usampler2D", "complete depth maps of a batch"),
    },
    images={
        "counters": Stored("R32UI", "atomic", "texel 0: triangles kept"),
        "kept_triangles": Stored("RGBA32F", "write", KEPT_TRIANGLES_TEXT),
        "block_counts": Stored("R32UI", "atomic", BLOCK_COUNTS_TEXT),
    },
    constants={
        "view_count": VIEW_COUNT,
        "triangle_count": Constant("int", "small triangles in the list"),
        "triangle_capacity": Constant("int", "triangles that the new list holds"),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags={**ORTHOGRAPHIC_FLAG, "FRONT_FACE": FRONT_FACE},
    defines={"BLOCK_TEXELS": BLOCK_TEXELS},
)

ORDER_TRIANGLES = ComputeDeclaration(
    name="order_triangles",
    text="puts the small triangles of each block of texels together",
    source="order_triangles.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures={
        "kept_triangles": Sampled("sampler2D", KEPT_TRIANGLES_TEXT),
        "block_starts": Sampled("sampler2D", "device array: where in the new list each block's triangles begin, in halves"),
    },
    images={
        "ordered_triangles": Stored("RGBA32F", "write", KEPT_TRIANGLES_TEXT),
        "block_counts": Stored("R32UI", "atomic", BLOCK_COUNTS_TEXT),
    },
    constants={"triangle_count": Constant("int", "small triangles in the list")},
)

COPY_TEXELS = ComputeDeclaration(
    name="copy_texels",
    text="copies a part of a list, so that only that part is read back",
    source="copy_texels.comp.glsl",
    textures={"original": Sampled("sampler2D", "device array")},
    images={"copied": Stored("RGBA32F", "write", "device array that takes the part")},
    constants={"first_texel": Constant("int", "where the part starts"), "texel_count": Constant("int", "texels of the part")},
)

RASTERIZE_SMALL_TRIANGLES = ComputeDeclaration(
    name="rasterize_small_triangles",
    text="rasterizes the list of small triangles into the maps of a batch",
    source="rasterize_small_triangles.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures={"gathered_triangles": Sampled("sampler2D", GATHERED_TRIANGLES_TEXT)},
    images={"depth_maps": DEPTH_MAPS_ATOMIC},
    constants={
        "view_count": VIEW_COUNT,
        "triangle_count": Constant("int", "small triangles in the list"),
        "skipped_facing": Constant("float", "which to leave out: 0 what faces away from all views, 1 the others, -1 none"),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags={
        **ORTHOGRAPHIC_FLAG,
        "FRONT_FACE": FRONT_FACE,
        "LOOKS_FIRST": "an atomic update only of what lies behind: software rasterizers pay more for the look",
    },
)
