"""A mesh with materials that are not opaque, taken apart: what is opaque, and one part for each opacity map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.mesh_topology import has_outside
from ...core.scene import Mesh
from ..materials.opacity import MaterialOpacity
from .corner_layers import read_material_slots, read_uvs
from .mesh import ExtractedMesh


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
    slot_of_triangle = np.clip(read_material_slots(data, extracted), 0, len(materials) - 1)
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
                uvs[material.uv_map] = read_uvs(data, material.uv_map)
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
    positions = whole.positions_os[used]
    return replace(
        whole,
        positions_os=positions,
        triangles=triangles,
        point_normals_os=None if whole.point_normals_os is None else whole.point_normals_os[used],
        corner_normals_os=None if whole.corner_normals_os is None else whole.corner_normals_os[chosen],
        is_closed=has_outside(positions, triangles),
        material_slot=None if whole.material_slot is None else whole.material_slot[chosen],
        layers={layer: values[chosen] for layer, values in whole.layers.items()},
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
        material_slot=None if whole.material_slot is None else whole.material_slot[chosen],
        layers={layer: values[chosen] for layer, values in whole.layers.items()},
    )
