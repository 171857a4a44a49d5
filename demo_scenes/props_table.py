"""The table and what is laid on it: cloth, lace, books, candle, plate, cutlery, jug. Metres."""

from __future__ import annotations

import numpy as np

from .shapes import Shape, box, joined, lathe, mm, rotation_about, sheet, smoothstep, spline, tube, unit, waves
from .stage import Stage

TOP_Z, FRONT_Y, BACK_Y, HALF_LENGTH = 0.75, -0.25, 0.5, 0.703125


def add_table(stage: Stage) -> None:
    planks, depth = 5, BACK_Y - FRONT_Y
    width, rng = depth / planks, np.random.default_rng(2)
    for i in range(planks):
        size = (2 * HALF_LENGTH + (0.004, -0.002, 0.003, 0.0, -0.003)[i], width - 0.0022, 0.032)
        place = (0.0, FRONT_Y + width * (i + 0.5), TOP_Z - 0.016 - 0.0006 * (i % 2))
        plank = stage.add(
            f"Table Plank {i + 1}", [(box(size), ("oak", "oak dark", "oak", "oak light", "oak dark")[i])], place, bevel_m=0.003
        )
        plank.rotation_euler[1] = rng.normal() * 0.0003
    rails = [box((2 * HALF_LENGTH - 0.2, 0.02, 0.09), (0, y, 0)) for y in (FRONT_Y + 0.055, BACK_Y - 0.055)]
    rails += [box((0.02, depth - 0.2, 0.09), (x, (FRONT_Y + BACK_Y) / 2, 0)) for x in (-HALF_LENGTH + 0.07, HALF_LENGTH - 0.07)]
    stage.add("Table Apron", [(joined(rails), "oak dark")], (0, 0, TOP_Z - 0.08), bevel_m=0.002)
    turned = spline(mm("17 0, 24 20, 19 50, 24 200, 31 360, 33 470, 22 515, 34 530, 34 548, 24 555"), 90)
    leg = joined([lathe(np.concatenate([[[0.0, 0.0]], turned, [[0.0, 0.556]]]), 40), box((0.068, 0.068, 0.168), (0, 0, 0.634))])
    first = None
    for x in (-HALF_LENGTH + 0.07, HALF_LENGTH - 0.07):
        for y in (FRONT_Y + 0.06, BACK_Y - 0.06):
            if first is None:
                first = stage.add("Table Leg", [(leg, "oak dark")], (x, y, 0))
            else:
                stage.place("Table Leg", first.data, (x, y, 0), (0, 0, np.pi / 2))


def drape(points: np.ndarray, lift_m: float, fold_m: float = 0.0, seed: int = 0) -> np.ndarray:
    """Lay points of the xy plane on the table top; what reaches over the front edge hangs down, in folds of depth `fold_m`."""
    x, y = points[..., 0], points[..., 1]
    radius = 0.004 + lift_m
    over = FRONT_Y + 0.004 - y
    angle = np.clip(over / radius, 0.0, np.pi / 2)
    drop = np.maximum(over - radius * np.pi / 2, 0.0)
    gather = smoothstep(0.0, 0.35, drop)
    wave = np.sin(x * 46.0 + 1.3 * waves(np.stack([x, 0.25 * y], axis=-1), 0.30, seed)) * 0.5 + 0.5
    out = fold_m * wave * (smoothstep(-0.01, 0.16, drop) + 0.12 * smoothstep(-0.004, 0.03, over))
    middle = x.mean()
    new_x = middle + (x - middle) * (1.0 - 0.16 * gather * (fold_m > 0)) + 0.35 * out * np.cos(x * 46.0)
    new_y = np.where(over > 0, FRONT_Y + 0.004 - radius * np.sin(angle), y) - out
    new_z = TOP_Z + lift_m - radius * (1.0 - np.cos(angle)) * (over > 0) - drop
    return np.stack([new_x, new_y, new_z], axis=-1)


def _ridge(x: np.ndarray, y: np.ndarray, a: tuple[float, float], b: tuple[float, float], width: float) -> np.ndarray:
    """A fold of height 1 along the segment a to b, tapering towards b."""
    ab = np.subtract(b, a)
    t = np.clip(((x - a[0]) * ab[0] + (y - a[1]) * ab[1]) / (ab @ ab), 0.0, 1.0)
    away = np.hypot(x - a[0] - t * ab[0], y - a[1] - t * ab[1])
    return np.exp(-((away / (width * (1.0 - 0.5 * t))) ** 2)) * (1.0 - t) ** 0.7


