"""What every method offers: depth maps of a batch of views of one face."""

from __future__ import annotations

import abc

import numpy as np

from ...device.interface import Device
from ..fit import FittedFace, light_hull
from ..passes.scene_data import SceneData
from ..passes.shadow_maps import DepthMaps, views_table
from ..scene import Light, SceneSnapshot


def cullable_instances(snapshot: SceneSnapshot, light: Light, samples_m: np.ndarray) -> np.ndarray:
    """(instance_count,) bool: instances whose back faces need not be drawn.

    Seen from outside, a ray through a closed surface crosses as many front as back faces, so front faces alone block it
    as well. A light inside (a lamp in its shade, a box around the light) sees only back faces: it keeps both.
    """
    hull_ws = light_hull(light, samples_m)
    closed = np.array([mesh.is_closed for mesh in snapshot.meshes], bool)[snapshot.instances.mesh_index]
    bounds = np.array([mesh.compute_bounds_os() for mesh in snapshot.meshes], np.float64)[snapshot.instances.mesh_index]
    inverse = np.linalg.inv(snapshot.instances.world_from_object.astype(np.float64))
    hull_os = np.einsum("nij,kj->nki", inverse[:, :3, :3], hull_ws) + inverse[:, None, :3, 3]
    beyond = (hull_os > bounds[:, None, 1]).all(axis=1) | (hull_os < bounds[:, None, 0]).all(axis=1)
    return closed & beyond.any(axis=1)


class DepthMapMethod(abc.ABC):
    """Fills the depth maps of one face of one light, batch by batch."""

    def __init__(self, scene_data: SceneData, fitted: FittedFace, face_table: np.ndarray, culled: np.ndarray) -> None:
        """face_table: rows for the kernels; culled: (instance_count,) bool of `cullable_instances`"""
        self.scene_data, self.fitted, self.face_table, self.culled = scene_data, fitted, face_table, culled
        self.device: Device = scene_data.device
        self.point_count = 0
        self.portion_count = 1

    @property
    def caster_triangle_count(self) -> int:
        mesh_index = self.scene_data.snapshot.instances.mesh_index[self.fitted.caster_indices]
        return int(self.scene_data.triangle_counts[mesh_index].sum())

    def prepare(self) -> None:
        """Work that all batches share, e.g. generating points."""

    @abc.abstractmethod
    def fill(self, maps: DepthMaps, selected: range) -> None:
        """Clear the maps and write the depths of the selected views into them, in order."""

    def release(self) -> None:
        """Free what `prepare` made."""

    def views_table(self, selected: range) -> np.ndarray:
        return views_table(self.fitted.views, selected)
