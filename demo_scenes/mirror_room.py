"""A mirror in a checkered room with small things around it: what reflections are compared with Cycles in.

    python -m demo_scenes.mirror_room OUT.blend

Metres.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from .shapes import Shape, box, ellipsoid, joined, lathe
from .stage import Stage, save_scene

HALF_M, HEIGHT_M = 4, 4
THING_COUNT = 12
THING_COLORS = ((0.75, 0.2, 0.15), (0.2, 0.6, 0.25), (0.15, 0.25, 0.7), (0.8, 0.65, 0.1))


def palette(roughness: float, has_gloss: bool) -> dict[str, tuple[tuple[float, float, float], float, float]]:
    """roughness: of the mirror; has_gloss: of things"""
    things = {
        f"thing {k}": (color, 0.6 - 0.2 * (k % 2) if has_gloss else 0.8, float(has_gloss and k % 2 == 0))
        for k, color in enumerate(THING_COLORS)
    }
    return {
        "light": ((0.8, 0.75, 0.7), 0.8, 0.0),
        "dark": ((0.15, 0.2, 0.3), 0.8, 0.0),
        "mirror": ((0.95, 0.93, 0.9), roughness, 1.0),
        **things,
    }


def _square(corner: tuple[float, float, float], side_u: tuple[float, float, float], side_v: tuple[float, float, float]) -> Shape:
    a, u, v = (np.array(part, np.float64) for part in (corner, side_u, side_v))
    return Shape(np.array([a, a + u, a + u + v, a + v]), np.array([[0, 1, 2, 3]]))


def _squares(parity: int) -> Shape:
    """Of the floor and the four walls, those of one colour."""
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    parts = []
    for i in range(2 * HALF_M):
        for j in range(2 * HALF_M):
            if (i + j) % 2 == parity:
                parts.append(_square((i - HALF_M, j - HALF_M, 0), x, y))
        for j in range(HEIGHT_M):
            if (i + j) % 2 == parity:
                parts += [_square((i - HALF_M, HALF_M, j), x, z), _square((i - HALF_M, -HALF_M, j), x, z)]
            else:
                parts += [_square((HALF_M, i - HALF_M, j), y, z), _square((-HALF_M, i - HALF_M, j), y, z)]
    return joined(parts)


def build(scene: bpy.types.Scene, roughness: float = 0.0, shape: str = "sphere", *, has_gloss: bool = False) -> None:
    """Fill an empty scene. shape: of the mirror, 'sphere', 'column' or 'flat'; has_gloss: things are rough metal and plastic"""
    stage = Stage(scene, palette(roughness, has_gloss), "Mirror room")
    stage.add("Room", [(_squares(0), "light"), (_squares(1), "dark")], sharp_deg=10.0)
    for k in range(THING_COUNT):
        angle, distance_m = 2 * np.pi * (k + 0.3) / THING_COUNT, 1.5 + 0.5 * (k % 3)
        thing = (box((0.4, 0.4, 0.4)), ellipsoid((0.22, 0.22, 0.22)), lathe(np.array([(0.0, -0.2), (0.25, -0.2), (0.0, 0.3)])))[k % 3]
        place = (distance_m * np.cos(angle), distance_m * np.sin(angle), 0.22)
        stage.add(f"Thing {k}", [(thing, f"thing {k % len(THING_COLORS)}")], place, (0, 0, angle), sharp_deg=40.0)
    mirrors = {
        "sphere": (ellipsoid((0.8, 0.8, 0.8), 48, 96), (0, 0, 0.85)),
        "column": (lathe(np.array([(0.0, 0.0), (0.6, 0.0), (0.6, 1.6), (0.0, 1.6)]), 128), (0, 0, 0)),
        "flat": (_square((-1.2, 1.2, 0.2), (2.4, 0.3, 0), (0, -0.3, 2.0)), (0, 0, 0)),
    }
    mirror, place = mirrors[shape]
    stage.add("Mirror", [(mirror, "mirror")], place, sharp_deg=40.0)
    stage.area_light("Key", "SQUARE", (1.5, 1.5), 300.0, (1.0, 0.95, 0.85), (1.5, -1.5, 3.6), (0.0, 0.0, 0.5))
    stage.point_light("Fill", 0.2, 80.0, (0.6, 0.7, 1.0), (-2.5, 1.5, 3.0))
    stage.world("Sky", (0.3, 0.4, 0.6), 0.5)
    stage.camera(38.0, (0.3, -3.6, 1.9), (0.0, 0.0, 0.75))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
