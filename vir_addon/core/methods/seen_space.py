"""What all views of a face see together, for kernels that decide once for all of them (gpu_shaders/lib/seen_space.glsl)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..fit import box_corners, light_hull
from ..scene import Light
from ..views import FaceViews


def window_bounds(views: FaceViews) -> np.ndarray:
    """(4,) float64 tangents (of suns, metres) left, right, bottom, top around the windows of all views."""
    windows = windows_of_views(views)
    return np.array([windows[:, 0].min(), windows[:, 1].max(), windows[:, 2].min(), windows[:, 3].max()])


def windows_of_views(views: FaceViews) -> np.ndarray:
    """(view_count, 4) float64 tangents (of suns, metres) left, right, bottom, top"""
    return np.array([views.window_tangents(k) for k in range(views.view_count)])


def seen_space_planes(views: FaceViews) -> np.ndarray:
    """(6, 4) float64 planes around everything that any view sees, dot(xyz, p_fs) >= w inside.

    What a view sees ends, at depth z, at a place linear in z. The outermost of these lines bulges inwards between its ends, so the
    plane through the outermost places at the nearest and the farthest depth bounds all views, and exactly at both ends.
    """
    windows = windows_of_views(views)
    centers = views.centers_fs
    # a window's side is at centre + slope * (z - centre's z), for suns at centre + shear * z + side
    shears = views.samples_m if views.is_orthographic else None
    near, far = centers[:, 2].min() + views.near_m, centers[:, 2].max() + views.far_m
    planes = np.zeros((6, 4))
    for side in range(4):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        ends = []
        for z in (near, far):
            aside = windows[:, side] * (z - centers[:, 2]) if shears is None else shears[:, axis] * z + windows[:, side]
            ends.append((sign * (centers[:, axis] + aside)).min())
        slope = (ends[1] - ends[0]) / (far - near)
        planes[side, axis] = sign
        planes[side, 2:] = -slope, ends[0] - slope * near
    planes[4, 2:], planes[5, 2:] = (1, near), (-1, -far)
    return planes


def seen_space_bindings(views: FaceViews, light: Light, samples_m: np.ndarray) -> dict[str, Any]:
    """What kernels with `SEEN_SPACE_TABLES` and `SEEN_SPACE_CONSTANTS` are bound to."""
    if views.is_orthographic:
        hull_fs = box_corners(samples_m)
    else:
        hull_fs = (light_hull(light, samples_m) - views.origin_ws) @ views.face.face_from_world.T
    return {"hull": np.pad(hull_fs, ((0, 0), (0, 1))), "hull_count": len(hull_fs), "seen_space": seen_space_planes(views)}
