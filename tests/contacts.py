"""Scenes in which surfaces touch, curve or stand at a slant to the light, with the visibility that float64 ray tracing finds.

A leak is light where none arrives, acne is shadow where nothing is in the way. Each is measured where the truth is wholly the other,
so that shadow edges, which maps of any resolution move by parts of a texel, stay out of both as far as possible.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.ray_tracing import Surfaces, delivered, nearest_blocker, samples_in_world, surfaces_at, world_triangles
from tests.scenes import area_light, box, bumpy_sphere, floor, perspective_camera, prepared_renderer, rectangle, render_batches, snapshot
from vir_addon.core.render import Renderer
from vir_addon.core.scene import Mesh, SceneSnapshot
from vir_addon.core.settings import Method
from vir_addon.device.interface import Device

WIDTH, HEIGHT = 80, 45
VIEWS = 16
Visibility = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(r, 3) points and (r, 3) light samples -> (r,) bool, whether nothing is in between"""


@dataclass(frozen=True)
class ContactScene:
    scene: SceneSnapshot
    is_visible: Visibility | None = None
    """a closed form where there are too many triangles to trace"""


@dataclass(frozen=True)
class ContactError:
    """Root mean squares of the pass's error."""

    leak: float
    """where nothing of the light is seen"""
    acne: float
    """where all of it is"""
    total: float
    """over all surfaces"""


# shapes


def grid(name: str, half_m: float, count: int, height_at: Callable[[np.ndarray, np.ndarray], np.ndarray], *, smooth: bool = False) -> Mesh:
    """A height field of 2 * count^2 triangles over a square; normals per point, by finite differences, if smooth."""
    x, y = np.meshgrid(*(np.linspace(-half_m, half_m, count + 1),) * 2, indexing="xy")
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    a, b, c, d = first, first + 1, first + count + 2, first + count + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    positions = np.stack([x, y, height_at(x, y)], axis=-1).reshape(-1, 3)
    normals = None
    if smooth:
        h = 1e-4
        slope_x = (height_at(x + h, y) - height_at(x - h, y)) / (2 * h)
        slope_y = (height_at(x, y + h) - height_at(x, y - h)) / (2 * h)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1).reshape(-1, 3).astype(np.float32)
    return Mesh(name, positions.astype(np.float32), triangles.astype(np.int32), normals)


def _made(meshes: list[Mesh], light: Any, eye: tuple[float, float, float], target: tuple[float, float, float], half_width: float = 0.4):
    return snapshot(meshes, [light], perspective_camera(eye, target, WIDTH, HEIGHT, half_width), WIDTH, HEIGHT)


# light where none is


def light_in_a_cube_on_a_floor() -> ContactScene:
    meshes = [floor(4.0), box("cube", (0.1, 0.2, 0.5), (0.5, 0.5, 0.5), turn_rad=0.3)]
    light = area_light(eye=(0.1, 0.2, 0.7), target=(0.1, 0.2, 0.0), size_m=(0.3, 0.3))
    return ContactScene(_made(meshes, light, (0.5, -3.2, 1.8), (0.1, 0.0, 0.3)))


def thin_wall() -> ContactScene:
    """One millimetre thick, light on one side, seen from the other."""
    meshes = [floor(4.0), box("wall", (0.0, 0.0, 1.5), (4.0, 0.0005, 1.5))]
    light = area_light(eye=(0.3, -1.5, 2.0), target=(0.3, 0.0, 0.5), size_m=(0.5, 0.5))
    return ContactScene(_made(meshes, light, (0.2, 2.2, 1.1), (0.0, 0.1, 0.1)))


def stairs() -> ContactScene:
    """Treads that overhang their risers, light from above and behind the nosings."""
    meshes = [floor(4.0)]
    for k in range(4):
        meshes.append(rectangle(f"riser {k}", (-1.0, 0.3 * k, 0.18 * k), (2.0, 0, 0), (0, 0, 0.18)))
        meshes.append(box(f"tread {k}", (0.0, 0.3 * k + 0.13, 0.18 * k + 0.165), (1.0, 0.17, 0.015)))
    light = area_light(eye=(0.4, 1.2, 3.0), target=(0.2, 0.4, 0.3), size_m=(1.2, 1.2))
    return ContactScene(_made(meshes, light, (0.4, -2.5, 1.4), (0.0, 0.4, 0.35), 0.33))


def cube_on_a_floor() -> ContactScene:
    meshes = [floor(4.0), box("cube", (0.0, 0.0, 0.4), (0.4, 0.4, 0.4), turn_rad=0.5)]
    light = area_light(eye=(-1.5, 2.0, 2.5), target=(0.0, 0.0, 0.2), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (0.5, -2.6, 1.2), (0.1, -0.1, 0.2)))


