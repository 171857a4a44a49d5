"""Opacity maps on the device, and what the rasterizer needs to look them up: for cut-out leaves, lace, tinted panes.

    opacity_maps        per map: a texel with width, height, extension and whether it is interpolated; OPACITY_TEXELS texels of its
                        opacity table, each with two entries and their successors; its texels' values, row by row, two to a channel
    cut_out_uvs         one texel a vertex of meshes with an opacity map: u, v, the seed of its triangle's thresholds
    cut_out_instances   one texel an instance: its mesh's first in `cut_out_uvs`, its first in `opacity_maps`

A fragment is drawn if its opacity exceeds a threshold. Over the views of a light the thresholds of a triangle are stratified between 0
and 1, so that a surface of opacity 0.3 hides three views in ten, and no view is noisy; triangles in different planes draw their
thresholds in different orders, so that layers multiply (gpu_shaders/lib/opacity.glsl).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...device.declaration import Constant, RasterDeclaration, Sampled, Varying
from ...device.interface import Device, Texture, split_integers
from ...device.owned import Owned
from ..material import Extension
from ..scene import Mesh, OpacityMap, SceneSnapshot

OPACITY_TEXELS = 128
"""of 256 opacities"""
VALUES_PER_TEXEL = 8
"""Three bytes to a channel would be exact too, but shifts are cheaper than divisions."""

OPACITY_DEFINES = {
    "CUT_OUT": 1,
    "OPACITY_TEXELS": OPACITY_TEXELS,
    # the fourth, to extend, is what no condition changes
    **{f"EXTENSION_{kind.name}": list(Extension).index(kind) for kind in (Extension.REPEAT, Extension.MIRROR, Extension.CLIP)},
}
OPACITY_TEXTURES: Mapping[str, Sampled] = {
    "cut_out_instances": Sampled("sampler2D", "where an instance's uvs and opacity map start"),
    "cut_out_uvs": Sampled("sampler2D", "uv and threshold seed of every vertex of meshes with an opacity map"),
    "opacity_maps": Sampled("sampler2D", "size, opacity table and packed texels of every opacity map"),
}
OPACITY_VARYINGS: Mapping[str, Varying] = {
    "uv": Varying("vec2", "smooth", "place in the opacity map"),
    "map_base": Varying("int", "flat", "the opacity map's first texel in the array"),
    "map_header": Varying("vec4", "flat", "the opacity map's size, extension and whether it is interpolated"),
    "threshold_seed": Varying("uint", "flat", "tells the triangle's order of thresholds"),
}


def of_cut_outs(opaque: RasterDeclaration, name: str, text: str, constants: Mapping[str, Constant]) -> RasterDeclaration:
    """The kernel that does the same for what has an opacity map. constants: what it has to be told besides"""
    return replace(
        opaque,
        name=name,
        text=text,
        textures={**opaque.textures, **OPACITY_TEXTURES},
        constants={**opaque.constants, **constants},
        varyings={**opaque.varyings, **OPACITY_VARYINGS},
        defines={**opaque.defines, **OPACITY_DEFINES},
    )


def pack_opacity_map(opacity_map: OpacityMap) -> np.ndarray:
    """(n, 4) float32 texels of one map."""
    height, width = opacity_map.texels.shape
    header = (width, height, list(Extension).index(opacity_map.extension), opacity_map.is_interpolated)
    values = np.zeros(-(-opacity_map.texels.size // VALUES_PER_TEXEL) * VALUES_PER_TEXEL, np.float32)
    values[: opacity_map.texels.size] = opacity_map.texels.ravel()
    packed = values.reshape(-1, 4, 2) @ np.array([1, 256], np.float32)
    steps = np.column_stack([opacity_map.opacity, np.append(opacity_map.opacity[1:], opacity_map.opacity[-1])])
    return np.concatenate([np.array([header]), steps.reshape(-1, 4), packed]).astype(np.float32)


def _vertex_rows(mesh: Mesh) -> np.ndarray:
    """(n, 4) float32 of `cut_out_uvs`"""
    if mesh.opacity_map is None or mesh.uvs is None:
        return np.zeros((0, 4), np.float32)
    return np.column_stack([mesh.uvs, plane_seeds(mesh), np.zeros(mesh.vertex_count, np.float32)])


NORMAL_STEPS, OFFSET_STEPS = 64, 1024
"""Planes are told apart by so many steps a component of the normal, and across the mesh's extent. Finer than most layers are apart, coarser
than the rounding of triangles that lie in one plane; where it does part them, their edge may show in a coarse estimate."""


def plane_seeds(mesh: Mesh) -> np.ndarray:
    """(vertex_count,) float32 integers below 2^24, the same for all triangles in a plane: two orders of thresholds in one pane would show
    its diagonal. Of a vertex that several planes share, that of one of them."""
    a, b, c = np.moveaxis(mesh.positions_os[mesh.triangles].astype(np.float64), 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    low, high = mesh.bounds_os.astype(np.float64)
    offsets = np.einsum("ni,ni->n", normals, a - low) / max(float((high - low).max()), 1e-300)
    steps = np.column_stack([normals * NORMAL_STEPS, offsets * OFFSET_STEPS])
    # off the middle between steps, where planes through the middle of things and along axes would be
    seeds = np.zeros(len(steps), np.uint32)
    for column in np.floor(steps + 0.3).astype(np.int64).astype(np.uint32).T:
        seeds = (seeds ^ column) * np.uint32(16777619)
        seeds ^= seeds >> np.uint32(15)
    of_vertex = np.zeros(mesh.vertex_count, np.float32)
    of_vertex[mesh.triangles] = (seeds >> np.uint32(8))[:, None]
    return of_vertex


class OpacityMaps:
    """Uploads what of a snapshot has an opacity map."""

    def __init__(self, snapshot: SceneSnapshot, device: Device) -> None:
        maps = {mesh.opacity_map: 0 for mesh in snapshot.meshes if mesh.opacity_map is not None}
        texels = [pack_opacity_map(opacity_map) for opacity_map in maps]
        starts = np.concatenate([[0], np.cumsum([len(part) for part in texels])])
        maps = {opacity_map: int(start) for opacity_map, start in zip(maps, starts, strict=False)}
        uvs = [_vertex_rows(mesh) for mesh in snapshot.meshes]
        uv_bases = np.concatenate([[0], np.cumsum([len(part) for part in uvs])])[:-1]
        map_bases = np.array([0 if mesh.opacity_map is None else maps[mesh.opacity_map] for mesh in snapshot.meshes])
        mesh = snapshot.instances.mesh_index
        with Owned() as owned:
            self.bindings: dict[str, Texture] = {
                "cut_out_instances": owned.own(
                    device.upload_array(np.hstack([split_integers(uv_bases[mesh]), split_integers(map_bases[mesh])]))
                ),
                "cut_out_uvs": owned.own(device.upload_array(np.concatenate(uvs))),
                "opacity_maps": owned.own(device.upload_array(np.concatenate(texels))),
            }
            self._owned = owned.pop_all()

    def release(self) -> None:
        self._owned.close()
