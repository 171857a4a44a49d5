"""A furnished living room of more than two million triangles around one round lamp: small triangles on all sides of the light.

    python -m demo_scenes.furnished_room OUT.blend

The carpet's tufts, the curtains' folds, cushions and a knitted throw are modelled; books and table ware come from the still life. Metres.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

from . import props_fruit, props_plants, props_table
from .palette import PALETTE
from .props_table import TOP_Z
from .shapes import Shape, box, frames_facing, joined, lathe, mm, repeated, sheet, spline, tube, unit, waves
from .stage import Stage, save_scene

HALF_X_M, FRONT_Y_M, BACK_Y_M, HEIGHT_M = 3.0, -3.6, 2.6, 2.75
BRANCHES = [(0.5, -0.1, 1.0, 0.5), (-0.5, -0.25, 1.0, 0.46), (0.1, 0.3, 1.0, 0.44)]


def add_shell(stage: Stage) -> None:
    """Floor boards, ceiling with a cornice, walls with skirting."""
    depth, middle = BACK_Y_M - FRONT_Y_M, (BACK_Y_M + FRONT_Y_M) / 2
    boards = [box((0.118, depth, 0.02), (x, middle, -0.01)) for x in np.arange(-HALF_X_M, HALF_X_M, 0.12) + 0.06]
    stage.add("Boards", [(joined(boards), "floor")])
    stage.add("Subfloor", [(box((2 * HALF_X_M, depth, 0.1), (0, middle, -0.08)), "dark gap")])
    stage.add("Ceiling", [(box((2 * HALF_X_M + 0.4, depth + 0.4, 0.15), (0, middle, HEIGHT_M + 0.075)), "plaster")])
    sides = [box((0.2, depth + 0.4, HEIGHT_M), (x, middle, HEIGHT_M / 2)) for x in (-HALF_X_M - 0.1, HALF_X_M + 0.1)]
    ends = [box((2 * HALF_X_M, 0.2, HEIGHT_M), (0, y, HEIGHT_M / 2)) for y in (FRONT_Y_M - 0.1, BACK_Y_M + 0.1)]
    stage.add("Walls", [(joined(sides + ends), "plaster")])
    skirting = [box((0.02, depth, 0.12), (x, middle, 0.06)) for x in (-HALF_X_M + 0.01, HALF_X_M - 0.01)]
    skirting += [box((2 * HALF_X_M, 0.02, 0.12), (0, BACK_Y_M - 0.01, 0.06))]
    stage.add("Skirting", [(joined(skirting), "white paint")], bevel_m=0.004)


def add_carpet(stage: Stage, tuft_count: int) -> None:
    """Tufts of wool, each a bent tube of 24 triangles, on a woven ground."""
    rng = np.random.default_rng(31)
    place = np.column_stack([rng.uniform(-1.9, 1.9, tuft_count), rng.uniform(-2.6, 1.2, tuft_count), np.full(tuft_count, 0.004)])
    tuft = tube(spline([[0, 0, 0], [0.002, 0, 0.008], [0.006, 0, 0.014]], 3), np.array([0.003, 0.0035, 0.0025]), 4)
    frames = frames_facing(unit(rng.normal(size=(tuft_count, 3)) * [1, 1, 0.02]), np.array([0.0, 0.0, 1.0]))
    stage.add("Carpet", [(repeated(tuft, place, frames, rng.uniform(0.8, 1.5, tuft_count)), "wool")], sharp_deg=180.0)
    stage.add("Carpet Ground", [(box((3.8, 3.8, 0.008), (0, -0.7, 0.002)), "wool")])


def cushion(size_m: tuple[float, float, float], seed: int, detail: int) -> Shape:
    """A superellipsoid, filled unevenly; (2 * detail) x (3 * detail) cells."""
    polar, azimuth = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, 2 * detail), np.linspace(0, 2 * np.pi, 3 * detail, endpoint=False), indexing="ij"
    )

    def power(x: np.ndarray, exponent: float) -> np.ndarray:
        return np.sign(x) * np.abs(x) ** exponent

    p = np.stack(
        [
            power(np.sin(polar), 0.6) * power(np.cos(azimuth), 0.35),
            power(np.sin(polar), 0.6) * power(np.sin(azimuth), 0.35),
            power(np.cos(polar), 0.8),
        ],
        axis=-1,
    )
    p = p * np.array(size_m) / 2
    p *= 1 + (0.02 * waves(p, 0.25, seed) + 0.006 * waves(p, 0.06, seed + 1))[..., None]
    return sheet(p, wrap_columns=True).flipped()


def add_sofa(stage: Stage, x: float, y: float, detail: int) -> None:
    """Against the back wall, facing -y."""
    frame = [box((2.3, 0.85, 0.22), (0, 0, 0.24)), box((2.3, 0.18, 0.6), (0, 0.36, 0.5))]
    frame += [box((0.16, 0.85, 0.42), (side * 1.1, 0, 0.42)) for side in (-1, 1)]
    frame += [box((0.06, 0.06, 0.13), (1.05 * i, 0.35 * j, 0.065)) for i in (-1, 1) for j in (-1, 1)]
    stage.add("Sofa Frame", [(joined(frame), "upholstery")], (x, y, 0), bevel_m=0.02)
    for i, place in enumerate((-0.68, 0.0, 0.68)):
        stage.add(
            f"Seat {i + 1}", [(cushion((0.68, 0.66, 0.2), 40 + i, detail), "upholstery")], (x + place, y - 0.06, 0.44), sharp_deg=180.0
        )
        back = cushion((0.66, 0.46, 0.2), 50 + i, detail)
        stage.add(f"Back {i + 1}", [(back, "upholstery")], (x + place, y + 0.2, 0.72), (1.35, 0, 0.05 * i - 0.05), sharp_deg=180.0)
    for i, place in enumerate((-0.85, 0.8)):
        pillow = cushion((0.42, 0.42, 0.16), 60 + i, detail)
        stage.add(f"Pillow {i + 1}", [(pillow, "linen blue")], (x + place, y + 0.02, 0.72), (1.1, 0.3 - 0.5 * i, 0.2), sharp_deg=180.0)


def add_throw(stage: Stage, x: float, y: float, detail: int) -> None:
    """Knitted, laid over the sofa's arm: rows of stitches stand out of the sheet."""
    u, v = np.meshgrid(np.linspace(-0.4, 0.4, 2 * detail), np.linspace(-0.55, 0.55, 3 * detail))
    over = np.clip(np.abs(v) - 0.12, 0, None)
    p = np.stack([v - np.sign(v) * over, u, 0.66 - over], axis=-1)
    p[..., 0] += np.sign(v) * 0.03 * (over > 0) + 0.012 * waves(np.stack([u, v], axis=-1), 0.3, 71)
    p[..., 2] += 0.0025 * np.sin(u * 2 * np.pi / 0.012) * np.cos(v * 2 * np.pi / 0.016)
    stage.add("Throw", [(sheet(p), "linen")], (x, y, 0), sharp_deg=180.0)