def sphere_on_a_floor() -> ContactScene:
    meshes = [floor(4.0), bumpy_sphere("sphere", (0.0, 0.0, 0.4), 0.4, 14, bump_share=0.0)]
    light = area_light(eye=(-1.2, 1.5, 3.0), target=(0.0, 0.0, 0.2), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (0.4, -2.4, 0.9), (0.05, -0.05, 0.2), 0.3))


def leaning_board() -> ContactScene:
    """Its lower edge lies on the floor, the light is on the other side."""
    meshes = [floor(4.0), rectangle("board", (-0.8, 0.0, 0.0), (1.6, 0.1, 0.0), (0.0, -0.5, 1.0))]
    light = area_light(eye=(0.2, 2.0, 3.0), target=(0.0, 0.0, 0.3), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (0.4, -3.0, 1.0), (0.0, 0.0, 0.2), 0.35))


def sheets_on_a_floor() -> ContactScene:
    """They hover a fifth of a millimetre over it; a board has light look for walls' feet."""
    random = np.random.default_rng(2)
    meshes = [floor(2.0), rectangle("board", (-1.8, 1.5, 0), (3.6, 0.1, 0), (0, 0.1, 1.5))]
    for number in range(4):
        turn_rad = random.uniform(0, 3)
        side_u, side_v = (
            0.21 * np.array([np.cos(turn_rad), np.sin(turn_rad), 0]),
            0.3 * np.array([-np.sin(turn_rad), np.cos(turn_rad), 0]),
        )
        meshes.append(rectangle(f"sheet {number}", (random.uniform(-0.5, 0.3), random.uniform(-0.4, 0.3), 2e-4), side_u, side_v))
    light = area_light(eye=(-1.4, -0.6, 1.6), target=(0.0, 0.0, 0.0), size_m=(0.3, 0.3))
    return ContactScene(_made(meshes, light, (0.1, -1.6, 1.3), (0.0, 0.0, 0.0)))


def wall_on_a_grazed_floor() -> ContactScene:
    """The light hardly rises above the floor, so places of the wall lie above and below what a receiver sees edge-on."""
    meshes = [floor(4.0), box("wall", (-1.0, 0.0, 0.3), (0.05, 0.8, 0.3), turn_rad=0.2)]
    light = area_light(eye=(-6.0, 0.3, 0.0), target=(0.0, 0.0, 0.0), size_m=(0.3, 0.03))
    return ContactScene(_made(meshes, light, (0.6, -2.6, 1.6), (-0.3, 0.0, 0.1), 0.4))


def bumpy_sphere_at_its_terminator() -> ContactScene:
    """Lit from the side: where light grazes its bumps they shadow each other, footprints apart and hardly above each other's planes."""
    meshes = [bumpy_sphere("sphere", (0.0, 0.0, 1.0), 0.8, 14, bump_share=0.15, smooth=False)]
    light = area_light(eye=(-3.0, -0.6, 1.6), target=(0.0, 0.0, 1.0), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (0.3, -3.2, 1.8), (0.0, 0.0, 1.0), 0.35))


# shadow where nothing is in the way


def lit_room() -> ContactScene:
    """All six joints of floor, walls and a step are lit."""
    meshes = [
        floor(2.0),
        rectangle("left wall", (-2, -2, 0), (0, 4, 0), (0, 0, 2)),
        rectangle("back wall", (-2, 2, 0), (4, 0, 0), (0, 0, 2)),
        box("step", (-1.0, 1.7, 0.1), (1.0, 0.3, 0.1)),
    ]
    light = area_light(eye=(0.6, -0.4, 1.9), target=(0.2, 0.2, 0.0), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (1.3, -1.9, 1.6), (-1.2, 1.4, 0.3), 0.5))


def grazed_quads() -> ContactScene:
    """A plane of many quads that the light grazes at 3 degrees, with a hill far off so that the plane casts."""

    def height_at(x, y):
        return np.where((np.abs(x - 1.5) < 0.1) & (np.abs(y - 1.5) < 0.1), 0.02, 0.0)

    light = area_light(eye=(-6.0, -1.0, 0.4), target=(0.0, 0.0, 0.0), size_m=(0.3, 0.1))
    return ContactScene(_made([grid("quads", 2.0, 20, height_at)], light, (0.3, -2.5, 1.8), (0.0, 0.0, 0.0), 0.4))


