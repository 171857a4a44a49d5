"""How much of the scene a pixel of the picture takes: what no map and no density of points has to be finer than."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .scene import SceneSnapshot
from .views import FaceViews


@dataclass(frozen=True)
class EyePixels:
    """A pixel's width at a distance from the eye, a lower bound for all of the picture."""

    eye_ws: np.ndarray
    """(3,) float64"""
    angle_rad: float
    """the smallest angle that a pixel of a perspective camera takes, 0 for others"""
    width_m: float
    """of an orthographic camera's pixel, 0 for others"""

    def widths_m(self, places_ws: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n,)"""
        return self.angle_rad * np.linalg.norm(places_ws - self.eye_ws, axis=1) + self.width_m

    def table(self, views: FaceViews) -> np.ndarray:
        """(2, 4) rows of the table `eye` (core/passes/points.py)"""
        rows = np.zeros((2, 4))
        rows[0, :3] = views.face.face_from_world @ (self.eye_ws - views.origin_ws)
        rows[1, :2] = self.angle_rad, self.width_m
        return rows


def nearest_pixel_m(pixels: EyePixels, corners_ws: np.ndarray, center_ws: np.ndarray) -> float:
    """Of the eye's pixels by way of a reflector with these corners, (n, 3): `angle_rad` times the distance from a place within it, (3,),
    has to be added for what is beyond. A bounding sphere stands for the reflector (Gavane & Watson 2022 b, section 4.1.1); where all of
    its size comes off, the width may be negative."""
    middle = (corners_ws.min(axis=0) + corners_ws.max(axis=0)) / 2
    radius_m = float(np.linalg.norm(corners_ws - middle, axis=1).max())
    from_eye_m = max(float(np.linalg.norm(middle - pixels.eye_ws)) - radius_m, 0.0)
    reach_m = radius_m + float(np.linalg.norm(center_ws - middle))
    return pixels.angle_rad * (from_eye_m - reach_m) + pixels.width_m


def eye_pixels(snapshot: SceneSnapshot) -> EyePixels:
    camera = snapshot.camera
    left, right, bottom, top = camera.window
    width = min(abs(right - left) / snapshot.width_px, abs(top - bottom) / snapshot.height_px)
    # skewed pixels are narrower across their longer diagonal
    width *= math.hypot(1, camera.skew / 2) - abs(camera.skew) / 2
    if camera.is_orthographic:
        return EyePixels(camera.world_from_view[:3, 3], 0.0, width)
    # away from the axis a tangent's step is a smaller angle, by the squared cosine
    widest = max(abs(left), abs(right))
    squared_tangent = widest**2 + (max(abs(bottom), abs(top)) + abs(camera.skew) * widest) ** 2
    return EyePixels(camera.world_from_view[:3, 3], width / (1 + squared_tangent), 0.0)
