"""Opacity maps on the device, and what the rasterizer needs to look them up: for cut-out leaves, lace, tinted panes.

    opacity_maps        per map: a texel with width, height, extension and whether it is interpolated; OPACITY_TEXELS texels of its
                        opacity table; its texels' values, row by row, three to a channel
    cut_out_uvs         one texel a vertex of meshes with an opacity map: u, v
    cut_out_instances   one texel an instance: its mesh's first in `cut_out_uvs`, its first in `opacity_maps`

A fragment is drawn if its opacity exceeds a threshold. Over the views of a light the thresholds of a triangle are stratified between 0
and 1, so that a surface of opacity 0.3 hides three views in ten, and no view is noisy; different triangles draw their thresholds in
different orders, so that layers multiply (gpu_shaders/lib/opacity.glsl).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...device.declaration import Sampled, Varying
from ...device.interface import Device, Texture, split_integers
from ..scene import Extension, OpacityMap, SceneSnapshot

OPACITY_TEXELS = 64
"""256 opacities, four to a texel"""
VALUES_PER_TEXEL = 12
"""three bytes are an integer that float32 holds exactly"""

OPACITY_DEFINES = {
    "CUT_OUT": 1,
    "OPACITY_TEXELS": OPACITY_TEXELS,
    # the fourth, to extend, is what no condition changes
    **{f"EXTENSION_{kind.name}": list(Extension).index(kind) for kind in (Extension.REPEAT, Extension.MIRROR, Extension.CLIP)},
}
OPACITY_TEXTURES: Mapping[str, Sampled] = {
    "cut_out_instances": Sampled("sampler2D", "where an instance's uvs and opacity map start"),
    "cut_out_uvs": Sampled("sampler2D", "uv of every vertex of meshes with an opacity map"),
    "opacity_maps": Sampled("sampler2D", "size, opacity table and packed texels of every opacity map"),
}
OPACITY_VARYINGS: Mapping[str, Varying] = {
    "uv": Varying("vec2", "smooth", "place in the opacity map"),
    "map_base": Varying("int", "flat", "the opacity map's first texel in the array"),
    "threshold_seed": Varying("uint", "flat", "tells the triangle's order of thresholds"),
}


def pack_opacity_map(opacity_map: OpacityMap) -> np.ndarray:
    """(n, 4) float32 texels of one map."""
    height, width = opacity_map.texels.shape
    header = (width, height, list(Extension).index(opacity_map.extension), opacity_map.is_interpolated)
    values = np.zeros(-(-opacity_map.texels.size // VALUES_PER_TEXEL) * VALUES_PER_TEXEL, np.float32)
    values[: opacity_map.texels.size] = opacity_map.texels.ravel()
    packed = values.reshape(-1, 4, 3) @ np.array([1, 256, 65536], np.float32)
    return np.concatenate([np.array([header], np.float32), opacity_map.opacity.reshape(-1, 4).astype(np.float32), packed])


class OpacityMaps:
    """Uploads what of a snapshot has an opacity map."""

    def __init__(self, snapshot: SceneSnapshot, device: Device) -> None:
        maps = {mesh.opacity_map: 0 for mesh in snapshot.meshes if mesh.opacity_map is not None}
        texels = [pack_opacity_map(opacity_map) for opacity_map in maps]
        starts = np.concatenate([[0], np.cumsum([len(part) for part in texels])])
        maps = {opacity_map: int(start) for opacity_map, start in zip(maps, starts, strict=False)}
        uvs = [mesh.uvs if mesh.uvs is not None else np.zeros((0, 2), np.float32) for mesh in snapshot.meshes]
        uv_bases = np.concatenate([[0], np.cumsum([len(part) for part in uvs])])[:-1]
        map_bases = np.array([0 if mesh.opacity_map is None else maps[mesh.opacity_map] for mesh in snapshot.meshes])
        mesh = snapshot.instances.mesh_index
        self.bindings: dict[str, Texture] = {
            "cut_out_instances": device.upload_array(np.hstack([split_integers(uv_bases[mesh]), split_integers(map_bases[mesh])])),
            "cut_out_uvs": device.upload_array(np.pad(np.concatenate(uvs), ((0, 0), (0, 2)))),
            "opacity_maps": device.upload_array(np.concatenate(texels)),
        }

    def release(self) -> None:
        for texture in self.bindings.values():
            texture.release()
