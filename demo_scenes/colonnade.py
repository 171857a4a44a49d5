"""A hall of fluted columns under beams, open to one side: large triangles, many of them long and thin; one area light.

    python -m demo_scenes.colonnade OUT.blend

Fewer than 300,000 triangles, instances counted: what a hardware rasterizer likes and points do not. With `has_mirrors` gazing globes,
a basin of still water and a tall mirror stand in the aisle under an open sky. Metres.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from .palette import PALETTE
from .shapes import Shape, box, ellipsoid, joined, lathe, mm, rotation_about, sheet, spline
from .stage import Stage, save_scene

SHAFT_HEIGHT_M, SHAFT_RADIUS_M = 4.6, 0.36
BASE_HEIGHT_M, CAPITAL_HEIGHT_M = 0.34, 0.5
TOP_Z = BASE_HEIGHT_M + SHAFT_HEIGHT_M + CAPITAL_HEIGHT_M
PITCH_M = 2.4
FLUTES, POINTS_A_FLUTE = 20, 6


def _shaft(ring_count: int = 9) -> Shape:
    """Fluted, thinner towards the top with a slight swelling; standing at z = 0."""
    t = np.linspace(0, 1, ring_count)[:, None]
    angle = np.arange(FLUTES * POINTS_A_FLUTE) * (2 * np.pi / (FLUTES * POINTS_A_FLUTE))
    flute = np.abs(np.sin(angle * FLUTES / 2)) ** 0.8
    radius = SHAFT_RADIUS_M * (1 - 0.16 * t**1.6 + 0.012 * np.sin(np.pi * t)) * (1 - 0.075 * flute)
    points = [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(t * SHAFT_HEIGHT_M, radius.shape)]
    return sheet(np.stack(points, axis=-1), wrap_columns=True)


def _column() -> Shape:
    molding = spline(mm("0 80, 470 80, 500 120, 470 165, 430 190, 425 220, 455 250, 430 290, 385 320, 372 340, 0 340"), 34)
    molding[[0, -1], 0] = 0.0
    base = joined([box((1.06, 1.06, 0.08), (0, 0, 0.04)), lathe(molding, 40)])
    echinus = spline(mm("0 0, 305 0, 315 40, 310 70, 340 120, 410 210, 470 300, 480 340, 0 340"), 28)
    echinus[[0, -1], 0] = 0.0
    capital = joined([lathe(echinus, 40), box((1.04, 1.04, 0.16), (0, 0, 0.42))])
    return joined([base, _shaft().moved(z_m=BASE_HEIGHT_M), capital.moved(z_m=BASE_HEIGHT_M + SHAFT_HEIGHT_M)])


def _places(count: int) -> np.ndarray:
    """(count,) m, centred"""
    return (np.arange(count) - (count - 1) / 2) * PITCH_M


def add_columns(stage: Stage, rows: int, columns: int) -> None:
    shared = None
    for x in _places(rows):
        for y in _places(columns):
            if shared is None:
                shared = stage.add("Column", [(_column(), "marble")], (x, y, 0), sharp_deg=50.0).data
            else:
                stage.place("Column", shared, (x, y, 0), (0, 0, 0.5 * (x + y)))


def add_building(stage: Stage, rows: int, columns: int) -> None:
    """Floor slabs, steps on all sides, beams along and across, rafters, a wall behind."""
    width, length = rows * PITCH_M, columns * PITCH_M
    slabs = [
        box((1.17, 1.17, 0.12), (x, y, -0.06))
        for x in np.arange(-width / 2, width / 2, 1.2) + 0.6
        for y in np.arange(-length / 2, length / 2, 1.2) + 0.6
    ]
    stage.add("Slabs", [(joined(slabs), "limestone")])
    steps = [box((width + 0.8 * k, length + 0.8 * k, 0.2), (0, 0, -0.2 * k - 0.03)) for k in range(1, 4)]
    stage.add("Steps", [(joined(steps), "limestone")])
    along = [box((0.7, length, 0.55), (x, 0, TOP_Z + 0.275)) for x in _places(rows)]
    across = [box((width, 0.45, 0.4), (0, y, TOP_Z + 0.75)) for y in _places(columns)]
    rafters = [box((width + 1.0, 0.16, 0.2), (0, y, TOP_Z + 1.05)) for y in np.arange(-length / 2, length / 2, 0.5)]
    for name, parts in (("Architraves", along), ("Beams", across), ("Rafters", rafters)):
        stage.add(name, [(joined(parts), "limestone")])
    stage.add("Wall", [(box((0.4, length, TOP_Z + 0.5)), "limestone")], (-width / 2 - 0.6, 0, (TOP_Z + 0.5) / 2))
    stage.add("Ground", [(box((80.0, 80.0, 0.1)), "soil")], (0, 0, -0.75))


def add_mirrors(stage: Stage, front_y_m: float) -> None:
    """In the aisle behind the first row of columns. front_y_m: where that is"""
    globe = ellipsoid((0.55, 0.55, 0.55), 64, 128).moved(z_m=1.15)
    pedestal = lathe(np.maximum(mm("0 0, 300 0, 300 80, 180 160, 150 520, 240 600, 240 640, 0 640"), 0.0), 48)
    for name, material, x, y in (("Globe", "mirror", -0.55, 2.6), ("Silver Globe", "brushed silver", 0.75, 3.9)):
        stage.add(f"{name} Pedestal", [(pedestal, "limestone")], (x, front_y_m + y, 0), sharp_deg=30.0)
        stage.add(name, [(globe, material)], (x, front_y_m + y, 0), sharp_deg=60.0)
    rims = [box((2.0, 0.16, 0.2), (0, end * 0.72, 0.1)) for end in (-1, 1)] + [
        box((0.16, 1.28, 0.2), (end * 0.92, 0, 0.1)) for end in (-1, 1)
    ]
    stage.add("Basin", [(joined(rims), "marble")], (0.2, front_y_m + 1.0, 0), sharp_deg=20.0)
    water = Shape(np.array([[-0.84, -0.64, 0.14], [0.84, -0.64, 0.14], [0.84, 0.64, 0.14], [-0.84, 0.64, 0.14]]), np.array([[0, 1, 2, 3]]))
    stage.add("Water", [(water, "mirror")], (0.2, front_y_m + 1.0, 0))
    glass = Shape(np.array([[-0.6, 0.0, 0.1], [0.6, 0.0, 0.1], [0.6, 0.35, 2.6], [-0.6, 0.35, 2.6]]), np.array([[0, 1, 2, 3]]))
    stage.add("Tall Mirror", [(glass.turned(rotation_about("z", 0.2)), "mirror")], (0.0, front_y_m + 6.4, 0))


def build(scene: bpy.types.Scene, rows: int = 4, columns: int = 11, *, has_mirrors: bool = False) -> None:
    """Fill an empty scene."""
    stage = Stage(scene, PALETTE, "Colonnade")
    add_columns(stage, rows, columns)
    add_building(stage, rows, columns)
    stage.area_light("Key", "SQUARE", (3.0, 3.0), 20000.0, (1.0, 0.93, 0.82), (16.0, -12.0, 11.0), (0.0, 0.0, 1.0))
    if has_mirrors:
        front_y = -(columns - 1) / 2 * PITCH_M
        add_mirrors(stage, front_y)
        stage.world("Sky", (0.35, 0.5, 0.8), 0.8)
        stage.camera(34.0, (0.2, front_y - 3.4, 2.5), (0.1, front_y + 2.6, 1.0), (0.1, 100.0))
    else:
        stage.camera(24.0, (0.2, -columns * PITCH_M / 2 - 2.0, 1.8), (0.2, 0.0, 2.4), (0.1, 100.0))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
