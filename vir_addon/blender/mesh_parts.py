"""A mesh with materials that are not opaque, taken apart: what is opaque, and one part for each opacity map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.scene import Mesh
from .extract_mesh import ExtractedMesh
from .material_opacity import MaterialOpacity
from .mesh_topology import is_closed

_LARGEST_UV = 2.0**20
"""Farther out float32 no longer tells an image's texels apart."""


@dataclass(frozen=True)
class MeshPart:
    mesh: Mesh
    is_visible: bool = True
    """to the camera"""
    casts: bool = True


def split_mesh(
    data: bpy.types.Mesh, extracted: ExtractedMesh, materials: Sequence[MaterialOpacity | None]
) -> tuple[list[MeshPart], list[str]]:
    """Parts, and reasons why some are opaque although their materials are not.

    data: what `extracted`, with triangles, was made of; materials: one a slot, None for opaque ones.
    """
    whole = extracted.mesh
    assert whole is not None
    slot = np.clip(_read_material_index(data), 0, len(materials) - 1)
    slot_of_triangle = slot if extracted.corners is None else slot[_faces_of_triangles(data, extracted)]
    is_opaque = np.array([material is None for material in materials])[slot_of_triangle]
    missing: list[str] = []
    parts: list[MeshPart] = []
    uvs: dict[str | None, np.ndarray | None] = {}
    for index, material in enumerate(materials):
        chosen = np.flatnonzero(slot_of_triangle == index)
        if material is None or not len(chosen):
            continue
        if material.has_opaque_shadow:
            parts.append(MeshPart(_opaque_part(whole, chosen), is_visible=False))
        if material.opacity_map is None:
            continue
        if material.opacity_map.texels.size == 1:
            corner_uvs: np.ndarray | None = np.zeros((len(data.loops), 2), np.float32)
        else:
            if material.uv_map not in uvs:
                uvs[material.uv_map] = _read_uvs(data, material.uv_map)
            corner_uvs = uvs[material.uv_map]
        if corner_uvs is None:
            uv_map = f"UV map '{material.uv_map}'" if material.uv_map else "UV map"
            missing.append(f"counts as opaque where its material is {material.name}: it has no {uv_map}")
            is_opaque[chosen] = True
            continue
        parts.append(MeshPart(_cut_out_part(whole, chosen, extracted.corners, corner_uvs, material), casts=not material.has_opaque_shadow))
    if is_opaque.all():
        return [MeshPart(whole)], missing
    if is_opaque.any():
        parts.insert(0, MeshPart(_opaque_part(whole, np.flatnonzero(is_opaque))))
    return parts, missing


def _opaque_part(whole: Mesh, chosen: np.ndarray) -> Mesh:
    used, triangles = np.unique(whole.triangles[chosen], return_inverse=True)
    triangles = triangles.reshape(-1, 3).astype(np.int32)
    return replace(
        whole,
        positions_os=whole.positions_os[used],
        triangles=triangles,
        point_normals_os=None if whole.point_normals_os is None else whole.point_normals_os[used],
        corner_normals_os=None if whole.corner_normals_os is None else whole.corner_normals_os[chosen],
        is_closed=is_closed(triangles, len(used)),
    )


def _cut_out_part(whole: Mesh, chosen: np.ndarray, corners: np.ndarray | None, corner_uvs: np.ndarray, material: MaterialOpacity) -> Mesh:
    """Every triangle has its own vertices: corners that share one may differ in their uvs."""
    vertices = whole.triangles[chosen].ravel()
    places = corner_uvs.reshape(-1, 3, 2)[chosen] if corners is None else corner_uvs[corners[chosen]]
    normals = None
    if whole.corner_normals_os is not None:
        normals = whole.corner_normals_os[chosen].reshape(-1, 3)
    elif whole.point_normals_os is not None:
        normals = whole.point_normals_os[vertices]
    rows = np.array(material.uv_rows)
    return Mesh(
        name=whole.name,
        positions_os=whole.positions_os[vertices],
        triangles=np.arange(len(vertices), dtype=np.int32).reshape(-1, 3),
        point_normals_os=normals,
        opacity_map=material.opacity_map,
        uvs=(places.reshape(-1, 2) @ rows[:, :2].T + rows[:, 2]).astype(np.float32),
    )


def _read_material_index(data: bpy.types.Mesh) -> np.ndarray:
    """(face_count,) int32"""
    slot = np.zeros(len(data.polygons), np.int32)
    attribute = data.attributes.get("material_index")
    if attribute is not None:
        attribute.data.foreach_get("value", slot)
    return slot


def _faces_of_triangles(data: bpy.types.Mesh, extracted: ExtractedMesh) -> np.ndarray:
    """(triangle_count,) int32"""
    faces = np.empty(len(data.loop_triangles), np.int32)
    data.loop_triangle_polygons.foreach_get("value", faces)
    return faces if extracted.is_kept is None else faces[extracted.is_kept]


def _read_uvs(data: bpy.types.Mesh, name: str | None) -> np.ndarray | None:
    """(corner_count, 2) float32, or None if the mesh has no such UV map"""
    names = [layer.name for layer in data.uv_layers if (layer.active_render if name is None else layer.name == name)]
    if not names:
        return None
    uvs = np.empty((len(data.loops), 2), np.float32)
    data.attributes[names[0]].data.foreach_get("vector", uvs.reshape(-1))
    return np.clip(np.nan_to_num(uvs), -_LARGEST_UV, _LARGEST_UV)
