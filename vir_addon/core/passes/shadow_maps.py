"""Depth maps of a batch of views of one face: drawn by the rasterizer or splatted from points, then looked up.

The maps of a batch are one R32UI texture, stacked from bottom to top: bits of positive floats (linear depth in metres),
so that the smallest depth is the smallest integer; EMPTY_DEPTH_BITS where nothing is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, GeometryDeclaration, RasterDeclaration, Sampled, Stored, Table, Varying
from ...device.interface import Device, RenderTarget, Texture, TextureFormat
from ...device.owned import Owned
from ..scene import Light
from ..views import FaceViews, light_axes
from .accumulate import ROUND_SUMS_TEXT, SETTLED_DEFINES
from .opacity_maps import of_cut_outs
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE
from .tiles import PROBES_FLAG, SIZE_CONSTANTS, TILE_CONSTANTS, TILE_DEFINES, TILE_PX, TILE_TEXTURES

MAX_BATCH_VIEWS = 8
"""Maps that exist at the same time. More would leave the caches: 64 at once took up to 4 times longer a look-up."""
MAX_HULL_CORNERS = 8
MIN_BLEND_COSINE = 1e-7
"""of a spot without blend: float32 tells cosines apart no finer"""

FACE_TABLE = Table(
    13,
    "rows of face_from_world, texel size and map size, depths, light's axis and spread, inverse sizes, radius and spot, "
    "light_from_world, right and up of a spot's cone",
)
VIEWS_TABLE = Table(
    2 * MAX_BATCH_VIEWS,
    "two rows a view: centre (face space), first row of its map; window's place on the lattice, centre in the light's plane (suns: shear)",
)
SAMPLES_TABLE = Table(MAX_BATCH_VIEWS, "light samples (light space; suns: unit directions of rays) and what each counts")
VIEW_COUNT = Constant("int", "views in this batch")
DEPTH_MAPS_ATOMIC = Stored("R32UI", "atomic", "depth maps of the batch")

ORTHOGRAPHIC_FLAG = {"ORTHOGRAPHIC": "views of a sun: parallel, sheared by its directions"}
MIXED_MAPS_FLAG = {"MIXED_MAPS": "points and rasterized triangles share the maps: the lowest bit of a point's depth is set"}

RASTERIZE_DEPTH = RasterDeclaration(
    name="depth_map",
    text="rasterizes linear depth of one view",
    vertex_source="depth_map.vert.glsl",
    fragment_source="depth_map.frag.glsl",
    textures={"instances": SCENE_TEXTURES["instances"]},
    constants={
        "first_instance": Constant("int", "instance number of the draw's first instance"),
        "view_index": Constant("int", "which view of the batch"),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    output_name="depth_bits",
    output_type="uint",
    flags={**ORTHOGRAPHIC_FLAG, **MIXED_MAPS_FLAG, "PLACED": "the vertices are in face space already"},
    defines=SCENE_DEFINES,
)

RASTERIZE_CUT_OUTS = replace(
    of_cut_outs(
        RASTERIZE_DEPTH,
        "depth_map_cut_outs",
        "rasterizes linear depth of what has an opacity map",
        {"map_number": Constant("int", "maps drawn before this one; each has thresholds of its own")},
    ),
    # cut-outs are never placed beforehand
    flags={**ORTHOGRAPHIC_FLAG, **MIXED_MAPS_FLAG},
)

FRONT_FACE = "all views lie in the plane that the face looks away from"
SPLAT_FLAGS = {
    **ORTHOGRAPHIC_FLAG,
    **MIXED_MAPS_FLAG,
    "NEAR_SURFACES": "something casts from nearer than the light's diameter: points there cover several texels",
    "FRONT_FACE": FRONT_FACE,
}
WORK_TABLE = Sampled("sampler2D", "instance, first triangle, triangle count and two-sidedness of every work group")
PORTION_CONSTANTS = {
    "group_count": Constant("int", "work groups of this portion"),
    "first_group": Constant("int", "the portion's first work group"),
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

SEEN_SPACE_TABLES = {
    "hull": Table(MAX_HULL_CORNERS, "corners of a box around all view centres (face space); of suns, around their directions"),
    "seen_space": Table(6, "planes around everything that any view sees: dot(xyz, p) >= w inside"),
}
SEEN_SPACE_CONSTANTS = {"hull_count": Constant("int", "corners of the hull")}
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
PARTS_TEXT = "two texels a part of a large triangle: instance and triangle; corner and size"
PART_CAPACITY = Constant("int", "parts that the list holds")
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
            constants["part_capacity"] = PART_CAPACITY
    else:
        textures["tile_list"] = Sampled("sampler2D", "tiles of large triangles")
        constants |= {"first_tile": Constant("int", "the first tile to sample"), "tile_count": Constant("int", "tiles to sample")}
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
        "part_capacity": PART_CAPACITY,
        "tile_capacity": Constant("int", "tiles that the list holds"),
        "may_leave_parts": Constant("int", "0: what is still too large becomes a tile, sampled too sparsely"),
    },
    tables=SAMPLING_TABLES,
    flags=SAMPLING_FLAGS,
    defines={**SCENE_DEFINES, "FROM_PARTS": 1},
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

GATHERED_TRIANGLES_TEXT = (
    "three texels a triangle, its corners in face space, those of small ones with FRONT_FACE as x/z and y/z in texels and 1/z, "
    "with ORTHOGRAPHIC as x and y in texels and z; w: instance"
)
SMALL_EXTENT_TEXELS = 11.0
"""Edge functions of corners in 256ths of a texel stay below 2^24, which float32 holds exactly."""

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
        "kept_triangles": Stored("RGBA32F", "write", GATHERED_TRIANGLES_TEXT),
    },
    constants={
        "view_count": VIEW_COUNT,
        "triangle_count": Constant("int", "small triangles in the list"),
        "triangle_capacity": Constant("int", "triangles that the new list holds"),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags={**ORTHOGRAPHIC_FLAG, "FRONT_FACE": FRONT_FACE},
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
    constants={"view_count": VIEW_COUNT, "triangle_count": Constant("int", "small triangles in the list")},
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE},
    flags={**ORTHOGRAPHIC_FLAG, "FRONT_FACE": FRONT_FACE},
)

LOOKED_UP_VIEWS = {
    "first_view": Constant("int", "the first view of the batch to look up"),
    "view_count": Constant("int", "how many to look up"),
}

TILE_FACES = ComputeDeclaration(
    name="tile_faces",
    text="finds the faces of a light's cube that each tile of the picture needs",
    source="tile_faces.comp.glsl",
    local_size=(8, 8, 1),
    textures={"positions": Sampled("sampler2D", "position (world space) and instance number, -1 for the background")},
    images={"tile_faces": Stored("R32UI", "write", "a bit a face")},
    constants={**SIZE_CONSTANTS, **LOOKED_UP_VIEWS},
    tables={"face": FACE_TABLE, "samples": SAMPLES_TABLE},
    defines={"TILE_PX": TILE_PX},
)

LATE_FACES = 0x3F
FIRST_FACE = 0x40
LAST_FACE = 0x80
WAS_LIT = 0x100
TURN_DEFINES = {"LATE_FACES": LATE_FACES, "FIRST_FACE": FIRST_FACE, "LAST_FACE": LAST_FACE, "WAS_LIT": WAS_LIT}
"""What RESOLVE knows of a tile's turn in a round: faces before this one that count as they did before, as lit or as dark, and whether it
begins or ends the round's sums."""

