"""What the camera may see, told by boxes before anything is rendered."""

from __future__ import annotations

import numpy as np

from .bounds import SceneBounds
from .scene import Camera, SceneSnapshot

LATTICE_STEPS = 6
"""to a box, or as many as MAX_LATTICE_PLACES leaves it where there are many"""
MAX_LATTICE_BOXES = 1024
MAX_LATTICE_PLACES = 1 << 15
"""what is enough to tell which faces of a cube will be needed"""


def instances_in_picture(snapshot: SceneSnapshot, bounds: SceneBounds) -> np.ndarray:
    """(instance_count,) bool: what the camera may see"""
    return snapshot.instances.visible_to_camera & _may_be_in_picture(snapshot.camera, bounds.corners_ws)


def visible_places(camera: Camera, boxes: np.ndarray) -> np.ndarray:
    """(n, 3) places in boxes, (m, 8, 3) world space, on a coarse lattice, as far as they are in the camera's view."""
    largest = np.argsort(-np.ptp(boxes, axis=1).max(axis=1), kind="stable")
    boxes = boxes[largest[:MAX_LATTICE_BOXES]]
    steps = min(max(int((MAX_LATTICE_PLACES / max(len(boxes), 1)) ** (1 / 3)), 2), LATTICE_STEPS)
    u = np.linspace(0, 1, steps)
    lattice = np.stack(np.meshgrid(u, u, u, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    # corner i of a box lies at bit k of i along axis k (core/bounds.py)
    edges = boxes[:, [1, 2, 4]] - boxes[:, :1]
    places = (boxes[:, :1] + lattice[:, 0] @ edges).reshape(-1, 1, 3)
    return places[_may_be_in_picture(camera, places), 0]


def _may_be_in_picture(camera: Camera, corners_ws: np.ndarray) -> np.ndarray:
    """(instance_count,) bool: boxes that are not wholly outside one side of the camera's view."""
    view_from_world = np.linalg.inv(camera.world_from_view)
    p = corners_ws @ view_from_world[:3, :3].T + view_from_world[:3, 3]
    # mirrored cameras have them the other way round
    (left, right), (bottom, top) = sorted(camera.window[:2]), sorted(camera.window[2:])
    depth = -p[..., 2]
    scale = np.ones_like(depth) if camera.is_orthographic else depth
    y = p[..., 1] - camera.skew * p[..., 0]
    sides = [
        depth - camera.clip_start_m,
        camera.clip_end_m - depth,
        p[..., 0] - left * scale,
        right * scale - p[..., 0],
        y - bottom * scale,
        top * scale - y,
    ]
    return np.logical_and.reduce([(side >= 0).any(axis=-1) for side in sides])