def add_curtains(stage: Stage, detail: int) -> None:
    """Two panels before the right wall, pleated, hung on a rod."""
    for name, low, high in (("Curtain Near", -2.2, -1.2), ("Curtain Far", 0.4, 1.4)):
        y, z = np.meshgrid(np.linspace(low, high, 3 * detail), np.linspace(0.03, 2.35, 2 * detail))
        fold = 0.05 * (0.6 + 0.4 * (2.35 - z) / 2.35) * np.sin(y * 44 + 0.8 * waves(np.stack([y, 0.2 * z], axis=-1), 0.7, 81))
        stage.add(name, [(sheet(np.stack([HALF_X_M - 0.16 + fold, y, z], axis=-1)).flipped(), "linen blue")], sharp_deg=180.0)
    rod = np.array([[HALF_X_M - 0.16, -2.5, 2.38], [HALF_X_M - 0.16, -0.4, 2.38], [HALF_X_M - 0.16, 1.7, 2.38]])
    stage.add("Curtain Rod", [(tube(rod, 0.014, 20), "brass")])


def add_bookcase(stage: Stage, y: float) -> None:
    """Against the left wall, five shelves of books that lean and vary."""
    rng = np.random.default_rng(91)
    width, depth = 1.8, 0.3
    case = [box((depth, 0.03, 2.0), (0, side * width / 2, 1.0)) for side in (-1, 1)] + [box((0.012, width, 2.0), (-depth / 2, 0, 1.0))]
    case += [box((depth, width, 0.025), (0, 0, z)) for z in np.linspace(0.06, 1.98, 6)]
    x = -HALF_X_M + depth / 2 + 0.03
    stage.add("Bookcase", [(joined(case), "oak")], (x, y, 0), bevel_m=0.002)
    for shelf, z in enumerate(np.linspace(0.06, 1.98, 6)[:-1] + 0.0125):
        along, row = -width / 2 + 0.03, 0
        while along < width / 2 - 0.06:
            thick, high, deep = rng.uniform(0.015, 0.05), rng.uniform(0.19, 0.31), rng.uniform(0.15, 0.23)
            cover = ("book red", "book blue", "book ochre")[int(rng.integers(3))]
            book = joined(
                [box((deep, thick, high), (0, 0, high / 2)), box((deep + 0.004, thick * 0.8, high * 0.97), (-0.004, 0, high / 2))]
            )
            stage.add(
                f"Book {shelf}.{row}", [(book, cover)], (x - 0.02, y + along + thick / 2, z), (rng.normal(0, 0.015), 0, 0), bevel_m=0.0015
            )
            along, row = along + thick + 0.002, row + 1


