"""The room: floor boards, plaster, wainscot, a casement window with a louvred shutter, a pendant lamp. Metres."""

from __future__ import annotations

import numpy as np

from .shapes import Shape, box, holed_slab, joined, lathe, mm, rotation_about, sheet, spline, tube, waves, welded
from .stage import Stage

LEFT_WALL_X, BACK_WALL_Y = -1.125, 0.5625
WINDOW = ((-1.75, 0.875), (0.25, 2.125))
"""The hole in the left wall: (y, z) of its near lower and far upper corner."""
WALL_THICKNESS = 0.25


def _facing_right(shape: Shape) -> Shape:
    """From the xy plane (z towards the viewer) to a wall that faces +x: x becomes y, y becomes z."""
    return shape.turned(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))


def add_floor(stage: Stage) -> None:
    width, length = 0.125, 3.75
    board = stage.add("Floor Board", [(box((width - 0.003, length, 0.03), (0, 0, -0.015)), "floor")], bevel_m=0.0015)
    bevel = board.modifiers["Bevel"]
    for i in range(26):
        place = (LEFT_WALL_X + width * (i + 0.5), BACK_WALL_Y - length / 2, -0.0008 * (i * 7 % 4))
        if i == 0:
            board.location = place
            continue
        other = stage.place(f"Floor Board.{i:03d}", board.data, place)
        copy = other.modifiers.new("Bevel", "BEVEL")
        copy.width, copy.segments, copy.limit_method, copy.harden_normals = bevel.width, 2, "ANGLE", True
    stage.add("Subfloor", [(box((3.5, 4.0, 0.0625), (0.5, -1.25, -0.065)), "dark gap")])


def add_walls(stage: Stage) -> None:
    """The back wall is uneven plaster above a boarded wainscot; the left wall has the window's hole."""
    x, z = np.meshgrid(np.linspace(LEFT_WALL_X, 2.125, 112), np.linspace(0.0, 2.75, 96))
    flat = np.stack([x, np.full_like(x, BACK_WALL_Y), z], axis=-1)
    flat[..., 1] += 0.0012 * waves(flat, 0.35, 5) + 0.0006 * waves(flat, 0.09, 6)
    behind = flat.copy()
    behind[..., 1] = BACK_WALL_Y + 0.125
    rim = [np.concatenate([a[0, :], a[1:, -1], a[-1, -2::-1], a[-2:0:-1, 0]]) for a in (behind, flat)]
    stage.add("Back Wall", [(welded(joined([sheet(flat), sheet(behind).flipped(), sheet(np.array(rim), wrap_columns=True)])), "plaster")])
    left = holed_slab(np.array([[-3.5, 0.0], [BACK_WALL_Y + 0.0625, 2.75]]), np.array(WINDOW), WALL_THICKNESS)
    stage.add("Left Wall", [(_facing_right(left), "plaster")], (LEFT_WALL_X, 0, 0), bevel_m=0.006)
    stage.add("Right Wall", [(box((0.125, 4.0, 2.75), (2.1875, -1.4, 1.375)), "plaster")])
    stage.add("Ceiling", [(box((3.5, 4.25, 0.125), (0.5, -1.4, 2.8125)), "plaster")])


def add_wainscot(stage: Stage) -> None:
    """Tongue-and-groove boards by an array modifier, a rail above and a skirting below."""
    pitch, height = 0.09375, 0.84375
    board = stage.add(
        "Wainscot",
        [(box((pitch - 0.002, 0.014, height), (0, 0, height / 2)), "panel")],
        (LEFT_WALL_X + pitch / 2, BACK_WALL_Y - 0.009, 0),
        bevel_m=0.004,
    )
    array = board.modifiers.new("Array", "ARRAY")
    array.count, array.use_relative_offset, array.use_constant_offset = 35, False, True
    array.constant_offset_displace = (pitch, 0, 0)
    run = 3.25
    rail = mm("0 0, 24 0, 30 10, 30 22, 40 30, 40 45, 0 45")
    skirting = mm("0 0, 30 0, 30 90, 24 105, 18 110, 18 125, 0 125")
    for name, profile, base in (("Dado Rail", rail, height), ("Skirting", skirting, 0.0)):
        ends = np.array([LEFT_WALL_X, LEFT_WALL_X + run])
        points = np.stack(
            [
                np.broadcast_to(ends[:, None], (2, len(profile))),
                np.broadcast_to(BACK_WALL_Y - profile[:, 0], (2, len(profile))),
                np.broadcast_to(base + profile[:, 1], (2, len(profile))),
            ],
            axis=-1,
        )
        strip = sheet(points, wrap_columns=True).flipped()
        middle = [np.array([[x, BACK_WALL_Y - 0.012, base + 0.02]]) for x in ends]
        count = np.arange(len(profile))
        ahead = (count + 1) % len(profile)
        caps = np.concatenate(
            [
                np.column_stack([count, ahead, np.full(len(profile), 2 * len(profile))]),
                np.column_stack([ahead, count, np.full(len(profile), 2 * len(profile) + 1)]) + np.array([len(profile), len(profile), 0]),
            ]
        )
        stage.add(name, [(Shape(np.concatenate([strip.points, *middle]), strip.quads, caps), "panel")], sharp_deg=35.0)


