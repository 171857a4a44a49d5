"""What a 3D viewport looks at, as a camera: through the scene's camera, freely, in perspective or not, local view or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.scene import Camera
from .camera import split_rigid

NAME = "Viewport"


@dataclass(frozen=True, eq=False)
class ViewportView:
    width_px: int
    height_px: int
    is_orthographic: bool
    world_from_view: np.ndarray
    """(4, 4) float64, rigid, Blender's world"""
    window: tuple[float, float, float, float]
    """as of core.scene.Camera"""
    clip_start_m: float
    clip_end_m: float
    hidden_uids: frozenset[int] = frozenset()
    """session_uid of objects that this viewport does not show although the view layer does: outside its local view or collections"""
    skew: float = 0.0
    """as of core.scene.Camera"""

    def camera(self, world_origin_m: np.ndarray) -> Camera:
        world_from_view = self.world_from_view.copy()
        world_from_view[:3, 3] -= world_origin_m
        return Camera(NAME, self.is_orthographic, world_from_view, self.window, self.clip_start_m, self.clip_end_m, self.skew)


def viewport_view(
    view_from_world: np.ndarray, clip_from_view: np.ndarray, width_px: int, height_px: int, hidden_uids: frozenset[int] = frozenset()
) -> ViewportView | None:
    """From the two matrices of a region, (4, 4) each. None: they show nothing, as in a region that was never drawn."""
    view_from_world, projection = view_from_world.astype(np.float64), clip_from_view.astype(np.float64)
    if not (np.isfinite(view_from_world).all() and np.isfinite(projection).all()) or min(width_px, height_px) < 1:
        return None
    if abs(np.linalg.det(view_from_world)) < 1e-12 or projection[0, 0] == 0.0 or projection[1, 1] == 0.0 or projection[2, 2] == 0.0:
        return None
    is_orthographic = projection[3, 3] != 0.0
    parted = split_rigid(np.linalg.inv(view_from_world), NAME, is_orthographic=bool(is_orthographic))
    world_from_view = parted.world_from_view
    # with w of 1 (orthographic) or -z: what x and y clip space end at
    across = np.array([[-1.0, 1.0], [-1.0, 1.0]])
    shift = -projection[:2, 3] if is_orthographic else projection[:2, 2]
    (left, right), (bottom, top) = (across + shift[:, None]) / np.diagonal(projection)[:2, None]
    if is_orthographic:
        near_m, far_m = (projection[2, 3] + 1.0) / projection[2, 2], (projection[2, 3] - 1.0) / projection[2, 2]
        # Blender's eye stands in the middle of what it sees
        world_from_view[:3, 3] += world_from_view[:3, 2] * -near_m
        near_m, far_m = 0.0, far_m - near_m
    else:
        # rounded to float32 the far end may be beyond infinity
        near_m, far_m = projection[2, 3] / (projection[2, 2] - 1.0), projection[2, 3] / min(projection[2, 2] + 1.0, -1e-7)
    near_m, far_m, window = parted.depth * near_m, parted.depth * far_m, parted.window((left, right, bottom, top))
    return ViewportView(width_px, height_px, is_orthographic, world_from_view, window, near_m, far_m, hidden_uids, parted.skew)
