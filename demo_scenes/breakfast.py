"""A breakfast table: a mirror-bright coffee pot, a tray and cutlery, a silver sugar bowl, and a room that only they show.

    python -m demo_scenes.breakfast OUT.blend

For reflections: everything is near, so where things show in the pot depends on where rays leave it. Metres.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from . import props_fruit, props_table
from .furnished_room import add_chair
from .palette import PALETTE
from .props_table import TOP_Z
from .shapes import Shape, box, ellipsoid, joined, lathe, mm, rotation_about, spline, tube
from .stage import Stage, save_scene

OWN = {
    # waxed, not glazed: what shines here is metal
    "apple": ((0.42, 0.04, 0.02), 0.45, 0.0),
    "porcelain": ((0.8, 0.79, 0.75), 0.4, 0.0),
    "toast": ((0.42, 0.23, 0.08), 0.9, 0.0),
    "stripe light": ((0.62, 0.55, 0.42), 0.9, 0.0),
    "stripe dark": ((0.2, 0.3, 0.32), 0.9, 0.0),
    "curtain": ((0.55, 0.12, 0.08), 0.9, 0.0),
}


def turned(profile: str, count: int, segments: int = 96) -> Shape:
    """A lathe of a profile in millimetres that is closed at both ends."""
    points = np.maximum(spline(mm(profile), count), 0.0)
    points[[0, -1], 0] = 0.0
    return lathe(points, segments)


def add_pot(stage: Stage, x: float, y: float, turn: float) -> None:
    """A coffee pot with a spout and a handle, in one: it shows itself."""
    body = turned("0 0, 50 0, 56 4, 72 40, 74 70, 60 115, 46 150, 47 172, 50 178, 44 190, 20 201, 8 206, 0 208", 110)
    knob = ellipsoid((0.011, 0.011, 0.013), 16, 24).moved(z_m=0.218)
    spout = tube(spline([[0.062, 0, 0.05], [0.1, 0, 0.07], [0.112, 0, 0.12], [0.14, 0, 0.165]], 36), np.linspace(0.017, 0.008, 36), 24)
    handle = tube(spline([[-0.05, 0, 0.165], [-0.095, 0, 0.17], [-0.115, 0, 0.12], [-0.07, 0, 0.055]], 36), 0.0065, 16)
    stage.add("Coffee Pot", [(joined([body, knob, spout, handle]), "mirror")], (x, y, TOP_Z + 0.009), (0, 0, turn), sharp_deg=60.0)


def add_silver(stage: Stage) -> None:
    """A tray, a sugar bowl of roughness 0.2, an egg cup, spoons."""
    tray = np.maximum(mm("0 0, 165 0, 180 9, 183 9, 183 11, 178 11, 164 3, 0 3"), 0.0)
    stage.add("Tray", [(lathe(tray, 128), "mirror")], (0.02, 0.13, TOP_Z + 0.003), sharp_deg=20.0)
    bowl = turned("0 0, 30 0, 26 8, 40 22, 52 45, 48 66, 46 70, 30 80, 9 86, 10 96, 0 100", 70)
    stage.add("Sugar Bowl", [(bowl, "brushed silver")], (0.2, 0.0, TOP_Z), sharp_deg=60.0)
    cup = turned("0 0, 24 0, 22 4, 7 12, 7 24, 22 36, 26 54, 24.5 54, 20 38, 0 32", 60, 64)
    stage.add("Egg Cup", [(cup, "mirror")], (-0.2, -0.03, TOP_Z), sharp_deg=60.0)
    t = np.linspace(-np.pi / 2, np.pi / 2, 31)
    egg = np.maximum(np.column_stack([0.0215 * np.cos(t) * (1.0 - 0.13 * np.sin(t)), 0.0285 * np.sin(t)]), 0.0)
    egg[[0, -1], 0] = 0.0
    stage.add("Egg", [(lathe(egg, 40), "eggshell")], (-0.2, -0.03, TOP_Z + 0.062))
    spoon = ellipsoid((0.021, 0.014, 0.0032), 16, 32)
    stem = tube(spline([[-0.018, 0, 0.0], [-0.06, 0, 0.006], [-0.125, 0, 0.001]], 24), np.linspace(0.0022, 0.0032, 24), 12)
    for k, (x, y, turn) in enumerate(((-0.29, -0.06, 2.0), (0.33, 0.02, 1.2))):
        stage.add(f"Spoon {k + 1}", [(joined([spoon, stem]), "mirror")], (x, y, TOP_Z + 0.0045), (0, 0, turn), sharp_deg=60.0)


def add_food(stage: Stage) -> None:
    """Toast, an orange, a bowl of fruit, a jug."""
    slices = joined([box((0.1, 0.014, 0.1)).turned(rotation_about("x", 0.25)).moved(0, 0.026 * k, 0.052) for k in range(4)])
    stage.add("Toast", [(slices, "toast")], (-0.38, 0.22, TOP_Z), (0, 0, 0.5), bevel_m=0.004)
    props_fruit.add_copies(stage, "Orange", props_fruit.orange_parts(), [((0.08, -0.07, TOP_Z + 0.036), (0.4, 0.2, 0.0), 1.0)])
    props_fruit.add_copies(stage, "Lemon", props_fruit.lemon_parts(), [((-0.07, -0.06, TOP_Z + 0.028), (0.0, 0.1, 0.7), 1.0)])
    props_fruit.add_bowl(stage, 0.47, 0.24, TOP_Z)
    props_fruit.fill_bowl(stage, 0.47, 0.24, TOP_Z)
    props_table.add_jug(stage, -0.18, 0.34, TOP_Z, np.radians(200.0))


def add_room(stage: Stage) -> None:
    """Striped walls, boards, chairs, a curtain beside the light."""
    stripes: tuple[list[Shape], list[Shape]] = ([], [])
    for k, along in enumerate(np.arange(-2.4, 2.4, 0.3) + 0.15):
        ends = [box((0.3, 0.1, 2.6), (along, y, 1.3)) for y in (2.0, -2.6)]
        sides = [box((0.1, 0.3, 2.6), (x, along - 0.3, 1.3)) for x in (2.4, -2.4)]
        stripes[k % 2].extend(ends + sides)
    stage.add("Walls", [(joined(stripes[0]), "stripe light"), (joined(stripes[1]), "stripe dark")], sharp_deg=20.0)
    boards = [box((0.198, 4.8, 0.02), (x, -0.3, -0.01)) for x in np.arange(-2.4, 2.4, 0.2) + 0.1]
    stage.add("Boards", [(joined(boards), "oak light")], sharp_deg=20.0)
    stage.add("Curtain", [(box((0.06, 0.7, 2.2)), "curtain")], (-1.9, -1.4, 1.2), sharp_deg=20.0)
    chairs: list[bpy.types.ID] = []
    for x, y, turn in ((-0.35, -0.75, np.pi - 0.2), (0.75, -0.6, np.pi + 0.5), (0.0, 0.95, 0.1), (-1.15, 0.2, np.pi / 2)):
        add_chair(stage, x, y, turn, chairs)


def build(scene: bpy.types.Scene) -> None:
    """Fill an empty scene."""
    stage = Stage(scene, PALETTE | OWN, "Breakfast")
    add_room(stage)
    props_table.add_table(stage)
    add_pot(stage, 0.0, 0.13, 0.6)
    add_silver(stage)
    add_food(stage)
    stage.area_light("Window", "RECTANGLE", (1.0, 1.4), 90.0, (0.9, 0.95, 1.0), (-1.8, -0.6, 1.9), (0.0, 0.1, 0.8))
    stage.point_light("Lamp", 0.08, 14.0, (1.0, 0.8, 0.55), (0.6, 0.3, 1.75))
    stage.world("Dim", (0.6, 0.7, 0.85), 0.25)
    stage.camera(50.0, (0.28, -1.0, 1.22), (0.02, 0.1, 0.82))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