def add_cloth(stage: Stage, centre: tuple[float, float], size_m: tuple[float, float], turn_rad: float) -> None:
    """A linen square that lies across the front edge, with folds that start on the table and deepen as they fall."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 61) * size_m[0], np.linspace(-0.5, 0.5, 61) * size_m[1])
    flat = np.stack([u, v, np.zeros_like(u)], axis=-1) @ rotation_about("z", turn_rad).T + (*centre, 0.0)
    cloth = drape(flat, 0.0022, 0.042, 4)
    x, y = flat[..., 0], flat[..., 1]
    inside = smoothstep(0.0, 0.05, y - FRONT_Y)
    near_edge = np.exp(-np.maximum(y - FRONT_Y, 0.0) / 0.09) * (y > FRONT_Y)
    height = 0.011 * near_edge * inside * (np.sin(x * 46.0 + 1.3 * waves(np.stack([x, 0.25 * y], axis=-1), 0.30, 4)) * 0.5 + 0.5)
    cx, cy = centre
    for a, b, width, rise in (
        ((cx - 0.20, cy + 0.02), (cx + 0.06, cy - 0.06), 0.016, 0.022),
        ((cx + 0.19, cy + 0.10), (cx + 0.02, cy - 0.05), 0.014, 0.018),
        ((cx - 0.02, cy + 0.24), (cx + 0.02, cy + 0.04), 0.015, 0.020),
        ((cx - 0.13, cy + 0.16), (cx - 0.08, cy - 0.02), 0.012, 0.015),
    ):
        height = height + rise * _ridge(x, y, a, b, width) * smoothstep(-0.02, 0.04, y - FRONT_Y)
    cloth[..., 2] += height + 0.0009 * (waves(flat[..., :2], 0.06, 8) + 1.5) * inside
    thing = stage.add("Cloth", [(sheet(cloth), "linen")], sharp_deg=180.0)
    stripes = np.isin(np.arange(60), (4, 5, 7, 52, 54, 55))
    thing.data.materials.append(stage.material("linen blue"))
    thing.data.polygons.foreach_set("material_index", np.broadcast_to(stripes, (60, 60)).astype(np.int32).ravel())
    solid = thing.modifiers.new("Solidify", "SOLIDIFY")
    solid.thickness, solid.offset = 0.0016, 1.0
    smooth = thing.modifiers.new("Subdivision", "SUBSURF")
    smooth.levels = smooth.render_levels = 1
    _add_fringe(stage, cloth[[0, -1]], unit(cloth[[0, -1]] - cloth[[1, -2]]))


def _add_fringe(stage: Stage, hems: np.ndarray, outward: np.ndarray) -> None:
    """Threads along two hems: they hang where the hem hangs, and lie where it lies."""
    rng = np.random.default_rng(9)
    paths = []
    at = np.linspace(0.5, hems.shape[1] - 1.5, 170)
    for edge, out in zip(hems, outward, strict=True):
        for i in at:
            root = edge[int(i)] + (edge[int(i) + 1] - edge[int(i)]) * (i % 1.0)
            lying = root[2] > TOP_Z - 0.002
            way = out[int(i)] * (1, 1, 0 if lying else 1) + rng.normal(size=3) * (0.12, 0.12, 0.0)
            end = root + unit(way) * 0.022
            middle = (root + end) / 2 + rng.normal(size=3) * 0.001
            if lying:
                end[2], middle[2] = TOP_Z + 0.001, (root[2] + TOP_Z + 0.001) / 2
            paths.append(np.array([root, middle, end]))
    stage.curve("Cloth Fringe", paths, 0.0006, "linen", sides=0)


def add_lace(stage: Stage, centre: tuple[float, float], radius_m: float) -> None:
    """A doily of interlaced closed curves r = a + b cos(k angle), laid over the table's front edge."""
    bands = [
        (0.10, 0.05, 12),
        (0.22, 0.07, 12),
        (0.36, 0.07, 24),
        (0.50, 0.07, 24),
        (0.64, 0.075, 36),
        (0.78, 0.075, 36),
        (0.91, 0.085, 36),
    ]
    angle = np.linspace(0.0, 2 * np.pi, 252, endpoint=False)
    rings = []
    for middle, swing, lobes in bands:
        for phase in (0.0, np.pi):
            rings.append(middle + swing * np.cos(lobes * angle + phase))
        rings += [np.full_like(angle, middle - swing), np.full_like(angle, middle + swing)]
    paths = []
    for i, r in enumerate(rings):
        plane = np.stack([centre[0] + radius_m * r * np.cos(angle), centre[1] + radius_m * r * np.sin(angle)], axis=-1)
        paths.append(drape(plane, 0.0012 + 0.0003 * (i % 3)))
    stage.curve("Lace Doily", paths, 0.0009, "lace", closed=True, sides=0)


