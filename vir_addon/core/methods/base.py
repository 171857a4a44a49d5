"""What every method offers: depth maps of a batch of views of one face."""

from __future__ import annotations

import abc
from dataclasses import dataclass

import numpy as np

from ...device.interface import Device
from ...device.owned import Owned
from ..fit import FittedFace
from ..passes.scene_data import SceneData
from ..passes.shadow_maps import MAX_BATCH_VIEWS, DepthMaps, views_table
from ..scene import Light
from ..settings import Settings
from .shared import SharedByFaces


@dataclass(frozen=True)
class FaceJob:
    """What there is to do for one face of a light, whatever the method."""

    scene_data: SceneData
    fitted: FittedFace
    face_table: np.ndarray
    """rows for the kernels"""
    culled: np.ndarray
    """(instance_count,) bool of `bounds.cullable_instances`"""
    light: Light
    samples_m: np.ndarray
    """(view_count, 3) of `sampling.light_samples`"""
    settings: Settings
    shared: SharedByFaces


class DepthMapMethod(abc.ABC):
    """Fills the depth maps of one face of one light, batch by batch."""

    def __init__(self, job: FaceJob) -> None:
        self.settings, self.shared = job.settings, job.shared
        self.scene_data, self.fitted, self.face_table, self.culled = job.scene_data, job.fitted, job.face_table, job.culled
        self.device: Device = job.scene_data.device
        self.portion_count = 1
        self.projection_flags = ["ORTHOGRAPHIC"] * job.fitted.views.is_orthographic

    @property
    def caster_triangle_count(self) -> int:
        mesh_index = self.scene_data.snapshot.instances.mesh_index[self.fitted.caster_indices]
        return int(self.scene_data.triangle_counts[mesh_index].sum())

    def prepare(self) -> None:
        """Work that all batches share, e.g. generating points."""
        self.device.run(self._prepare)

    def _prepare(self) -> None:  # noqa: B027  most methods have nothing to prepare
        """`prepare` on the device's thread."""

    def fill(self, maps: DepthMaps, selected: range) -> None:
        """Clear the maps and write the depths of the selected views into them, in order."""
        self.device.run(self._fill, maps, selected)

    @abc.abstractmethod
    def _fill(self, maps: DepthMaps, selected: range) -> None:
        """`fill` on the device's thread."""

    def release(self) -> None:  # noqa: B027  nor to free
        """Free what `prepare` made."""

    def counts(self) -> dict[str, int]:
        """What was prepared for the views so far, by the fields of `PassStatistics`."""
        return {}

    def views_table(self, selected: range) -> np.ndarray:
        return views_table(self.fitted.views, selected)


class ReplayMethod(DepthMapMethod):
    """Keeps on the device what every batch replays; lets go of it when other faces need the memory, and makes it again in its turn."""

    def __init__(self, job: FaceJob) -> None:
        super().__init__(job)
        self._is_held = self._was_dropped = self._has_searched_hidden = False
        self._owned = Owned()

    @property
    @abc.abstractmethod
    def held_bytes(self) -> int: ...

    @abc.abstractmethod
    def _make(self) -> None:
        """Make what is replayed; sets `_is_held` as soon as there is something to free."""

    @abc.abstractmethod
    def _free(self) -> None:
        """Release what is replayed."""

    def _hold(self) -> None:
        """Before every use of what is replayed."""
        if not self._is_held:
            self._make()
        self.shared.touch(self)

    def drop(self) -> None:
        self._free()
        self._is_held, self._was_dropped = False, True

    def _may_search_hidden(self, selected: range) -> bool:
        """Once, after a batch large enough to stand for all views, and only if there are others left to gain from it. What is made
        again for every batch would be searched every time."""
        return (
            self.settings.cull_hidden
            and not (self._has_searched_hidden or self._was_dropped)
            and len(selected) == MAX_BATCH_VIEWS < self.fitted.views.view_count
        )

    def release(self) -> None:
        self.shared.forget(self)
        if self._is_held:
            self.drop()
        self._owned.close()