def add_chair(stage: Stage, x: float, y: float, turn: float, shared: list[bpy.types.ID]) -> None:
    """Turned legs and spindles under and above a plank seat."""
    if not shared:
        leg = spline(mm("0 0, 14 0, 19 60, 13 150, 20 260, 24 330, 15 380, 19 440, 0 440"), 60)
        leg[[0, -1], 0] = 0.0
        spindle = spline(mm("0 0, 8 0, 11 160, 7 300, 9 430, 0 430"), 40)
        spindle[[0, -1], 0] = 0.0
        parts = [lathe(leg, 48).moved(i * 0.18, j * 0.18) for i in (-1, 1) for j in (-1, 1)]
        parts += [lathe(spindle, 32).moved(place, 0.19, 0.47) for place in np.linspace(-0.17, 0.17, 6)]
        parts += [box((0.44, 0.42, 0.035), (0, 0, 0.455)), box((0.44, 0.03, 0.07), (0, 0.19, 0.92))]
        shared.append(stage.add("Chair", [(joined(parts), "oak dark")], (x, y, 0), (0, 0, turn), sharp_deg=40.0).data)
    else:
        stage.place("Chair", shared[0], (x, y, 0), (0, 0, turn))


def add_table(stage: Stage) -> None:
    props_table.add_table(stage)
    props_table.add_cloth(stage, (-0.36, -0.14), (0.42, 0.5), np.radians(24.0))
    props_fruit.add_bowl(stage, 0.27, -0.03, TOP_Z)
    props_fruit.fill_bowl(stage, 0.27, -0.03, TOP_Z)
    props_fruit.add_basket(stage, 0.50, 0.30, TOP_Z, np.radians(20.0))
    props_fruit.fill_basket(stage, 0.50, 0.30, TOP_Z, np.radians(20.0))
    props_table.add_jug(stage, -0.33, 0.08, TOP_Z, np.radians(200.0))
    mouth = props_plants.add_vase(stage, -0.14, 0.24, TOP_Z)
    props_plants.add_branches(stage, -0.14, 0.24, mouth, BRANCHES)
    chairs: list[bpy.types.ID] = []
    for x, y, turn in ((-0.4, -0.6, np.pi - 0.2), (0.45, -0.65, np.pi + 0.3), (-1.1, 0.1, np.pi / 2), (1.1, 0.2, -np.pi / 2)):
        add_chair(stage, x, y, turn, chairs)


def build(scene: bpy.types.Scene, detail: int = 120, tuft_count: int = 30_000) -> None:
    """Fill an empty scene. detail: cells of what is cloth grow with its square."""
    stage = Stage(scene, PALETTE, "Living Room")
    add_shell(stage)
    add_carpet(stage, tuft_count)
    add_sofa(stage, -0.3, 2.05, detail // 2)
    add_throw(stage, 0.8, 2.0, 2 * detail)
    add_curtains(stage, detail)
    add_bookcase(stage, -0.4)
    add_table(stage)
    stage.point_light("Lamp", 0.09, 120.0, (1.0, 0.85, 0.66), (0.1, -0.6, 1.75))
    stage.camera(20.0, (2.3, -3.3, 1.65), (-0.5, 0.6, 0.85))


if __name__ == "__main__":
    sys.exit(save_scene(build, __doc__, sys.argv[1:]))