def add_books(
    stage: Stage, x: float, y: float, z: float, sizes: list[tuple[float, float, float]], turns: list[float], covers: list[str]
) -> float:
    """A stack of books (width, height, thickness); returns the height of its top."""
    for i, ((width, height, thick), turn, cover) in enumerate(zip(sizes, turns, covers, strict=True)):
        board, arc = 0.003, np.linspace(-np.pi / 2, np.pi / 2, 15)
        bulge = thick / 2
        outer = np.column_stack([-width / 2 - np.cos(arc) * bulge * 0.35, thick / 2 + np.sin(arc) * bulge])[::-1]
        inner = np.column_stack([-width / 2 - np.cos(arc) * (bulge - board) * 0.30, thick / 2 + np.sin(arc) * (bulge - board)])
        ring = np.concatenate([[[width / 2, thick]], outer, [[width / 2, 0.0]], [[width / 2, board]], inner, [[width / 2, thick - board]]])
        parts = [(_prism(ring, height), cover)]
        rows = np.linspace(board, thick - board, max(int(thick / 0.0011) // 2 * 2 + 1, 5))
        edge = width / 2 - 0.004 - 0.0005 * (np.arange(len(rows)) % 2)
        curve = 0.30 * (bulge - board) * np.sqrt(np.clip(1 - ((rows - thick / 2) / (bulge - board)) ** 2, 0, 1))
        pages = np.stack([np.column_stack([edge - 0.7 * curve, rows]), np.column_stack([-width / 2 - curve * 0.98, rows])])
        parts.append((_page_block(pages, height - 0.008), "paper"))
        stage.add(f"Book {i + 1}", parts, (x, y, z), (0, 0, turn), sharp_deg=30.0)
        z += thick + 0.0004
    return z


def _prism(ring: np.ndarray, height: float) -> Shape:
    """Sweep a U-shaped (x, z) outline along y; outline point i faces point -1 - i, so strips of quads close the ends."""
    count = len(ring)
    ends = np.stack([np.column_stack([ring[:, 0], np.full(count, y), ring[:, 1]]) for y in (-height / 2, height / 2)])
    side = sheet(ends, wrap_columns=True)
    half = count // 2
    outer, inner = np.arange(half), count - 1 - np.arange(half)
    caps = np.stack([outer[:-1], inner[:-1], inner[1:], outer[1:]], axis=-1)
    return Shape(side.points, np.concatenate([side.quads[:, ::-1], caps[:, ::-1], caps + count]))


def _page_block(pages: np.ndarray, height: float) -> Shape:
    """Leaves between a fore edge and a spine edge, both (rows, 2) in (x, z)."""
    fore, spine = pages
    outline = np.concatenate([fore, spine[::-1]])
    return _prism(outline, height)


def add_candle(stage: Stage, x: float, y: float, z: float) -> None:
    holder = spline(
        mm("55 0, 58 4, 50 10, 18 18, 11 30, 17 45, 10 60, 9 85, 16 100, 10 112, 13 120, 28 124, 29 128, 16 129, 14.5 150, 11.5 150"), 150
    )
    stage.add(
        "Candle Holder",
        [(lathe(np.concatenate([[[0.0, 0.002], [0.05, 0.0]], holder, [[0.011, 0.132], [0.0, 0.132]]]), 64), "brass")],
        (x, y, z),
        sharp_deg=60,
    )
    body = spline(mm("10.8 0, 10.8 50, 10.4 120, 10.2 158, 9.5 163, 7 161.5, 3 158.5"), 40)
    rng = np.random.default_rng(21)
    parts = [(lathe(np.concatenate([[[0.0, 0.0]], body, [[0.0, 0.158]]]), 40), "wax")]
    for angle, length in zip(rng.uniform(0, 2 * np.pi, 5), (0.05, 0.08, 0.035, 0.10, 0.02), strict=True):
        t = np.linspace(0, 1, 14)[:, None]
        drip = np.array([np.cos(angle), np.sin(angle), 0]) * 0.0102 + np.array([0, 0, 0.160]) - t * (0, 0, length)
        parts.append((tube(drip, 0.0013 + 0.0012 * t[:, 0] ** 3, 10), "wax"))
    parts.append((tube(spline([[0, 0, 0.156], [0.0004, 0, 0.165], [0.0022, 0.001, 0.172]], 8), 0.0008, 6), "wick"))
    stage.add("Candle", parts, (x, y, z + 0.132))


def add_plate(stage: Stage, x: float, y: float, z: float) -> None:
    profile = spline(mm("68 0, 75 2, 85 9, 117 13.5, 120 15.5, 117.5 16.8, 86 12.5, 76 5.5, 60 4.2"), 60)
    stage.add(
        "Plate", [(lathe(np.concatenate([[[0, 0.001], [0.06, 0.001]], profile, [[0, 0.004]]]), 112), "pewter")], (x, y, z), sharp_deg=60
    )


def add_knife(stage: Stage, place: tuple[float, float, float], turn: tuple[float, float, float]) -> None:
    """Blade along +x from the bolster at the origin, handle along -x."""
    t = np.linspace(0.0, 1.0, 30)
    spine = 0.0085 - 0.008 * np.clip((t - 0.7) / 0.3, 0, 1) ** 2
    edge = -0.0085 + 0.0086 * np.clip((t - 0.82) / 0.18, 0, 1) ** 2
    mid = (spine + edge) / 2
    half = 0.0009 * (1 - 0.6 * t)
    x = 0.115 * t
    loop = np.stack(
        [
            np.column_stack([x, spine, 0 * x]),
            np.column_stack([x, mid, half]),
            np.column_stack([x, edge, 0 * x]),
            np.column_stack([x, mid, -half]),
        ],
        axis=1,
    )
    blade = sheet(loop, wrap_columns=True)
    ends = Shape(blade.points, np.concatenate([blade.quads, [[3, 2, 1, 0], [116, 117, 118, 119]]]))
    grip = lathe(
        np.column_stack([np.concatenate([[0], spline(mm("6, 8.5, 7.5, 9.5, 7"), 40)[:, 0], [0]]), np.linspace(-0.10, 0.004, 42)]), 24
    )
    grip = grip.turned(rotation_about("y", np.pi / 2))
    stage.add("Knife", [(ends, "steel"), (Shape(grip.points * (1, 1, 0.7), grip.quads, grip.triangles), "horn")], place, turn)


def add_jug(stage: Stage, x: float, y: float, z: float, turn: float) -> None:
    """An enamel jug: a lathe whose rim is pulled into a lip, and a handle."""
    outside = spline(mm("47 0, 51 4, 60 40, 58 75, 42 115, 38 135, 45 155, 47 159"), 60)
    inside = spline(mm("45.5 160, 43 155, 35.5 135, 39.5 115, 55.5 75, 57.5 40, 47 7"), 40)
    body = lathe(np.concatenate([[[0, 0.002], [0.043, 0.002]], outside, inside, [[0, 0.006]]]), 96)
    angle, pull = np.arctan2(body.points[:, 1], body.points[:, 0]), smoothstep(0.118, 0.160, body.points[:, 2])
    lip = (pull * np.exp(-((angle / 0.42) ** 2)))[:, None]
    body = Shape(body.points + lip * (0.024, 0.0, 0.010), body.quads, body.triangles)
    handle = tube(spline(mm("-42 0 148, -72 0 150, -90 0 120, -85 0 75, -57 0 45"), 40), np.linspace(0.0062, 0.0048, 40), 16)
    stage.add("Jug", [(body, "enamel cream"), (handle, "enamel blue")], (x, y, z), (0, 0, turn))