def add_window(stage: Stage) -> None:
    """Frame, glazing bars and sill, then a louvred shutter that stands open into the room."""
    (y0, z0), (y1, z1) = WINDOW
    rim = 0.0625
    parts = [holed_slab(np.array(WINDOW), np.array([[y0 + rim, z0 + rim], [y1 - rim, z1 - rim]]), 0.06)]
    for y in np.linspace(y0 + rim, y1 - rim, 5)[1:-1]:
        parts.append(box((0.05, z1 - z0 - 2 * rim, 0.05), (y, (z0 + z1) / 2, -0.03)))
    for z in np.linspace(z0 + rim, z1 - rim, 4)[1:-1]:
        parts.append(box((y1 - y0 - 2 * rim, 0.03, 0.03), ((y0 + y1) / 2, z, -0.03)))
    stage.add("Window Frame", [(_facing_right(joined(parts)), "white paint")], (LEFT_WALL_X - 0.125, 0, 0), bevel_m=0.004)
    stage.add(
        "Window Sill", [(box((0.20, y1 - y0 + 0.08, 0.03)), "white paint")], (LEFT_WALL_X - 0.04, (y0 + y1) / 2, z0 + 0.012), bevel_m=0.006
    )


def add_shutter(stage: Stage, hinge_y: float, open_rad: float, width: float = 0.46875) -> None:
    """A louvred leaf: local x runs from the hinge, z up; its slats come from an array modifier."""
    base, height, stile = WINDOW[0][1] + 0.03125, WINDOW[1][1] - WINDOW[0][1] - 0.0625, 0.05
    frame = holed_slab(np.array([[0, 0], [width, height]]), np.array([[stile, stile], [width - stile, height - stile]]), 0.028)
    upright = frame.turned(rotation_about("x", np.pi / 2)).moved(y_m=-0.014)
    rail = box((width - 2 * stile + 0.002, 0.028, 0.05), (width / 2, 0, height * 0.46))
    place, turn = (LEFT_WALL_X + 0.02, hinge_y, base), (0.0, 0.0, open_rad)
    stage.add("Shutter", [(joined([upright, rail]), "white paint")], place, turn, bevel_m=0.003)
    across = box((width - 2 * stile + 0.006, 0.044, 0.006)).turned(rotation_about("x", np.radians(-18.0)))
    pitch = 0.0375
    for name, low, high in (("Louvres Lower", stile, height * 0.46 - 0.025), ("Louvres Upper", height * 0.46 + 0.025, height - stile)):
        count = int((high - low) / pitch)
        first = low + (high - low - (count - 1) * pitch) / 2
        slat = stage.add(name, [(across.moved(width / 2, 0, first), "white paint")], place, turn, bevel_m=0.0015)
        array = slat.modifiers.new("Array", "ARRAY")
        array.count, array.use_relative_offset, array.use_constant_offset = count, False, True
        array.constant_offset_displace = (0, 0, pitch)


def add_lamp(stage: Stage, x: float, y: float, rim_z: float) -> None:
    """An enamelled pendant shade whose rim is at `rim_z`, on a cord to the ceiling."""
    outer = spline(mm("150 0, 146 12, 120 50, 75 92, 40 118, 30 150, 28 175"), 40)
    inner = outer[::-1] * (0.975, 1.0) + (-0.001, -0.002)
    shade = lathe(np.concatenate([[[0.0, 0.172]], inner, [[0.1525, -0.003]], outer, [[0.012, 0.19], [0.0, 0.19]]]), 96)
    socket = lathe(mm("0 185, 16 186, 18 195, 18 225, 12 235, 6 240, 0 240"), 32)
    thing = stage.add("Lamp Shade", [(shade, "enamel green"), (socket, "brass")], (x, y, rim_z))
    thing.data.materials.append(stage.material("enamel white"))
    for polygon in thing.data.polygons[: len(inner) * 96]:
        polygon.material_index = 2
    drop = np.array([[0, 0, 0.238], [0.002, 0, 0.4], [-0.003, 0.001, 0.7], [0, 0, 2.75 - rim_z]])
    stage.curve("Lamp Cord", [np.add(spline(drop, 40), (x, y, rim_z))], 0.003, "cord")
    twist = np.linspace(0, 60 * np.pi, 720)
    line = spline(drop, 720) + 0.0028 * np.column_stack([np.cos(twist), np.sin(twist), np.zeros_like(twist)])
    stage.add("Lamp Cord Twist", [(tube(line, 0.0016, 6), "cord")], (x, y, rim_z))
