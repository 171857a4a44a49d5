"""A still life by an old kitchen's window: fine foliage, woven and pierced things, three area lights.

    python -m demo_scenes.still_life OUT.blend

Built from closed forms and seeded noise only, in metres: the same geometry on every run.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from . import props_fruit, props_plants, props_room, props_table
from .palette import PALETTE
from .props_table import TOP_Z
from .stage import Stage, save_scene

BRANCHES = [(0.6, -0.1, 1.0, 0.52), (-0.5, -0.25, 1.0, 0.50), (0.1, 0.1, 1.0, 0.40), (-1.0, 0.0, 0.5, 0.40), (1.0, -0.25, 0.42, 0.44)]
"""Heading (x, y, z) and length of the branches in the vase."""


def add_lights(stage: Stage) -> None:
    stage.area_light("Key", "SQUARE", (0.0625, 0.0625), 620.0, (1.0, 0.85, 0.64), (-3.75, -3.0, 3.0), (0.0, 0.1, 0.9))
    stage.area_light("Window", "RECTANGLE", (2.0, 1.25), 24.0, (0.70, 0.84, 1.0), (-1.4375, -0.75, 1.5), (-0.4375, -0.75, 1.5))
    stage.area_light(
        "Lamp", "DISK", (0.1875, 0.1875), 9.0, (1.0, 0.70, 0.40), (0.46875, 0.03125, 1.421875), (0.46875, 0.03125, 0.75), 130.0
    )


def add_props(stage: Stage) -> None:
    props_room.add_floor(stage)
    props_room.add_walls(stage)
    props_room.add_wainscot(stage)
    props_room.add_window(stage)
    props_room.add_shutter(stage, 0.25, np.radians(4.0))
    props_room.add_lamp(stage, 0.46875, 0.03125, 1.40625)
    props_table.add_table(stage)
    mouth = props_plants.add_vase(stage, -0.14, 0.24, TOP_Z)
    props_plants.add_branches(stage, -0.14, 0.24, mouth, BRANCHES)
    props_plants.add_fallen_petals(stage, (0.06, 0.1, TOP_Z), (0.22, 0.14), 64)
    props_table.add_cloth(stage, (-0.36, -0.14), (0.42, 0.5), np.radians(24.0))
    props_table.add_lace(stage, (0.27, -0.065), 0.215)
    props_fruit.add_bowl(stage, 0.27, -0.03, TOP_Z + 0.003)
    props_fruit.fill_bowl(stage, 0.27, -0.03, TOP_Z + 0.003)
    props_fruit.add_basket(stage, 0.50, 0.30, TOP_Z, np.radians(20.0))
    props_fruit.fill_basket(stage, 0.50, 0.30, TOP_Z, np.radians(20.0))
    top = props_table.add_books(
        stage,
        -0.54,
        0.31,
        TOP_Z,
        [(0.17, 0.24, 0.036), (0.15, 0.21, 0.027), (0.12, 0.18, 0.021)],
        [0.35, 0.12, 0.6],
        ["book red", "book blue", "book ochre"],
    )
    props_table.add_candle(stage, -0.54, 0.31, top)
    props_table.add_plate(stage, -0.07, -0.10, TOP_Z)
    props_table.add_knife(stage, (0.02, -0.20, TOP_Z + 0.0195), (0.0, -0.10, np.radians(118.0)))
    props_table.add_jug(stage, -0.33, 0.08, TOP_Z, np.radians(200.0))
    props_fruit.add_copies(stage, "Half Lemon", props_fruit.half_lemon_parts(), [((-0.12, -0.10, TOP_Z + 0.031), (0.75, -0.3, 0.0), 1.0)])
    props_fruit.add_peel(stage, (-0.085, -0.20, TOP_Z + 0.012), 0.16)
    props_fruit.add_copies(stage, "Lemon", props_fruit.lemon_parts(), [((-0.055, -0.045, TOP_Z + 0.032), (0.2, 0.0, 0.35), 1.0)])
    props_fruit.add_grapes(stage, 0.485, -0.055, TOP_Z, np.radians(-40.0))
    walnuts = [
        ((0.04, 0.06, TOP_Z + 0.016), (0.3, 0.2, 0.5), 1.0),
        ((0.075, 0.095, TOP_Z + 0.016), (0.1, 0.1, 2.0), 0.95),
        ((0.63, -0.13, TOP_Z + 0.016), (0.5, 0.0, 1.2), 1.0),
    ]
    props_fruit.add_copies(stage, "Walnut", props_fruit.walnut_parts(), walnuts)


def set_up_render(scene: bpy.types.Scene) -> None:
    scene.unit_settings.system = "METRIC"
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 960, 540, 100
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - High Contrast"


def build(scene: bpy.types.Scene) -> None:
    """Fill an empty scene."""
    stage = Stage(scene, PALETTE, "Still Life")
    set_up_render(scene)
    stage.world("Dim", (0.55, 0.65, 0.8), 0.12)
    add_props(stage)
    add_lights(stage)
    stage.camera(48.0, (0.5, -2.625, 1.40625), (0.03125, 0.0, 0.984375))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
