"""Surfaces that shine, for rays that look for them: a table on the device.

emitters    per instance: how likely a square metre of what shines of it is drawn, 0 where nothing of it is, and whether it is closed; then
            per triangle that may be drawn: its instance, its number within the mesh, and how likely one of those up to it is drawn
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...device.declaration import Constant, Sampled
from ..material_program import LUMINANCE, typical_value
from ..scene import SceneSnapshot

MAX_EMITTING_TRIANGLES = 1 << 18
"""of which one is drawn; other surfaces that shine are met by chance"""
EMITTER_TEXTURES = {"emitters": Sampled("sampler2D", "surfaces that shine, as of core/passes/emitters.py")}
EMITTER_CONSTANTS = {
    "instance_count": Constant("int", "of the scene"),
    "emitter_count": Constant("int", "triangles that shine and may be drawn"),
}


class Emitters(NamedTuple):
    rows: np.ndarray
    """(instance_count + triangle_count, 4) float32 of the table, at least one"""
    triangle_count: int


def no_emitters(snapshot: SceneSnapshot) -> Emitters:
    return Emitters(np.zeros((max(len(snapshot.instances), 1), 4), np.float32), 0)


def pack_emitters(snapshot: SceneSnapshot) -> Emitters:
    """Triangles are drawn by their area and what their object shines on the whole. Of a snapshot with materials."""
    instances = snapshot.instances
    assert instances.material_set is not None
    shining = np.array([typical_value(material.emission) @ LUMINANCE for material in snapshot.materials])
    visible = np.ones(len(instances), bool) if instances.visible_in_reflections is None else instances.visible_in_reflections
    found: list[tuple[int, np.ndarray, np.ndarray]] = []
    for index in np.flatnonzero(visible).tolist():
        of_slots = shining[list(snapshot.material_sets[instances.material_set[index]])]
        if of_slots.max() > 0:
            numbers, areas = _shining_triangles(snapshot, index, of_slots > 0)
            if areas.sum() > 0:
                found.append((index, numbers, of_slots.max() * areas))
    found.sort(key=lambda one: -one[2].sum())
    ends = np.cumsum([len(numbers) for _, numbers, _ in found])
    found = [one for one, end in zip(found, ends, strict=True) if end <= MAX_EMITTING_TRIANGLES]
    if not found:
        return no_emitters(snapshot)
    per_instance = np.zeros((len(instances), 4))
    powers = np.concatenate([each for _, _, each in found])
    total = powers.sum()
    for index, _, _ in found:
        per_instance[index, 1] = snapshot.meshes[instances.mesh_index[index]].is_closed
        per_instance[index, 0] = shining[list(snapshot.material_sets[instances.material_set[index]])].max() / total
    triangles = np.zeros((len(powers), 4))
    triangles[:, 0] = np.repeat([index for index, _, _ in found], [len(numbers) for _, numbers, _ in found])
    triangles[:, 1] = np.concatenate([numbers for _, numbers, _ in found])
    triangles[:, 2] = np.cumsum(powers) / total
    return Emitters(np.concatenate([per_instance, triangles]).astype(np.float32), len(triangles))


def _shining_triangles(snapshot: SceneSnapshot, index: int, is_shining: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers, (n,) int64, and areas in m^2, (n,) float64, of an instance's triangles. is_shining: (slots,) bool"""
    mesh = snapshot.meshes[snapshot.instances.mesh_index[index]]
    numbers = np.arange(mesh.triangle_count)
    if mesh.material_slot is not None:
        # as SurfaceData has it: slots beyond the last are the last
        numbers = np.flatnonzero(is_shining[np.minimum(mesh.material_slot, len(is_shining) - 1)])
    matrix = snapshot.instances.world_from_object[index, :3, :3].astype(np.float64)
    corners = mesh.positions_os[mesh.triangles[numbers]].astype(np.float64) @ matrix.T
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return numbers, areas
