"""Depth maps of a batch of views of one face, and what all kernels that fill or look them up share.

The maps of a batch are one R32UI texture, stacked from bottom to top: bits of positive floats (linear depth in metres),
so that the smallest depth is the smallest integer; EMPTY_DEPTH_BITS where nothing is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...device.declaration import Constant, RasterDeclaration, Sampled, Stored, Table
from ...device.interface import Device, RenderTarget, Texture, TextureFormat
from ...device.owned import Owned
from ..sampling import sample_patch_m
from ..scene import Light
from ..views import FaceViews, light_axes
from .opacity_maps import of_cut_outs
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES

MAX_BATCH_VIEWS = 8
"""Maps that exist at the same time. More would leave the caches: 64 at once took up to 4 times longer a look-up."""
BYTES_PER_TEXEL = 4
MAX_HULL_CORNERS = 8
MIN_BLEND_COSINE = 1e-7
"""of a spot without blend: float32 tells cosines apart no finer"""

FACE_TABLE = Table(
    13,
    "rows of face_from_world, texel size and map size, depths, light's axis and spread, inverse sizes and a sample's patch, radius and "
    "spot, light_from_world, right and up of a spot's cone",
    has_named_rows=True,
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
    writes_depth=True,
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

WORK_TABLE = Sampled("sampler2D", "instance, first triangle, triangle count and two-sidedness of every work group")
PORTION_CONSTANTS = {
    "group_count": Constant("int", "work groups of this portion"),
    "first_group": Constant("int", "the portion's first work group"),
}

SEEN_SPACE_TABLES = {
    "hull": Table(MAX_HULL_CORNERS, "corners of a box around all view centres (face space); of suns, around their directions"),
    "seen_space": Table(6, "planes around everything that any view sees: dot(xyz, p) >= w inside"),
}
SEEN_SPACE_CONSTANTS = {"hull_count": Constant("int", "corners of the hull")}


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
    table[5, 3] = math.tan(light.spread_rad / 2) if light.is_spread_limited else 0.0
    table[6] = 1 / views.texel_tangent[0], 1 / views.texel_tangent[1], max(views.texel_tangent), sample_patch_m(light, len(views.samples_m))
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
        self._owned_by_target = self._owned.enter_context(Owned())

    @property
    def target(self) -> RenderTarget:
        if self._target is None:
            depth = self._owned_by_target.own(self.device.create_texture(self.texture.width, self.texture.height, TextureFormat.DEPTH32F))
            self._target = self._owned_by_target.own(self.device.create_target(self.texture, depth))
        return self._target

    def release_target(self) -> None:
        """When nothing more is drawn, or not for a while."""
        self._owned_by_target.close()
        self._target = None

    def release(self) -> None:
        self._owned.close()
