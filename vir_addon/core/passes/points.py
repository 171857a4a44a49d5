"""Points of surfaces: the kernels that make them, keep them and splat them into depth maps."""

from __future__ import annotations

from ...device.declaration import ComputeDeclaration, Constant, GeometryDeclaration, RasterDeclaration, Sampled, Stored, Table, Varying
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE
from .shadow_maps import (
    DEPTH_MAPS_ATOMIC,
    FACE_TABLE,
    FRONT_FACE,
    MIXED_MAPS_FLAG,
    ORTHOGRAPHIC_FLAG,
    PORTION_CONSTANTS,
    SEEN_SPACE_CONSTANTS,
    SEEN_SPACE_TABLES,
    VIEW_COUNT,
    VIEWS_TABLE,
    WORK_TABLE,
)

SPLAT_FLAGS = {
    **ORTHOGRAPHIC_FLAG,
    **MIXED_MAPS_FLAG,
    "NEAR_SURFACES": "something casts from nearer than the light's diameter: points there cover several texels",
    "FRONT_FACE": FRONT_FACE,
}

POINTS_AT_ONCE = 4
"""points that are compared with each other before they are written, with LOCAL_CULLING"""

SPLAT_POINTS = ComputeDeclaration(
    name="splat_points",
    text="replays the point buffer into the maps of a batch",
    source="splat_points.comp.glsl",
    textures={"points": Sampled("sampler2D", "position (face space) and packed normal")},
    images={"depth_maps": DEPTH_MAPS_ATOMIC},
    constants={"view_count": VIEW_COUNT, "point_count": Constant("int", "points in the buffer")},
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags={**SPLAT_FLAGS, "LOCAL_CULLING": "of neighbours in the buffer that fall into one texel only the nearest is written"},
    defines={"POINTS_AT_ONCE": POINTS_AT_ONCE},
)

