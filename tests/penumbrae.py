"""Three scenes whose shadows are hard for one map from the light's centre, with their passes by rays in float64."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from tests.ray_tracing import delivered, nearest_blocker, samples_in_world, surfaces_at, world_triangles
from tests.scenes import area_light, box, bumpy_sphere, floor, leaves, perspective_camera, point_light, rectangle, snapshot
from vir_addon.core.sampling import light_samples, sample_weights
from vir_addon.core.scene import Mesh, SceneSnapshot

DELIVERED_FLOOR = 0.01
"""Of what the brightest pixel receives. What receives less is not compared: rounding decides what the light grazes."""


def still_life_meshes() -> list[Mesh]:
    return [
        floor(3.0),
        box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4),
        bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 8, smooth=False),
        rectangle("leaf", (-0.2, -1.2, 0.7), (0.7, 0.1, 0.3), (0.0, 0.6, 0.2)),
    ]


def room_meshes() -> list[Mesh]:
    """Walls beside and behind what stands in the middle."""
    return [
        floor(3.0),
        rectangle("left wall", (-3, -3, 0), (0, 6, 0), (0, 0, 3)),
        rectangle("right wall", (3, -3, 0), (0, 0, 3), (0, 6, 0)),
        rectangle("back wall", (-3, 3, 0), (6, 0, 0), (0, 0, 3)),
        box("pillar", (-1.8, 0.6, 1.2), (0.2, 0.2, 1.2), turn_rad=0.3),
        box("shelf", (1.9, 0.2, 1.6), (0.5, 0.8, 0.05)),
        bumpy_sphere("ball", (0.5, 0.8, 1.0), 0.5, 7, smooth=False),
    ]


def still_life(width: int, height: int) -> SceneSnapshot:
    """Few large shapes on a floor: where penumbrae are as for parallel planes, mostly."""
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), width, height)
    return snapshot(still_life_meshes(), [area_light(eye=(2.0, -2.0, 5.0), target=(0, 0, 0.5))], camera, width, height)


def foliage(width: int, height: int) -> SceneSnapshot:
    """Leaves at many depths, one before the other as seen from the light."""
    meshes = [floor(3.0), leaves("leaves", (0, 0, 1.2), 1.2, 40, 0.25), box("trunk", (0, 0, 0.4), (0.08, 0.08, 0.4))]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), width, height)
    return snapshot(meshes, [area_light(eye=(2.0, -2.0, 5.0), target=(0, 0, 0.5))], camera, width, height)


def room(width: int, height: int) -> SceneSnapshot:
    """A lamp in the middle, whose cube's faces share shadows."""
    camera = perspective_camera((0.2, -6.5, 1.6), (0.0, 0.0, 1.4), width, height, 0.45)
    return snapshot(room_meshes(), [point_light(eye=(0.0, 0.3, 1.9), radius_m=0.2)], camera, width, height)


SCENES: dict[str, Callable[[int, int], SceneSnapshot]] = {"still life": still_life, "foliage": foliage, "room": room}


@dataclasses.dataclass(frozen=True)
class TracedPass:
    image: np.ndarray
    """(height, width) float64"""
    compared: np.ndarray
    """(height, width) bool: what receives more than DELIVERED_FLOOR"""

    def errors(self, image: np.ndarray) -> dict[str, float]:
        """RMSE of all that is compared, and of what is lit, dark and between."""
        parts = {
            "all": self.compared,
            "penumbra": self.compared & (self.image > 0.02) & (self.image < 0.98),
            "lit": self.compared & (self.image > 0.999),
            "dark": self.compared & (self.image < 0.001),
        }
        return {name: float(np.sqrt(np.mean((image[part] - self.image[part]) ** 2))) for name, part in parts.items()}


def traced_pass(scene: SceneSnapshot, positions: np.ndarray, sample_count: int) -> TracedPass:
    """Of the first light, by rays from the points of an eye G-buffer to light samples that no method has."""
    light = dataclasses.replace(scene.lights[0], name="another light's samples")
    triangles = world_triangles(scene)
    surfaces = surfaces_at(positions, scene, triangles)
    samples_m = light_samples(light, sample_count)
    samples_ws = samples_in_world(light, samples_m)
    weight = delivered(light, samples_ws, surfaces.position, surfaces.shading) * sample_weights(light, samples_m)
    point, sample = np.nonzero(weight > 0)
    p, s = surfaces.position[point], samples_ws[sample]
    seen = np.einsum("rj,rj->r", surfaces.geometric[point], p - s) < 0
    seen[seen] = ~np.isfinite(nearest_blocker(p[seen], s[seen], triangles.corners))
    total = weight.sum(axis=1)
    reached = np.bincount(point, weights=weight[point, sample] * seen, minlength=len(total))
    image, compared = np.ones((scene.height_px, scene.width_px)), np.zeros((scene.height_px, scene.width_px), bool)
    image[tuple(surfaces.pixel.T)] = np.divide(reached, total, out=np.zeros_like(total), where=total > 0)
    compared[tuple(surfaces.pixel.T)] = total > DELIVERED_FLOOR * total.max()
    return TracedPass(image, compared)