def _waves(x, y):
    return 0.08 * np.sin(2.6 * x + 0.4) * np.cos(2.1 * y)


def coarse_waves(smooth: bool) -> ContactScene:
    """Facets of many texels, convex and concave, all of them turned to the light."""
    light = area_light(eye=(-0.6, -0.6, 3.0), target=(0.0, 0.0, 0.0), size_m=(0.6, 0.6))
    return ContactScene(_made([grid("waves", 2.0, 12, _waves, smooth=smooth)], light, (0.3, -2.8, 1.8), (0.0, 0.0, 0.0), 0.45))


def grazed_waves() -> ContactScene:
    light = area_light(eye=(-5.0, -1.0, 1.3), target=(0.0, 0.0, 0.0), size_m=(0.5, 0.3))
    return ContactScene(_made([grid("waves", 2.0, 16, _waves, smooth=True)], light, (0.3, -2.8, 1.8), (0.0, 0.0, 0.0), 0.45))


def coarse_sphere(smooth: bool) -> ContactScene:
    meshes = [bumpy_sphere("sphere", (0.0, 0.0, 1.0), 0.8, 8, bump_share=0.0, smooth=smooth)]
    light = area_light(eye=(-1.5, -1.5, 3.0), target=(0.0, 0.0, 1.0), size_m=(0.4, 0.4))
    return ContactScene(_made(meshes, light, (0.3, -3.2, 1.8), (0.0, 0.0, 1.0), 0.35))


def _bowl(x, y):
    return 0.3 * (x**2 + y**2)


def coarse_bowl(smooth: bool) -> ContactScene:
    """Facets of many texels, concave everywhere, lit from inside."""
    light = area_light(eye=(0.3, -0.2, 4.5), target=(0.0, 0.0, 0.0), size_m=(0.4, 0.4))
    return ContactScene(_made([grid("bowl", 1.5, 9, _bowl, smooth=smooth)], light, (0.3, -2.6, 2.6), (0.0, 0.2, 0.2), 0.5))


def rough_ground() -> ContactScene:
    """A scan's facets, of about two texels of a map of 40: every edge is a fold, of 15 degrees on average."""

    def height_at(x, y):
        return _waves(x, y) + 0.008 * np.random.default_rng(5).normal(size=x.shape)

    light = area_light(eye=(-2.0, -0.8, 2.0), target=(0.0, 0.0, 0.0), size_m=(0.6, 0.6))
    return ContactScene(_made([grid("ground", 0.6, 24, height_at)], light, (0.2, -1.5, 1.1), (0.0, 0.0, 0.0), 0.35))


def _sphere_hides(points: np.ndarray, targets: np.ndarray, centre: np.ndarray, radius_m: float) -> np.ndarray:
    """Whether a segment enters a sphere by more than a share of 1e-3 of its radius."""
    d = targets - points
    nearest = np.clip(np.einsum("ij,ij->i", centre - points, d) / np.einsum("ij,ij->i", d, d), 0, 1)
    return np.linalg.norm(points + nearest[:, None] * d - centre, axis=1) < (1 - 1e-3) * radius_m


def fine_sphere(row_count: int = 250, *, smooth: bool = True) -> ContactScene:
    """Triangles smaller than texels on a floor."""
    centre, radius_m = np.array([0.0, 0.0, 0.8]), 0.8
    meshes = [bumpy_sphere("sphere", centre, radius_m, row_count, bump_share=0.0, smooth=smooth), floor(4.0)]
    light = area_light(eye=(-1.5, -1.5, 3.0), target=(0.0, 0.0, 0.8), size_m=(0.4, 0.4))
    scene = _made(meshes, light, (0.3, -3.2, 1.6), (0.0, 0.0, 0.6), 0.4)
    return ContactScene(scene, lambda points, targets: ~_sphere_hides(points, targets, centre, radius_m))


def fine_bowl(*, smooth: bool = True) -> ContactScene:
    """Triangles smaller than texels. What lies above a convex function is a convex set, so nothing is in the way."""
    light = area_light(eye=(-2.6, -0.2, 2.4), target=(0.0, 0.0, 0.3), size_m=(0.4, 0.4))
    scene = _made([grid("bowl", 1.5, 250, _bowl, smooth=smooth)], light, (0.3, -2.6, 2.6), (0.0, 0.2, 0.2), 0.5)
    return ContactScene(scene, lambda points, targets: np.ones(len(points), bool))


