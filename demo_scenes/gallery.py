"""A picture gallery: two large mirrors that face each other, a mirror ball, a mirror knot and a silver vase among paintings.

    python -m demo_scenes.gallery OUT.blend

For reflections: half of what the mirrors show is outside of the picture, mirrors show in mirrors, the knot shows itself. Metres.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import bpy
import numpy as np

from .palette import PALETTE
from .shapes import Shape, box, ellipsoid, holed_slab, joined, lathe, mm, rotation_about, spline, tube
from .stage import Stage, save_scene

HALF_X_M, HALF_Y_M, HEIGHT_M = 4.0, 3.0, 3.4
PAINTS = {
    "paint red": ((0.62, 0.05, 0.035), 0.7, 0.0),
    "paint blue": ((0.04, 0.10, 0.42), 0.7, 0.0),
    "paint yellow": ((0.78, 0.55, 0.06), 0.7, 0.0),
    "paint green": ((0.06, 0.28, 0.12), 0.7, 0.0),
    "paint white": ((0.8, 0.79, 0.74), 0.8, 0.0),
    "paint black": ((0.02, 0.02, 0.022), 0.7, 0.0),
}
WALLS = {
    "wall warm": ((0.46, 0.17, 0.13), 0.9, 0.0),
    "parquet": ((0.33, 0.2, 0.1), 0.6, 0.0),
    "parquet dark": ((0.15, 0.08, 0.04), 0.6, 0.0),
    "gilt": ((0.6, 0.42, 0.16), 0.6, 0.0),
    "leather": ((0.1, 0.05, 0.03), 0.6, 0.0),
}
UPRIGHT = rotation_about("x", np.pi / 2)
"""from the xy plane, z towards the viewer, to a wall that faces -y"""


def add_room(stage: Stage) -> None:
    """Checkered floor, warm walls, a light ceiling."""
    side = 0.5
    squares: tuple[list[Shape], list[Shape]] = ([], [])
    for i in range(round(2 * HALF_X_M / side)):
        for j in range(round(2 * HALF_Y_M / side)):
            place = (side * (i + 0.5) - HALF_X_M, side * (j + 0.5) - HALF_Y_M, -0.01)
            squares[(i + j) % 2].append(box((side, side, 0.02), place))
    stage.add("Parquet", [(joined(squares[0]), "parquet"), (joined(squares[1]), "parquet dark")], sharp_deg=20.0)
    sides = [box((0.2, 2 * HALF_Y_M + 0.4, HEIGHT_M), (end * (HALF_X_M + 0.1), 0, HEIGHT_M / 2)) for end in (-1, 1)]
    sides += [box((2 * HALF_X_M, 0.2, HEIGHT_M), (0, end * (HALF_Y_M + 0.1), HEIGHT_M / 2)) for end in (-1, 1)]
    stage.add("Walls", [(joined(sides), "wall warm")], sharp_deg=20.0)
    stage.add("Ceiling", [(box((2 * HALF_X_M + 0.4, 2 * HALF_Y_M + 0.4, 0.2), (0, 0, HEIGHT_M + 0.1)), "paint white")], sharp_deg=20.0)
    boards = [box((0.03, 2 * HALF_Y_M, 0.18), (end * (HALF_X_M - 0.015), 0, 0.09)) for end in (-1, 1)]
    boards += [box((2 * HALF_X_M, 0.03, 0.18), (0, end * (HALF_Y_M - 0.015), 0.09)) for end in (-1, 1)]
    stage.add("Skirting", [(joined(boards), "paint white")], sharp_deg=20.0)


def frame(width_m: float, height_m: float, rim_m: float) -> Shape:
    """Around a picture in the xy plane; its back at z = 0."""
    outer = np.array([[-width_m / 2 - rim_m, -height_m / 2 - rim_m], [width_m / 2 + rim_m, height_m / 2 + rim_m]])
    inner = np.array([[-width_m / 2, -height_m / 2], [width_m / 2, height_m / 2]])
    return holed_slab(outer, inner, 0.05).moved(z_m=0.05)


def canvas(width_m: float, height_m: float, seed: int) -> list[tuple[Shape, str]]:
    """Rectangles of paint between black bars, in the xy plane."""
    rng = np.random.default_rng(seed)
    columns = np.concatenate([[0.0], np.sort(rng.uniform(0.12, 0.88, 3)), [1.0]])
    rows = np.concatenate([[0.0], np.sort(rng.uniform(0.12, 0.88, 3)), [1.0]])
    parts: list[tuple[Shape, str]] = [(box((width_m, height_m, 0.01), (0, 0, 0.005)), "paint black")]
    names = list(PAINTS)
    for x0, x1 in pairwise(columns):
        for y0, y1 in pairwise(rows):
            size = ((x1 - x0) * width_m - 0.02, (y1 - y0) * height_m - 0.02)
            if min(size) > 0.02:
                middle = ((x0 + x1 - 1) / 2 * width_m, (y0 + y1 - 1) / 2 * height_m, 0.01)
                name = names[int(rng.choice(6, p=(0.2, 0.17, 0.17, 0.08, 0.33, 0.05)))]
                parts.append((box((*size, 0.008), middle), name))
    return parts


def add_paintings(stage: Stage) -> None:
    """On all four walls."""
    hung = [((x, HALF_Y_M, 1.75), 0.0) for x in (-3.2, 3.2)] + [((x, -HALF_Y_M, 1.75), np.pi) for x in (-3.0, 3.0)]
    hung += [((HALF_X_M, y, 1.75), -np.pi / 2) for y in (-1.8, 0.0, 1.8)] + [((-HALF_X_M, y, 1.75), np.pi / 2) for y in (-1.8, 0.0, 1.8)]
    for k, (place, turn) in enumerate(hung):
        width, height = (1.0, 1.3) if k % 2 else (1.2, 0.9)
        parts = [(shape.turned(UPRIGHT), name) for shape, name in canvas(width, height, 11 + k)]
        stage.add(f"Painting {k + 1}", [*parts, (frame(width, height, 0.07).turned(UPRIGHT), "gilt")], place, (0, 0, turn), sharp_deg=20.0)


def add_wall_mirrors(stage: Stage) -> None:
    """One behind what is exhibited, one behind the eye."""
    for name, y, turn in (("Mirror", HALF_Y_M, 0.0), ("Mirror Behind", -HALF_Y_M, np.pi)):
        glass = Shape(np.array([[-1.5, -1.1, 0.02], [1.5, -1.1, 0.02], [1.5, 1.1, 0.02], [-1.5, 1.1, 0.02]]), np.array([[0, 1, 2, 3]]))
        stage.add(name, [(glass.turned(UPRIGHT), "mirror")], (0, y, 1.65), (0, 0, turn))
        stage.add(f"{name} Frame", [(frame(3.0, 2.2, 0.12).turned(UPRIGHT), "gilt")], (0, y, 1.65), (0, 0, turn), sharp_deg=20.0)


def add_exhibits(stage: Stage) -> None:
    """On plinths: a ball, a knot, a vase."""
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    around = 0.3 + 0.12 * np.cos(3 * angle)
    knot = np.column_stack([around * np.cos(2 * angle), around * np.sin(2 * angle), 0.16 * np.sin(3 * angle)])
    vase = spline(mm("0 0, 110 0, 120 20, 190 160, 215 280, 170 430, 90 520, 95 560, 130 600, 122 604, 84 560, 0 540"), 80)
    vase[[0, -1], 0] = 0.0
    exhibits = [
        ("Ball", ellipsoid((0.45, 0.45, 0.45), 64, 128).moved(z_m=0.45), "mirror", (-1.2, 0.3)),
        ("Knot", tube(knot, 0.075, 24, closed=True).turned(rotation_about("x", 1.2)).moved(z_m=0.48), "mirror", (0.05, 0.0)),
        ("Vase", lathe(np.maximum(vase, 0.0), 96), "brushed silver", (1.15, 0.35)),
    ]
    for name, shape, material, (x, y) in exhibits:
        stage.add(f"{name} Plinth", [(box((0.62, 0.62, 0.8), (0, 0, 0.4)), "paint white")], (x, y, 0), sharp_deg=20.0)
        stage.add(name, [(shape, material)], (x, y, 0.8), sharp_deg=60.0)


def add_visitors(stage: Stage) -> None:
    """Two of wood, who stand where only mirrors show them, and a bench."""
    coat = spline(mm("0 0, 210 0, 190 300, 170 700, 215 1050, 190 1350, 80 1430, 60 1480, 0 1480"), 60)
    coat[[0, -1], 0] = 0.0
    for k, (x, y, color) in enumerate(((-1.3, -1.7, "paint blue"), (1.9, -1.2, "paint yellow"))):
        head = ellipsoid((0.1, 0.11, 0.13), 20, 32).moved(z_m=1.6)
        stage.add(f"Visitor {k + 1}", [(lathe(np.maximum(coat, 0.0), 48), color), (head, "parquet")], (x, y, 0), sharp_deg=60.0)
    parts = [box((1.6, 0.42, 0.09), (0, 0, 0.42))] + [box((0.06, 0.36, 0.38), (x, 0, 0.19)) for x in (-0.65, 0.65)]
    stage.add("Bench", [(joined(parts), "leather")], (0.9, -0.75, 0), (0, 0, 0.25), sharp_deg=20.0)


def build(scene: bpy.types.Scene) -> None:
    """Fill an empty scene."""
    stage = Stage(scene, PALETTE | PAINTS | WALLS, "Gallery")
    add_room(stage)
    add_paintings(stage)
    add_wall_mirrors(stage)
    add_exhibits(stage)
    add_visitors(stage)
    stage.area_light("Skylight", "RECTANGLE", (3.0, 1.5), 260.0, (1.0, 0.96, 0.9), (-0.6, -0.4, HEIGHT_M - 0.05), (-0.6, -0.4, 0.0))
    stage.point_light("Lamp", 0.25, 60.0, (1.0, 0.82, 0.6), (2.9, -1.9, 2.6))
    stage.world("Dim", (0.5, 0.55, 0.65), 0.2)
    stage.camera(30.0, (-0.35, -2.6, 1.6), (0.0, 0.6, 1.35))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
