"""What every method offers: depth maps of a batch of views of one face."""

from __future__ import annotations

import abc

import numpy as np

from ...device.interface import Device
from ..fit import FittedFace
from ..passes.scene_data import SceneData
from ..passes.shadow_maps import DepthMaps, views_table


class DepthMapMethod(abc.ABC):
    """Fills the depth maps of one face of one light, batch by batch."""

    def __init__(self, scene_data: SceneData, fitted: FittedFace, face_table: np.ndarray, culled: np.ndarray) -> None:
        """face_table: rows for the kernels; culled: (instance_count,) bool of `bounds.cullable_instances`"""
        self.scene_data, self.fitted, self.face_table, self.culled = scene_data, fitted, face_table, culled
        self.device: Device = scene_data.device
        self.portion_count = 1
        self.projection_flags = ["ORTHOGRAPHIC"] * fitted.views.is_orthographic

    @property
    def caster_triangle_count(self) -> int:
        mesh_index = self.scene_data.snapshot.instances.mesh_index[self.fitted.caster_indices]
        return int(self.scene_data.triangle_counts[mesh_index].sum())

    def prepare(self) -> None:  # noqa: B027  most methods have nothing to prepare
        """Work that all batches share, e.g. generating points."""

    @abc.abstractmethod
    def fill(self, maps: DepthMaps, selected: range) -> None:
        """Clear the maps and write the depths of the selected views into them, in order."""

    def release(self) -> None:  # noqa: B027  nor to free
        """Free what `prepare` made."""

    def counts(self) -> dict[str, int]:
        """What was prepared for the views so far, by the fields of `PassStatistics`."""
        return {}

    def views_table(self, selected: range) -> np.ndarray:
        return views_table(self.fitted.views, selected)