RESOLVE = ComputeDeclaration(
    name="resolve",
    text="looks visible surfaces up in the maps of a batch and accumulates the pass",
    source="resolve.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        "positions": Sampled("sampler2D", "position (world space) and instance number, -1 for the background"),
        "normals": Sampled("sampler2D", "geometric normal (world space) and packed shading normal"),
        "depth_maps": Sampled("usampler2D", "depth maps of the batch"),
        "receivers": Sampled("sampler2D", "x: whether an instance receives this light; read with RECEIVER_LINKING"),
        **TILE_TEXTURES,
    },
    images={
        "round_sums": Stored("RGBA32F", "read_write", ROUND_SUMS_TEXT),
        "batch_sums": Stored("RGBA32F", "read_write", "s and d of the faces of this round so far"),
        "disagreeing": Stored("R32UI", "write", "with PROBES: 1 for tiles of which a pixel is not as all of them were before"),
    },
    constants={
        **SIZE_CONSTANTS,
        **TILE_CONSTANTS,
        **LOOKED_UP_VIEWS,
        "map_face": Constant("int", "number of the face that the maps are of; with MANY_FACES"),
        "face_mask": Constant(
            "int", "faces that this dispatch looks up: that of the maps and, in the first, all without casters; MANY_FACES"
        ),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE, "samples": SAMPLES_TABLE},
    flags={
        **ORTHOGRAPHIC_FLAG,
        "OMNI": "the light shines from its centre to all sides, not from a plane",
        "SPHERE": "with OMNI: from a sphere around its centre",
        "CONE": "with OMNI: into a spot's cone only",
        "RECEIVER_LINKING": "leave out instances that the light does not illuminate",
        "MANY_FACES": "several faces share the directions",
        "POINT_MAPS": "the maps were splatted: undo the half texel by which that enlarges outlines",
        **PROBES_FLAG,
        **MIXED_MAPS_FLAG,
    },
    defines={**TILE_DEFINES, **TURN_DEFINES, **SETTLED_DEFINES},
)


