"""What materials ask of a mesh: the slot of every triangle, and uvs and colours at its corners."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import bpy
import numpy as np

from ...core.material import Layer, LayerKind
from ...core.scene import Mesh
from .mesh import ExtractedMesh

_LARGEST_UV = 2.0**20
"""Farther out float32 no longer tells an image's texels apart."""
_MOST_SLOTS = 256
_CHANNELS = {
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT2": ("vector", 2),
    "FLOAT": ("value", 1),
}
"""type of an attribute -> what it is read as, and how many numbers there are"""


def with_layers(data: bpy.types.Mesh, extracted: ExtractedMesh, layers: Iterable[Layer]) -> Mesh:
    """The extracted mesh with its triangles' slots and with those of the layers that the Blender mesh has."""
    mesh = extracted.mesh
    assert mesh is not None
    slots = np.clip(read_material_slots(data, extracted), 0, _MOST_SLOTS - 1).astype(np.uint8)
    found = {layer: _read_layer(data, extracted, layer) for layer in layers}
    values = {layer: of_corners for layer, of_corners in found.items() if of_corners is not None}
    return replace(mesh, material_slot=slots if slots.any() else None, layers=values)


def _read_layer(data: bpy.types.Mesh, extracted: ExtractedMesh, layer: Layer) -> np.ndarray | None:
    """(triangle_count, 3, 2 or 3) float32"""
    if layer.kind is LayerKind.UV:
        uvs = read_uvs(data, layer.name or None)
        return None if uvs is None else _of_triangles(uvs, extracted)
    if layer.kind is LayerKind.GENERATED:
        return _read_generated(data, extracted)
    attributes = data.color_attributes
    name = layer.name
    if not name and 0 <= attributes.render_color_index < len(attributes):
        name = attributes[attributes.render_color_index].name
    attribute = data.attributes.get(name) if name else None
    if attribute is None or attribute.data_type not in _CHANNELS or attribute.domain not in ("POINT", "CORNER", "FACE"):
        return None
    key, channel_count = _CHANNELS[attribute.data_type]
    values = np.empty((len(attribute.data), channel_count), np.float32)
    attribute.data.foreach_get(key, values.reshape(-1))
    colors = np.zeros((len(values), 3), np.float32)
    colors[:] = values[:, :1] if channel_count == 1 else 0.0
    colors[:, : min(channel_count, 3)] = values[:, :3]
    if not np.isfinite(colors.sum()):
        colors = np.nan_to_num(colors)
    if attribute.domain == "CORNER":
        return _of_triangles(colors, extracted)
    if attribute.domain == "POINT":
        assert extracted.mesh is not None
        return colors[extracted.mesh.triangles]
    return np.repeat(colors[_faces_of_triangles(data, extracted)][:, None], 3, axis=1)


def _read_generated(data: bpy.types.Mesh, extracted: ExtractedMesh) -> np.ndarray:
    """(triangle_count, 3, 3) float32"""
    assert extracted.mesh is not None
    places = np.empty((len(data.vertices), 3), np.float32)
    data.vertices.foreach_get("undeformed_co", places.reshape(-1))
    location, size = np.array(data.texspace_location, np.float32), np.array(data.texspace_size, np.float32)
    places -= location
    places /= np.where(size != 0.0, 2.0 * size, np.float32(1.0))
    return np.nan_to_num(places + np.float32(0.5))[extracted.mesh.triangles]


def _of_triangles(of_corners: np.ndarray, extracted: ExtractedMesh) -> np.ndarray:
    return of_corners.reshape(-1, 3, of_corners.shape[1]) if extracted.corners is None else np.take(of_corners, extracted.corners, axis=0)


def read_material_slots(data: bpy.types.Mesh, extracted: ExtractedMesh) -> np.ndarray:
    """(triangle_count,) int32, as they are written in the file: not all of them need exist"""
    slot = _read_material_index(data)
    return slot if extracted.corners is None else slot[_faces_of_triangles(data, extracted)]


def _read_material_index(data: bpy.types.Mesh) -> np.ndarray:
    """(face_count,) int32"""
    slot = np.zeros(len(data.polygons), np.int32)
    attribute = data.attributes.get("material_index")
    if attribute is not None:
        attribute.data.foreach_get("value", slot)
    return slot


def _faces_of_triangles(data: bpy.types.Mesh, extracted: ExtractedMesh) -> np.ndarray:
    """(triangle_count,) int32"""
    if extracted.corners is None:
        return np.arange(len(data.polygons), dtype=np.int32)
    faces = np.empty(len(data.loop_triangles), np.int32)
    data.loop_triangle_polygons.foreach_get("value", faces)
    return faces if extracted.is_kept is None else faces[extracted.is_kept]


def read_uvs(data: bpy.types.Mesh, name: str | None) -> np.ndarray | None:
    """(corner_count, 2) float32, or None if the mesh has no such UV map"""
    names = [layer.name for layer in data.uv_layers if (layer.active_render if name is None else layer.name == name)]
    if not names:
        return None
    uvs = np.empty((len(data.loops), 2), np.float32)
    data.attributes[names[0]].data.foreach_get("vector", uvs.reshape(-1))
    # a NaN is in no range
    if uvs.size and not (uvs.min() >= -_LARGEST_UV and uvs.max() <= _LARGEST_UV):
        return np.clip(np.nan_to_num(uvs), -_LARGEST_UV, _LARGEST_UV)
    return uvs
