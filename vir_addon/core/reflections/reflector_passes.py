"""What each reflecting object adds to the reflection passes, as a pair of passes of its own."""

from __future__ import annotations

import numpy as np

from ..pass_set import reflector_pass_names
from ..scene import SceneSnapshot


class ReflectorPasses:
    """Sums over rounds, of objects that show. Their products add up to that of the passes of all."""

    def __init__(self, snapshot: SceneSnapshot, has_map: np.ndarray) -> None:
        """has_map: (instance_count,) bool, of what the eye sees of them"""
        instances = snapshot.instances
        self._shape = snapshot.height_px, snapshot.width_px
        self._object_names = instances.object_names
        self._objects = np.where(has_map, instances.object_index, -1)
        self._names = reflector_pass_names({instances.object_names[index] for index in instances.object_index[has_map]})
        self._sums: dict[str, np.ndarray] = {}

    def add(self, radiances: np.ndarray, colors: np.ndarray, instances: np.ndarray, is_walked: np.ndarray) -> None:
        """A round: (height, width, 4) each as of ADD_REFLECTIONS, (height, width) instance numbers of the eye's, -1 for the background;
        is_walked: (height, width) bool, elsewhere nothing was written."""
        shown = np.flatnonzero(is_walked & (instances >= 0))
        shown = shown[colors.reshape(-1, 4)[shown, 3] > 0]
        objects = self._objects[instances.reshape(-1)[shown].astype(np.int64)]
        for number in np.unique(objects[objects >= 0]):
            own = shown[objects == number]
            sums = self._sums.setdefault(self._object_names[number], np.zeros((self._shape[0] * self._shape[1], 6), np.float32))
            sums[own, :3] += radiances.reshape(-1, 4)[own, :3]
            sums[own, 3:] += colors.reshape(-1, 4)[own, :3]

    def read(self, round_count: int) -> dict[str, np.ndarray]:
        """Pass name -> (height, width, 3) float32"""
        images = {}
        for object_name, sums in self._sums.items():
            radiance, color = sums[:, :3].reshape(*self._shape, 3), sums[:, 3:].reshape(*self._shape, 3)
            reflection_name, color_name = self._names[object_name]
            images[reflection_name] = np.divide(radiance, color, out=np.zeros_like(radiance), where=color > 0)
            images[color_name] = color / max(round_count, 1)
        return images