SCENES: dict[str, Callable[[], ContactScene]] = {
    "light in a cube on a floor": light_in_a_cube_on_a_floor,
    "thin wall": thin_wall,
    "stairs": stairs,
    "cube on a floor": cube_on_a_floor,
    "sphere on a floor": sphere_on_a_floor,
    "leaning board": leaning_board,
    "sheets on a floor": sheets_on_a_floor,
    "wall on a grazed floor": wall_on_a_grazed_floor,
    "bumpy sphere at its terminator": bumpy_sphere_at_its_terminator,
    "lit room": lit_room,
    "grazed quads": grazed_quads,
    "coarse waves, flat": lambda: coarse_waves(False),
    "coarse waves, smooth": lambda: coarse_waves(True),
    "grazed waves": grazed_waves,
    "coarse sphere, flat": lambda: coarse_sphere(False),
    "coarse sphere, smooth": lambda: coarse_sphere(True),
    "coarse bowl, flat": lambda: coarse_bowl(False),
    "coarse bowl, smooth": lambda: coarse_bowl(True),
    "rough ground": rough_ground,
    "fine sphere": fine_sphere,
    "fine sphere, flat": lambda: fine_sphere(smooth=False),
    "fine bowl": fine_bowl,
    "fine bowl, flat": lambda: fine_bowl(smooth=False),
}


# measuring


def true_pass(contact: ContactScene, surfaces: Surfaces, samples_m: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(n,) the pass at the pixels of `surfaces`: what of the light samples, each with its weight, is seen, float64."""
    scene = contact.scene
    (light,) = scene.lights
    samples_ws = samples_in_world(light, samples_m)
    weight = delivered(light, samples_ws, surfaces.position, surfaces.shading) * weights
    d = surfaces.position[:, None] - samples_ws[None]
    turned = np.einsum("nj,nmj->nm", surfaces.geometric, d) < 0
    point, sample = np.nonzero((weight > 0) & turned)
    # a hair above the surface: a ray that leaves an edge must not meet the edge's other triangle
    lifted = surfaces.position[point] + 1e-6 * surfaces.geometric[point]
    if contact.is_visible is not None:
        visible = contact.is_visible(lifted, samples_ws[sample])
    else:
        visible = ~np.isfinite(nearest_blocker(lifted, samples_ws[sample], world_triangles(scene).corners))
    seen = np.bincount(point, weights=weight[point, sample] * visible, minlength=len(weight))
    total = weight.sum(axis=1)
    return np.where(total > 0, seen / np.where(total > 0, total, 1), 0)


class Measurement:
    """A scene with its truth, which all methods and resolutions share."""

    def __init__(self, contact: ContactScene, device: Device) -> None:
        self.contact, self.device = contact, device
        self._truth: np.ndarray | None = None

    @contextlib.contextmanager
    def rendered(self, method: Method, map_resolution_px: int, **settings: Any) -> Iterator[Renderer]:
        """Nothing rendered yet: for `render_batches`."""
        settings = {"method": method, "view_count": VIEWS, "map_resolution_px": map_resolution_px, **settings}
        with prepared_renderer(self.contact.scene, self.device, **settings) as renderer:
            yield renderer

    def compare(self, image: np.ndarray, renderer: Renderer) -> ContactError:
        """image: (height, width), what the renderer made with whatever method"""
        positions, normals = (self.device.run(self.device.read, texture) for texture in renderer.eye.buffers[0])
        if self._truth is None:
            (work,) = renderer.works
            self._truth = true_pass(self.contact, self._surfaces(positions, normals), work.samples_m, work.sample_weights)
        truth, error = self._truth, image[positions[..., 3] >= 0].astype(np.float64) - self._truth

        def rms(where: np.ndarray) -> float:
            return float(np.sqrt((error[where] ** 2).mean())) if where.any() else 0.0

        return ContactError(rms(truth < 1e-9), rms(truth > 1 - 1e-9), rms(np.ones(len(truth), bool)))

    def _surfaces(self, positions: np.ndarray, normals: np.ndarray) -> Surfaces:
        if self.contact.is_visible is None:
            return surfaces_at(positions, self.contact.scene, world_triangles(self.contact.scene))
        rows, columns = np.nonzero(positions[..., 3] >= 0)
        own = normals[rows, columns, :3].astype(np.float64)
        # the weights hardly depend on which normal shades
        return Surfaces(np.stack([rows, columns], axis=1), positions[rows, columns, :3].astype(np.float64), own, own, np.zeros(len(own)))

    def error(self, method: Method, map_resolution_px: int) -> ContactError:
        with self.rendered(method, map_resolution_px) as renderer:
            render_batches(renderer)
            return self.compare(renderer.read_passes()["VIR Shadow Key"], renderer)
