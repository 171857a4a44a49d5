"""Boxes around meshes and instances, computed once, by the plan, for planning, fitting and culling."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from .scene import SceneSnapshot

FLAT_TOLERANCE = 1e-5
"""thickness over extent below which a mesh counts as flat"""
SAME_SIZE = 1e-4
"""share by which sizes may differ and count as one: rounding does not choose between objects that are equally large"""


@dataclass(frozen=True)
class SceneBounds:
    mesh_bounds_os: np.ndarray
    """(mesh_count, 2, 3) float64 smallest and largest corners"""
    flat_axis: np.ndarray
    """(mesh_count,) int64 axis along which the mesh has no thickness, -1 for others"""
    corners_ws: np.ndarray
    """(instance_count, 8, 3) float64 corners of the instances' boxes"""
    yardstick_m: float
    """diagonal of a box: that of the largest instance that stays, or of the largest where none does. A length that grows with the scene
    and is the same in other frames; 1 where nothing has a size"""
    yardstick_ws: np.ndarray
    """(3,) float64 the middle of that box"""

    @functools.cached_property
    def extents_ws(self) -> np.ndarray:
        """(2, 3, instance_count) float64 smallest and largest of the corners: one axis at a time, as all lights ask for them"""
        corners = np.ascontiguousarray(self.corners_ws.transpose(1, 2, 0))  # the middle axis of (n, 8, 3) takes five times as long
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def distances_m(self, indices: np.ndarray, place_ws: np.ndarray) -> np.ndarray:
        """(n,) float64 from a place, (3,), to instances, the mean of their boxes' corners: of what is around the place, and of a wall
        beside it, the surface is where its box ends"""
        return np.linalg.norm(self.corners_ws[indices] - place_ws, axis=-1).mean(axis=-1)


def compute_bounds(snapshot: SceneSnapshot) -> SceneBounds:
    mesh_bounds_os = np.array([mesh.bounds_os for mesh in snapshot.meshes], np.float64).reshape(-1, 2, 3)
    extent = mesh_bounds_os[:, 1] - mesh_bounds_os[:, 0]
    flat = extent.min(axis=1, initial=np.inf) <= FLAT_TOLERANCE * extent.max(axis=1, initial=0)
    flat_axis = np.where(flat, extent.argmin(axis=1), -1) if len(extent) else np.zeros(0, np.int64)
    pick = np.array([[(i >> axis) & 1 for axis in range(3)] for i in range(8)])
    corners_os = mesh_bounds_os[:, pick, np.arange(3)][snapshot.instances.mesh_index]
    matrix = snapshot.instances.world_from_object.astype(np.float64)
    corners_ws = np.einsum("nij,nkj->nki", matrix[:, :3, :3], corners_os) + matrix[:, None, :3, 3]
    # turning an object leaves the lengths of its box's sides alone
    sides_m = np.linalg.norm(matrix[:, :3, :3], axis=1) * extent[snapshot.instances.mesh_index]
    sizes_m = np.linalg.norm(sides_m, axis=1)
    if not sizes_m.any():
        return SceneBounds(mesh_bounds_os, flat_axis, corners_ws, 1.0, np.zeros(3))
    staying_m = sizes_m if snapshot.instances.stays is None else sizes_m * snapshot.instances.stays
    candidates_m = staying_m if staying_m.any() else sizes_m
    largest = int(np.argmax(candidates_m >= (1 - SAME_SIZE) * candidates_m.max()))
    return SceneBounds(mesh_bounds_os, flat_axis, corners_ws, float(sizes_m[largest]), corners_ws[largest].mean(axis=0))


def cullable_instances(snapshot: SceneSnapshot, bounds: SceneBounds, eyes_ws: np.ndarray | None) -> np.ndarray:
    """(instance_count,) bool: instances whose back faces need not be drawn from any of the eyes, (n, 3) world space; None: from a sun.

    Seen from outside, a ray through a closed surface crosses as many front as back faces, so front faces alone block it
    as well. An eye inside (a lamp in its shade, a box around the light) sees only back faces: such instances keep both.
    """
    closed = np.array([mesh.is_closed for mesh in snapshot.meshes], bool)[snapshot.instances.mesh_index]
    return closed if eyes_ws is None else closed & stand_apart(snapshot, bounds, eyes_ws)


def stand_apart(
    snapshot: SceneSnapshot, bounds: SceneBounds, places_ws: np.ndarray, instances: np.ndarray | slice = slice(None)
) -> np.ndarray:
    """(n,) bool: which instances, (n,) int64 or all, have boxes beyond one side of which all of some places, (m, 3) world space, lie: their
    hull does not meet what is in the box."""
    box = bounds.mesh_bounds_os[snapshot.instances.mesh_index[instances]]
    object_from_world = np.linalg.inv(snapshot.instances.world_from_object[instances].astype(np.float64))
    places_os = np.einsum("nij,kj->nki", object_from_world[:, :3, :3], places_ws) + object_from_world[:, None, :3, 3]
    beyond = (places_os > box[:, None, 1]).all(axis=1) | (places_os < box[:, None, 0]).all(axis=1)
    return beyond.any(axis=1)