def face_table(views: FaceViews, light: Light, reference_m: float | None = None) -> np.ndarray:
    """(13, 4) float64 rows of FACE_TABLE. Composed in float64: the light may stand far from what it lights.

    reference_m: the distance at which the light delivers 1. A pixel sums over all faces, so they must share it; by default, for
    making maps only, the face's own far_m.
    """
    table = np.zeros((FACE_TABLE.length, 4))
    for row, rotation in ((0, views.face.face_from_world), (8, light_axes(light))):
        table[row : row + 3, :3] = rotation
        table[row : row + 3, 3] = -rotation @ views.origin_ws
    table[3] = *views.texel_tangent, views.map_width_px, views.map_height_px
    table[4] = views.near_m, views.far_m, (reference_m or views.far_m) ** 2, views.light_diameter_m
    table[5, :3] = views.face.face_from_world @ light_axes(light)[2]
    table[5, 3] = 0.0 if light.spread_rad >= math.pi - 1e-4 else math.tan(light.spread_rad / 2)
    table[6, :3] = 1 / views.texel_tangent[0], 1 / views.texel_tangent[1], max(views.texel_tangent)
    cosine = math.cos(light.cone_rad / 2)
    # Blender's: smoothstep of the cosine from the cone's edge, 0, to where the blend ends, 1
    table[7] = light.radius_m, light.has_soft_falloff, cosine, 1 / max((1 - cosine) * light.cone_blend, MIN_BLEND_COSINE)
    table[11:13, :3] = views.face.face_from_world @ light_axes(light)[0], views.face.face_from_world @ light_axes(light)[1]
    table[11:13, :3] /= np.maximum(light.cone_scale, 1e-6)[:, None]
    return table


def samples_table(views: FaceViews, weights: np.ndarray, selected: range) -> np.ndarray:
    """(len(selected), 4) rows of SAMPLES_TABLE. weights: (view_count,)"""
    part = slice(selected.start, selected.stop)
    samples = views.samples_m[part]
    if views.is_orthographic:
        samples = np.add(samples, (0, 0, 1))
        samples = samples / np.linalg.norm(samples, axis=1, keepdims=True)
    return np.column_stack([samples, weights[part]])


def views_table(views: FaceViews, selected: range) -> np.ndarray:
    """(2 * len(selected), 4) rows of VIEWS_TABLE; the maps are stacked in the order of `selected`."""
    table = np.zeros((2 * len(selected), 4))
    table[0::2, :3] = views.centers_fs[selected.start : selected.stop]
    table[0::2, 3] = np.arange(len(selected)) * views.map_height_px
    table[1::2, :2] = views.window_texels[selected.start : selected.stop]
    table[1::2, 2:] = views.samples_m[selected.start : selected.stop, :2]
    return table


class DepthMaps:
    """The texture of a batch's maps; the depth attachment exists only once the rasterizer asks for it."""

    def __init__(self, device: Device, width_px: int, height_px: int, view_count: int) -> None:
        self.device, self.view_count = device, view_count
        self.width_px, self.height_px = width_px, height_px
        self._owned = Owned()
        self.texture: Texture = self._owned.own(device.create_texture(width_px, height_px * view_count, TextureFormat.R32UI))
        self._target: RenderTarget | None = None

    @property
    def target(self) -> RenderTarget:
        if self._target is None:
            depth = self._owned.own(self.device.create_texture(self.texture.width, self.texture.height, TextureFormat.DEPTH32F))
            self._target = self._owned.own(self.device.create_target(self.texture, depth))
        return self._target

    def release(self) -> None:
        self._owned.close()
