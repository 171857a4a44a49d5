"""A hundred broad-leaved trees of a million triangles each, as instances of three meshes, under a hazy sun.

    python -m demo_scenes.forest OUT.blend

What is instanced must not be unpacked: a hundred million triangles would take gigabytes. Metres.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from .palette import PALETTE
from .props_plants import GOLDEN_ANGLE
from .shapes import Shape, frames_facing, joined, repeated, sheet, spline, tube, unit, waves
from .stage import Stage, save_scene

SPECIES = 3
SPACING_M = 6.5
TWIG_POINTS = 7


def _leaf(length_m: float = 0.11, width_m: float = 0.06) -> Shape:
    """Along +x from its stalk at the origin, folded along its rib, drooping: sixteen triangles."""
    t, across = np.linspace(0, 1, 5)[:, None], np.linspace(-1, 1, 3)
    y = (0.5 * width_m * np.sin(np.pi * (0.06 + 0.9 * t)) ** 0.8) * across
    z = 0.4 * np.abs(y) - 0.25 * length_m * t**2
    return sheet(np.stack(np.broadcast_arrays(t * length_m, y, z), axis=-1)).flipped()


def _limb(rng: np.random.Generator, start: np.ndarray, heading: np.ndarray, length_m: float, lift: float) -> np.ndarray:
    """(TWIG_POINTS, 3) a bent path"""
    drift = 0.18 * rng.normal(size=(3, 3)).cumsum(axis=0)
    knots = start + length_m * np.concatenate([np.zeros((1, 3)), np.cumsum(unit(heading + drift + [0, 0, lift]) / 3, axis=0)])
    return spline(knots, TWIG_POINTS)


def _limbs(rng: np.random.Generator) -> tuple[list[Shape], np.ndarray]:
    """The wood, and (twig, TWIG_POINTS, 3) paths of what bears leaves."""
    height_m = rng.uniform(9.0, 11.0)
    trunk = spline(
        np.array([[0, 0, 0], [*rng.normal(0, 0.15, 2), 0.35], [*rng.normal(0, 0.3, 2), 0.7], [*rng.normal(0, 0.3, 2), 0.95]])
        * [1, 1, height_m],
        24,
    )
    wood, twigs = [tube(trunk, 0.26 * (1 - 0.9 * np.linspace(0, 1, len(trunk))) + 0.01, 14)], []
    for k, along in enumerate(np.linspace(0.28, 0.98, 44)):
        start = trunk[int(along * (len(trunk) - 1))]
        angle = k * GOLDEN_ANGLE + rng.normal(0, 0.2)
        heading = unit(np.array([np.cos(angle), np.sin(angle), 0.35 + 0.5 * along]))
        branch = _limb(rng, start, heading, height_m * 0.36 * np.sqrt(1.12 - along) * rng.uniform(0.85, 1.1), 0.15)
        wood.append(tube(branch, 0.07 * (1.25 - along) * (1 - 0.8 * np.linspace(0, 1, TWIG_POINTS)), 8))
        for j in range(14):
            outward = unit(branch[-1] - branch[0])
            spread = unit(outward + 0.9 * rng.normal(size=3))
            twig = _limb(rng, branch[1 + j % (TWIG_POINTS - 1)], spread, rng.uniform(0.5, 1.1), 0.1)
            wood.append(tube(twig, 0.012 * (1 - 0.8 * np.linspace(0, 1, TWIG_POINTS)), 5))
            twigs.append(twig)
    return wood, np.array(twigs)


def tree(seed: int, triangle_count: int) -> list[tuple[Shape, str]]:
    """About `triangle_count` triangles: the wood, and as many leaves as there is room for."""
    rng = np.random.default_rng(seed)
    wood, twigs = _limbs(rng)
    wood_shape, leaf = joined(wood), _leaf()
    left = triangle_count - 2 * len(wood_shape.quads) - len(wood_shape.triangles)
    count = max(left // (2 * len(leaf.quads)), 1)
    chosen, along = rng.integers(0, len(twigs), count), rng.uniform(0.15, 1.0, count) * (TWIG_POINTS - 1)
    before = np.minimum(along.astype(int), TWIG_POINTS - 2)
    a, b = twigs[chosen, before], twigs[chosen, before + 1]
    places = a + (b - a) * (along - before)[:, None] + rng.normal(0, 0.03, (count, 3))
    forward = unit(unit(b - a) + 1.1 * rng.normal(size=(count, 3)))
    frames = frames_facing(forward, unit(rng.normal(size=(count, 3)) * 0.5 + [0, 0, 1.0]))
    return [(wood_shape, "bark"), (repeated(leaf, places, frames, rng.uniform(0.7, 1.25, count)), "leaf")]


def add_ground(stage: Stage, half_m: float) -> None:
    x, y = np.meshgrid(np.linspace(-half_m, half_m, 240), np.linspace(-half_m, half_m, 240))
    flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
    flat[..., 2] = 0.25 * waves(flat[..., :2], 14.0, 21) + 0.03 * waves(flat[..., :2], 1.5, 22)
    stage.add("Ground", [(sheet(flat), "soil")], sharp_deg=180.0)


def build(scene: bpy.types.Scene, tree_count: int = 100, triangles_a_tree: int = 1_000_000) -> None:
    """Fill an empty scene. Trees stand on a square lattice, each moved, turned and scaled a little."""
    stage = Stage(scene, PALETTE, "Forest")
    rng = np.random.default_rng(5)
    side = int(np.ceil(np.sqrt(tree_count)))
    kinds = [stage.add(f"Tree {k + 1}", tree(k, triangles_a_tree), sharp_deg=180.0) for k in range(min(SPECIES, tree_count))]
    for i in range(tree_count):
        row, column = divmod(i, side)
        place = (np.array([column, row]) - (side - 1) / 2 + rng.uniform(-0.28, 0.28, 2)) * SPACING_M
        kind = kinds[i] if i < len(kinds) else stage.place("Tree", kinds[i % len(kinds)].data)
        kind.location, kind.rotation_euler = (*place, -0.3), (0, 0, rng.uniform(0, 2 * np.pi))
        kind.scale = (rng.uniform(0.85, 1.15),) * 3
    half_m = side * SPACING_M / 2
    add_ground(stage, half_m + 12.0)
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle = 4.0, np.radians(3.0)
    stage.place("Sun", sun, (0, 0, 30), (np.radians(38.0), 0.0, np.radians(35.0)))
    stage.camera(28.0, (0.0, -2.6 * half_m - 6.0, 0.9 * half_m + 8.0), (0.0, 0.0, 2.0), (0.5, 400.0))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