SPLAT_CELLS = ComputeDeclaration(
    name="splat_cells",
    text="replays the splats of the point buffer, cells larger than texels, into the maps of a batch",
    source="splat_cells.comp.glsl",
    textures={
        **SCENE_TEXTURES,
        "points": Sampled("sampler2D", "from its end two texels a splat: instance, triangle and centre; half size"),
    },
    images={"depth_maps": DEPTH_MAPS_ATOMIC},
    constants={
        "view_count": VIEW_COUNT,
        "buffer_end": Constant("int", "texels of the buffer"),
        "splat_count": Constant("int", "splats in the buffer"),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    defines=SCENE_DEFINES,
)

COUNTERS = Stored(
    "R32UI", "atomic", "texel 0: points, 1: tiles, 2: culled triangles, 3: parts of large triangles or, listed, these, 4: splats"
)

KEEP_SEEN_POINTS = ComputeDeclaration(
    name="keep_seen_points",
    text="leaves out points that no view of a batch is near to seeing",
    source="keep_seen_points.comp.glsl",
    textures={
        "points": Sampled("sampler2D", "position (face space) and packed normal"),
        "depth_maps": Sampled("usampler2D", "depth maps of the batch"),
    },
    images={"kept_points": Stored("RGBA32F", "write", "position (face space) and packed normal"), "counters": COUNTERS},
    constants={"view_count": VIEW_COUNT, "point_count": Constant("int", "points in the buffer")},
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags=ORTHOGRAPHIC_FLAG,
)

SAMPLING_TABLES = {
    **SEEN_SPACE_TABLES,
    "face": FACE_TABLE,
    "hull_box": Table(
        2, "centre and half size of the hull (face space); w of the first: depth over distance at the windows' farthest corner"
    ),
    "eye": Table(2, "the eye (face space); smallest angle of its pixels, their width in metres; read with EYE_DENSITY"),
}
SAMPLING_CONSTANTS = {
    **SEEN_SPACE_CONSTANTS,
    "window_bounds": Constant("vec4", "tangents left, right, bottom, top around all windows"),
}
SAMPLING_FLAGS = {
    **ORTHOGRAPHIC_FLAG,
    "WATERTIGHT": "point spacing that leaves no texel empty instead of the published density",
    "EYE_DENSITY": "the lattice is as coarse as the eye's pixels let it be, and cells larger than texels are splats",
    "GLOBAL_RATE": "a triangle's distance and the worst angle of any map decide its density (Marrs et al. 2017)",
    "STOCHASTIC_CULLING": "cull triangles of an area A below `culling_area_texels` with probability 1 - A / culling_area_texels",
}
QUADTREE_LEVELS = 3
"""that one invocation walks below a part: 85 nodes. A whole floor takes tens of thousands, which would keep one processor of a GPU busy for
long, and software rasterizers end a shader's loops after 65536 steps."""
PARTS_OF_A_PART = 4**QUADTREE_LEVELS
"""at most, and as many tiles"""
PARTS_OF_A_SLIVER = 4096
"""Square ones, at most. A triangle as large and less slender becomes fewer."""
PARTS_TEXT = "two texels a part of a large triangle: instance and triangle; corner and size"
PART_CONSTANTS = {
    "part_capacity": Constant("int", "parts that the list holds"),
    "counted_parts": Constant("int", "what the counter of parts says more than the list will hold before the next"),
}
POINT_STORE = {"points": Stored("RGBA32F", "write", "position (face space) and packed normal")}


def _generate(name: str, text: str, source_flag: str, output_flag: str, *, list_large: bool = False) -> ComputeDeclaration:
    """list_large: what takes more than `points_of_small` points goes into a list for the rasterizer instead of being cut into parts."""
    from_triangles = source_flag == "FROM_TRIANGLES"
    into_buffer = output_flag == "INTO_BUFFER"
    textures = dict(SCENE_TEXTURES)
    images = {"counters": COUNTERS}
    constants = dict(SAMPLING_CONSTANTS)
    tables = dict(SAMPLING_TABLES)
    if from_triangles:
        textures["work_table"] = WORK_TABLE
        constants |= PORTION_CONSTANTS | {"culling_area_texels": Constant("float", "area below which triangles are culled at random")}
        if list_large:
            images["large_triangles"] = Stored("RGBA32F", "write", "three texels a triangle, its corners in face space; w: instance")
            constants["large_capacity"] = Constant("int", "large triangles that the list holds")
            constants["points_of_small"] = Constant("int", "the most points that a triangle may have without being large")
        else:
            images["parts"] = Stored("RGBA32F", "write", PARTS_TEXT)
            constants |= PART_CONSTANTS
    else:
        textures["tile_list"] = Sampled("sampler2D", "tiles of large triangles")
        constants["tile_count"] = Constant("int", "tiles to sample")
    if into_buffer:
        images |= POINT_STORE
        constants["texel_capacity"] = Constant("int", "texels of the buffer: a point takes one, a splat two")
    else:
        images["depth_maps"] = DEPTH_MAPS_ATOMIC
        constants["view_count"] = VIEW_COUNT
        tables["views"] = VIEWS_TABLE
    return ComputeDeclaration(
        name=name,
        text=text,
        source="generate_points.comp.glsl",
        local_size=(WORK_GROUP_SIZE, 1, 1),
        textures=textures,
        images=images,
        constants=constants,
        tables=tables,
        flags=SAMPLING_FLAGS if into_buffer else SAMPLING_FLAGS | SPLAT_FLAGS,
        defines={
            **SCENE_DEFINES,
            **({"WORK_GROUP_SIZE": WORK_GROUP_SIZE} if from_triangles else {}),
            **({"PARTS_OF_A_SLIVER": PARTS_OF_A_SLIVER} if from_triangles and not list_large else {}),
            source_flag: 1,
            output_flag: 1,
            **({"LIST_LARGE": 1} if list_large else {}),
        },
    )


CUT_PARTS = ComputeDeclaration(
    name="cut_parts",
    text="cuts parts of large triangles into tiles and smaller parts",
    source="generate_points.comp.glsl",
    local_size=(WORK_GROUP_SIZE, 1, 1),
    textures=dict(SCENE_TEXTURES),
    images={
        "counters": COUNTERS,
        "parts": Stored("RGBA32F", "read_write", PARTS_TEXT),
        "tiles": Stored("RGBA32F", "write", "two texels a tile: instance, triangle and cells; corner and cell size"),
    },
    constants={
        **SAMPLING_CONSTANTS,
        "first_part": Constant("int", "the first part to cut"),
        "part_count": Constant("int", "parts to cut"),
        **PART_CONSTANTS,
        "counted_tiles": Constant("int", "the same of tiles, for which there always is room"),
        "may_leave_parts": Constant("int", "0: what is still too large becomes a tile, sampled too sparsely"),
    },
    tables=SAMPLING_TABLES,
    flags=SAMPLING_FLAGS,
    defines={**SCENE_DEFINES, "FROM_PARTS": 1, "QUADTREE_LEVELS": QUADTREE_LEVELS},
)

BUFFER_TRIANGLES = _generate("buffer_triangles", "points of small triangles into the buffer", "FROM_TRIANGLES", "INTO_BUFFER")
BUFFER_TILES = _generate("buffer_tiles", "points of large triangles into the buffer", "FROM_TILES", "INTO_BUFFER")
SPLAT_TRIANGLES = _generate("splat_triangles", "points of small triangles into the maps", "FROM_TRIANGLES", "INTO_MAPS")
BUFFER_SMALL_TRIANGLES = _generate(
    "buffer_small_triangles",
    "points of small triangles into the buffer, lists large ones",
    "FROM_TRIANGLES",
    "INTO_BUFFER",
    list_large=True,
)
SPLAT_SMALL_TRIANGLES = _generate(
    "splat_small_triangles", "points of small triangles into the maps, lists large ones", "FROM_TRIANGLES", "INTO_MAPS", list_large=True
)
SPLAT_TILES = _generate("splat_tiles", "points of large triangles into the maps", "FROM_TILES", "INTO_MAPS")

LATTICE_VIEWPORT_PX = 64
"""A lattice of 32 cells and a margin have room in it. With lattices side by side instead of one over the other, which would keep more than
one processor of a software rasterizer busy, points took as long."""


def _by_rasterizer(compute: ComputeDeclaration) -> GeometryDeclaration:
    """The same with the rasterizer going over the cells of a lattice."""
    return GeometryDeclaration(
        name=f"{compute.name}_by_rasterizer",
        text=f"{compute.text}, a fragment each",
        geometry_source="generate_points.geom.glsl",
        fragment_source="point_of_cell.frag.glsl",
        most_vertices=6,
        textures=compute.textures,
        images=compute.images,
        constants=compute.constants,
        tables=compute.tables,
        varyings={
            "corners_uv": Varying("vec4", "flat", "the triangle's first two corners in its plane, metres from the centroid"),
            "third_corner_uv": Varying("vec2", "flat", "and its third"),
            "cell_counts": Varying("vec2", "flat", "cells of the lattice"),
            "first_cell": Varying("vec4", "flat", "centre of the first one and their size, in the same plane"),
            "centroid_fs": Varying("vec3", "flat", "of the triangle, face space"),
            "along_u": Varying("vec3", "flat", "axes of the plane, T_align's rows"),
            "along_v": Varying("vec3", "flat", "″"),
            "normal_fs": Varying("vec3", "flat", "″"),
        },
        output_name="fragment",
        output_type="uint",
        flags=compute.flags,
        defines={**compute.defines, "BY_RASTERIZER": 1, "LATTICE_VIEWPORT_PX": LATTICE_VIEWPORT_PX},
    )


BUFFER_TRIANGLES_BY_RASTERIZER = _by_rasterizer(BUFFER_TRIANGLES)
BUFFER_TILES_BY_RASTERIZER = _by_rasterizer(BUFFER_TILES)
SPLAT_TRIANGLES_BY_RASTERIZER = _by_rasterizer(SPLAT_TRIANGLES)
SPLAT_TILES_BY_RASTERIZER = _by_rasterizer(SPLAT_TILES)


def _warp(name: str, text: str, into_buffer: bool) -> RasterDeclaration:
    if into_buffer:
        images = {"counters": COUNTERS, **POINT_STORE}
        constants = {"texel_capacity": Constant("int", "texels of the buffer: a point takes one, a splat two")}
        tables = {"face": FACE_TABLE}
    else:
        images = {"depth_maps": DEPTH_MAPS_ATOMIC}
        constants = {"view_count": VIEW_COUNT}
        tables = {"face": FACE_TABLE, "views": VIEWS_TABLE}
    return RasterDeclaration(
        name=name,
        text=text,
        vertex_source="source_view.vert.glsl",
        fragment_source="source_view.frag.glsl",
        textures={"instances": SCENE_TEXTURES["instances"]},
        images=images,
        constants={
            **constants,
            "first_instance": Constant("int", "instance number of the draw's first instance"),
            "source_eye": Constant("vec3", "the source view's centre, face space"),
            "source_texel": Constant("vec2", "tangents of its texels"),
            "source_depths": Constant("vec2", "from where to where it looks, from its centre"),
            "source_window": Constant("vec4", "first texel of the part to draw on the lattice that starts at tangent 0, and its size"),
        },
        tables=tables,
        varyings={"p_fs": Varying("vec3", "smooth", "the surface's point, face space")},
        output_name="fragment",
        output_type="uint",
        has_depth_test=False,
        flags={} if into_buffer else {flag: SPLAT_FLAGS[flag] for flag in ("NEAR_SURFACES", "FRONT_FACE")},
        defines={**SCENE_DEFINES, "INTO_BUFFER" if into_buffer else "INTO_MAPS": 1},
    )


BUFFER_FRAGMENTS = _warp(
    "buffer_fragments", "all fragments of a view that contains all views of an area light, into the point buffer", True
)
SPLAT_FRAGMENTS = _warp("splat_fragments", "the same, splatted into the maps of a batch as they come", False)
