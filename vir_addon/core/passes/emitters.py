"""Surfaces that shine, for rays that look for them: a table on the device.

emitters    per instance: how likely a square metre of what shines of it is drawn, 0 where nothing of it is, whether it is closed, and
            the numbers of up to two maps that leave it out, -1: none; then per triangle that may be drawn: its instance, its number
            within the mesh, and how likely one of those up to it is drawn
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...device.declaration import Constant, Sampled
from ..material_program import LUMINANCE, typical_value
from ..scene import Mesh, SceneSnapshot, has_same_surfaces

MAX_EMITTING_TRIANGLES = 1 << 18
"""of which one is drawn; other surfaces that shine are met by chance, and so are all that opacity cuts out"""
EMITTER_TEXTURES = {"emitters": Sampled("sampler2D", "surfaces that shine, as of core/passes/emitters.py")}
EMITTER_CONSTANTS = {
    "instance_count": Constant("int", "of the scene"),
    "emitter_count": Constant("int", "triangles that shine and may be drawn"),
}


class Emitters(NamedTuple):
    rows: np.ndarray
    """(instance_count + triangle_count, 4) float32 of the table, at least one"""
    triangle_count: int

    def beside_maps(self, without: np.ndarray) -> np.ndarray:
        """The table of a frame: rows, as if there were no maps, and those. without: (instance_count, 2) numbers of maps"""
        rows = self.rows.copy()
        rows[: len(without), 2:] = without
        return rows


def no_emitters(snapshot: SceneSnapshot) -> Emitters:
    return Emitters(np.zeros((max(len(snapshot.instances), 1), 4), np.float32), 0)


def pack_emitters(snapshot: SceneSnapshot) -> Emitters:
    """Triangles are drawn by their area and what their object shines on the whole. Of a snapshot with materials; leaves devices alone."""
    instances = snapshot.instances
    found = _brightest(snapshot)
    per_instance = np.zeros((len(instances), 4))
    numbers, powers = [np.zeros(0, np.int64)], [np.zeros(0)]
    for one in found:
        mesh = snapshot.meshes[instances.mesh_index[one.instance]]
        corners = _corners(mesh, one.numbers) @ instances.world_from_object[one.instance, :3, :3].T
        per_instance[one.instance, :2] = one.radiance, mesh.is_closed
        numbers.append(one.numbers)
        powers.append(one.radiance * np.linalg.norm(_area_vectors(corners), axis=1))
    ends = np.cumsum(np.concatenate(powers))
    if not found or ends[-1] <= 0:
        return no_emitters(snapshot)
    per_instance[:, 0] /= ends[-1]
    triangles = np.zeros((len(ends), 4))
    triangles[:, 0] = np.repeat([one.instance for one in found], [len(one.numbers) for one in found])
    triangles[:, 1] = np.concatenate(numbers)
    triangles[:, 2] = ends / ends[-1]
    return Emitters(np.concatenate([per_instance, triangles]).astype(np.float32), len(triangles))


def has_same_emitters(one: SceneSnapshot, other: SceneSnapshot) -> bool:
    """Whether the table is the same: wherever things stand, but not however large they are."""
    visible = [np.array(each.instances.visible_in_reflections) for each in (one, other)]
    stretched = [each.instances.world_from_object[:, :3, :3] for each in (one, other)]
    return has_same_surfaces(one, other) and np.array_equal(visible[0], visible[1]) and np.array_equal(stretched[0], stretched[1])


class _Shining(NamedTuple):
    instance: int
    radiance: float
    numbers: np.ndarray
    """(n,) int64 of its triangles that shine"""


def _brightest(snapshot: SceneSnapshot) -> list[_Shining]:
    """What shines most, of what the table holds."""
    instances = snapshot.instances
    assert instances.material_set is not None
    shining = np.array([typical_value(material.emission) @ LUMINANCE for material in snapshot.materials])
    of_sets = np.array([shining[list(one)].max() for one in snapshot.material_sets])
    # of a cut-out surface places would be drawn where there is nothing
    is_whole = np.array([mesh.opacity_map is None for mesh in snapshot.meshes], bool)
    may_be_drawn = (of_sets[instances.material_set] > 0) & is_whole[instances.mesh_index]
    if instances.visible_in_reflections is not None:
        may_be_drawn &= instances.visible_in_reflections
    indices = np.flatnonzero(may_be_drawn)
    pairs, pair_of = np.unique(
        np.stack([instances.mesh_index[indices], instances.material_set[indices]], axis=1), axis=0, return_inverse=True
    )
    parts = [_shining_triangles(snapshot.meshes[mesh], shining[list(snapshot.material_sets[slots])] > 0) for mesh, slots in pairs.tolist()]
    spreads = np.array([spread for _, spread in parts]).reshape(-1, 3, 3)[pair_of]
    powers = of_sets[instances.material_set[indices]] * _stretched_areas(spreads, instances.world_from_object[indices, :3, :3])
    kept, count = [], 0
    for k in np.argsort(-powers, kind="stable").tolist():
        numbers, _ = parts[pair_of[k]]
        if powers[k] > 0 and count + len(numbers) <= MAX_EMITTING_TRIANGLES:
            kept.append(_Shining(int(indices[k]), float(of_sets[instances.material_set[indices[k]]]), numbers))
            count += len(numbers)
    return kept


def _shining_triangles(mesh: Mesh, is_shining: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers, (n,) int64, and the sum over triangles of the area times the outer product of the normal with itself, (3, 3) m^2 in object
    space; zero where they are too many. is_shining: (slots,) bool"""
    numbers = np.arange(mesh.triangle_count)
    if mesh.material_slot is not None:
        # as SurfaceData has it: slots beyond the last are the last
        numbers = np.flatnonzero(is_shining[np.minimum(mesh.material_slot, len(is_shining) - 1)])
    if len(numbers) > MAX_EMITTING_TRIANGLES:
        return numbers, np.zeros((3, 3))
    vectors = _area_vectors(_corners(mesh, numbers))
    areas = np.linalg.norm(vectors, axis=1, keepdims=True)
    return numbers, vectors.T @ np.divide(vectors, areas, out=np.zeros_like(vectors), where=areas > 0)


def _stretched_areas(spreads: np.ndarray, world_from_object: np.ndarray) -> np.ndarray:
    """(n,) m^2 in the world, without going through triangles: exact where an instance's are all stretched alike, otherwise a bound
    (Cauchy-Schwarz). spreads: (n, 3, 3) as of `_shining_triangles`, world_from_object: (n, 3, 3)"""
    x, y, z = np.moveaxis(world_from_object.astype(np.float64), 1, 0)
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    squared = np.einsum("nii->n", spreads) * np.einsum("nij,njk,nik->n", cofactors, spreads, cofactors)
    return np.sqrt(np.maximum(squared, 0.0))


def _corners(mesh: Mesh, numbers: np.ndarray) -> np.ndarray:
    """(n, 3, 3) float64"""
    return mesh.positions_os[mesh.triangles[numbers]].astype(np.float64)


def _area_vectors(corners: np.ndarray) -> np.ndarray:
    """(n, 3) normals as long as triangles are large. corners: (n, 3, 3)"""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
