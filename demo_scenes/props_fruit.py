"""Fruit in a bowl, grapes, lemon and peel, a woven basket. Fruit and nuts are linked duplicates. Metres."""

from __future__ import annotations

import numpy as np

from .shapes import Shape, ellipsoid, joined, lathe, mm, rotation_about, sheet, smoothstep, spline, tube, unit, waves
from .stage import Part, Stage


def _bumpy(shape: Shape, amount_m: float, wavelength_m: float, seed: int) -> Shape:
    out = unit(shape.points - shape.points.mean(axis=0))
    return Shape(shape.points + out * amount_m * waves(shape.points, wavelength_m, seed)[:, None], shape.quads, shape.triangles)


def _dome(profile: np.ndarray, count: int = 40, segments: int = 48) -> Shape:
    smooth = spline(profile, count)
    smooth[[0, -1], 0] = 0.0
    smooth[1:-1, 0] = np.maximum(smooth[1:-1, 0], 0.0004)
    return lathe(smooth, segments)


def apple_parts() -> list[Part]:
    """Origin at its middle, radius about 38 mm."""
    body = _dome(mm("0 -28, 6 -31, 15 -34, 28 -26, 37 -4, 36 14, 26 29, 12 31, 4 26, 0 22"))
    stalk = tube(spline([[0, 0, 0.021], [0.001, 0, 0.033], [0.005, 0.001, 0.044]], 10), np.linspace(0.0011, 0.0018, 10), 8)
    return [(_bumpy(body, 0.0007, 0.05, 31), "apple"), (stalk, "bark")]


def pear_parts() -> list[Part]:
    body = _dome(mm("0 -34, 7 -37, 22 -34, 36 -14, 33 10, 20 34, 14.5 52, 8 61, 0 61"), 56)
    stalk = tube(spline([[0, 0, 0.058], [0.001, 0, 0.072], [0.006, 0.002, 0.086]], 12), np.linspace(0.0014, 0.0021, 12), 8)
    return [(_bumpy(body, 0.0009, 0.05, 32), "pear"), (stalk, "bark")]


def orange_parts() -> list[Part]:
    body = _bumpy(ellipsoid((0.037, 0.037, 0.0355), 40, 64), 0.00022, 0.006, 33)
    return [(body, "orange"), (ellipsoid((0.003, 0.003, 0.0012), 6, 10).moved(z_m=0.0354), "stalk")]


def lemon_parts() -> list[Part]:
    """Long axis along x."""
    body = _dome(mm("0 -45, 4 -44, 9 -38, 22 -27, 28 0, 22 27, 8 37, 4 42, 0 43"))
    body = _bumpy(body, 0.0002, 0.006, 34)
    return [(body.turned(np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])), "lemon")]


def half_lemon_parts() -> list[Part]:
    """Cut face up, at z = 0."""
    t = np.linspace(0, np.pi / 2, 20)
    rind = lathe(np.concatenate([np.column_stack([0.027 * np.sin(t), -0.036 * np.cos(t)]), [[0.0245, 0.0005]]]), 64)
    angle = np.arange(64) * (2 * np.pi / 64)
    radii = np.linspace(0.0245, 0.0001, 14)[:, None]
    pulp = np.stack(
        [
            radii * np.cos(angle),
            radii * np.sin(angle),
            0.0005 - 0.0007 * np.abs(np.sin(4.5 * angle)) ** 0.5 * smoothstep(0.0245, 0.020, radii),
        ],
        axis=-1,
    )
    return [(rind, "lemon"), (sheet(pulp, wrap_columns=True), "lemon pulp")]


def walnut_parts() -> list[Part]:
    body = ellipsoid((0.019, 0.016, 0.016), 36, 48)
    crease = np.abs(waves(body.points, 0.011, 35))
    seam = np.exp(-((body.points[:, 1] / 0.0016) ** 2))
    out = unit(body.points)
    return [(Shape(body.points + out * (0.0009 * np.sqrt(crease) + 0.0012 * seam)[:, None], body.quads, body.triangles), "walnut")]


def add_copies(stage: Stage, name: str, parts: list[Part], placements: list[tuple]) -> None:
    """Linked duplicates; a placement is ((x, y, z), (rx, ry, rz), scale)."""
    first = stage.add(name, parts, *placements[0][:2])
    first.scale = (placements[0][2],) * 3
    for i, (place, turn, scale) in enumerate(placements[1:], 1):
        stage.place(f"{name}.{i:03d}", first.data, place, turn, scale)


def add_bowl(stage: Stage, x: float, y: float, z: float) -> None:
    """A footed bowl with a fluted rim."""
    outside = spline(mm("56 0, 60 4, 50 18, 62 26, 108 50, 136 82, 148 106, 151.5 110"), 72)
    inside = spline(mm("149.5 111.5, 144 106, 131 83, 103 54, 60 32, 20 26.5"), 48)
    body = lathe(np.concatenate([[[0, 0.006], [0.044, 0.006], [0.05, 0.0]], outside, inside, [[0, 0.026]]]), 120)
    angle = np.arctan2(body.points[:, 1], body.points[:, 0])
    flute = 1.0 + 0.022 * np.cos(24 * angle) * smoothstep(0.045, 0.11, body.points[:, 2])
    stage.add(
        "Bowl",
        [(Shape(body.points * np.column_stack([flute, flute, np.ones_like(flute)]), body.quads, body.triangles), "porcelain")],
        (x, y, z),
        sharp_deg=60,
    )


def fill_bowl(stage: Stage, x: float, y: float, z: float) -> None:
    """Two layers of fruit; heights fit the bowl of `add_bowl` standing at (x, y, z)."""
    rng = np.random.default_rng(41)
    lower = [(x + 0.077 * np.cos(a), y + 0.077 * np.sin(a), z + 0.088) for a in np.arange(5) * 2 * np.pi / 5 + 0.35]
    upper = [(x + 0.041 * np.cos(a), y + 0.041 * np.sin(a), z + 0.146) for a in (0.2, 2.35, 4.4)]

    def tumbled(place: tuple) -> tuple:
        return (place, (*rng.uniform(-0.7, 0.7, 2), rng.uniform(0, 6.28)), rng.uniform(0.96, 1.04))

    add_copies(stage, "Orange", orange_parts(), [tumbled(p) for p in (lower[0], lower[2], upper[1])])
    add_copies(stage, "Apple", apple_parts(), [tumbled(p) for p in (lower[1], lower[4], upper[0])])
    add_copies(
        stage, "Pear", pear_parts(), [(lower[3], (0.3, -0.5, 1.0), 1.0), ((*upper[2][:2], upper[2][2] + 0.002), (-0.35, 0.55, 0.4), 1.0)]
    )


def add_grapes(stage: Stage, x: float, y: float, z: float, turn: float, count: int = 70) -> None:
    """A bunch lying on the surface at height z, its stalk at (x, y), tapering along `turn`."""
    rng = np.random.default_rng(51)
    radius = 0.0105
    centres: list[np.ndarray] = []
    for _ in range(4000):
        t = rng.uniform(0, 1) ** 0.8
        width = 0.030 * (1 - t) ** 0.7 + 0.006
        p = np.array([0.02 + 0.125 * t, rng.uniform(-1, 1) * width * 1.15, radius + rng.uniform(0, 1) * width * 1.3])
        if len(centres) < count and all(np.linalg.norm(p - q) > 1.72 * radius for q in centres):
            centres.append(p)
    c, s = np.cos(turn), np.sin(turn)
    base = np.array([x, y, z])
    spots = [np.add(base, (c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])) for p in centres]
    parts: list[Part] = [(ellipsoid((radius, radius, radius * 1.12), 14, 20), "grape")]
    add_copies(stage, "Grape", parts, [(tuple(p), tuple(rng.uniform(-1, 1, 3)), rng.uniform(0.9, 1.05)) for p in spots])
    stem = np.array(
        [
            [c * u - s * v, s * u + c * v, w]
            for u, v, w in ((-0.035, 0.012, 0.034), (-0.01, 0.002, 0.028), (0.03, 0, 0.022), (0.09, 0, 0.012))
        ]
    )
    twigs = [spline(stem + base, 24)]
    twigs += [np.array([twigs[0][min(int(6 + 18 * p[0] / 0.135), 23)], spot]) for p, spot in zip(centres, spots, strict=True)]
    stage.curve("Grape Stems", twigs, 0.0011, "stalk", sides=1)


def add_peel(stage: Stage, start: tuple[float, float, float], drop_m: float) -> None:
    """A lemon peel: a ribbon that leaves the plate, bends over the table's edge and coils down."""
    t = np.linspace(0.0, 1.0, 260)
    fall = smoothstep(0.10, 0.30, t)
    angle = 2 * np.pi * 3.4 * t + 0.6
    radius = 0.021 * (1.0 - 0.25 * t) * fall + 0.004
    path = np.column_stack(
        [
            start[0] + radius * np.cos(angle),
            start[1] - 0.055 * smoothstep(0.0, 0.28, t) + radius * np.sin(angle),
            start[2] + 0.006 * np.sin(np.pi * np.clip(t / 0.25, 0, 1)) - drop_m * smoothstep(0.12, 1.1, t) * 1.05,
        ]
    )
    outward = np.column_stack([np.cos(angle), np.sin(angle), 0.25 + 0 * angle])
    tangent = unit(np.gradient(path, axis=0))
    outward = unit(outward - tangent * (outward * tangent).sum(axis=1, keepdims=True))
    across = np.cross(tangent, outward)
    half = 0.0075 * (0.25 + 0.75 * np.sin(np.pi * np.clip(t, 0.02, 0.98)) ** 0.4)
    s = np.linspace(-1, 1, 7)[None, :, None]
    skin = path[:, None] + across[:, None] * s * half[:, None, None] - outward[:, None] * 0.0016 * s**2
    ribbon = stage.add("Lemon Peel", [(sheet(skin).flipped(), "lemon")], sharp_deg=180)
    solid = ribbon.modifiers.new("Solidify", "SOLIDIFY")
    solid.thickness, solid.offset = 0.0016, -1.0


def _oval(angle: np.ndarray, radius: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(1.28 * radius * np.cos(angle), radius * np.sin(angle), z), axis=-1)


def add_basket(stage: Stage, x: float, y: float, z: float, turn: float) -> None:
    """An oval willow basket: stakes, woven rows, a braided rim and a twisted handle."""
    height, stakes, rows = 0.115, 36, 17

    def wall(w: np.ndarray) -> np.ndarray:
        return 0.078 + 0.030 * np.sin(0.5 * np.pi * np.clip(w, 0, 1)) ** 0.9

    w = np.linspace(0.0, 1.04, 14)
    parts: list[Part] = []
    for i in range(stakes):
        parts.append((tube(_oval(np.full(14, 2 * np.pi * i / stakes), wall(w), 0.004 + w * height), 0.0022, 6), "willow dark"))
    angle = np.linspace(0, 2 * np.pi, stakes * 5, endpoint=False)
    for row in range(rows):
        v = (row + 0.5) / rows
        weave = 0.0036 * np.cos(0.5 * stakes * angle + np.pi * row)
        path = _oval(angle, wall(np.array(v)) + weave, np.array(0.004 + v * height))
        parts.append((tube(path, 0.0031, 6, closed=True), "willow" if row % 6 else "willow dark"))
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    for strand in range(3):
        phase = 22 * angle + strand * 2 * np.pi / 3
        path = _oval(angle, wall(np.array(1.0)) + 0.0045 * np.cos(phase), height + 0.008 + 0.0045 * np.sin(phase))
        parts.append((tube(path, 0.0034, 6, closed=True), "willow"))
    t = np.linspace(0, np.pi, 180)
    for strand in range(3):
        phase = 34 * t + strand * 2 * np.pi / 3
        reach = 0.106 + 0.0042 * np.cos(phase)
        path = np.column_stack(
            [0.0042 * np.sin(phase), reach * np.cos(t), height * 0.7 + 0.185 * np.sin(t) ** 0.8 + 0.0042 * np.cos(phase) * np.sin(t)]
        )
        parts.append((tube(path, 0.0036, 6), "willow"))
    base = lathe(mm("0 0, 78 0, 80 3, 78 6, 0 6"), 72)
    parts.append((Shape(base.points * (1.28, 1, 1), base.quads, base.triangles), "willow dark"))
    shape_by_material: dict[str, list[Shape]] = {}
    for shape, material in parts:
        shape_by_material.setdefault(material, []).append(shape)
    stage.add("Basket", [(joined(shapes), material) for material, shapes in shape_by_material.items()], (x, y, z), (0, 0, turn))


def fill_basket(stage: Stage, x: float, y: float, z: float, turn: float) -> None:
    """Eggs on a nest of hay, for the basket of `add_basket` at the same place."""
    rng = np.random.default_rng(61)
    about = rotation_about("z", turn)
    arc = np.linspace(-1.0, 1.0, 9)[:, None]
    blades = []
    for _ in range(420):
        heading, bend = rng.uniform(0, 2 * np.pi), rng.normal() * 0.02
        reach, middle = rng.uniform(0.03, 0.07), rng.normal(size=2) * (0.05, 0.036)
        flat = middle + reach * arc * (np.cos(heading), np.sin(heading)) + bend * arc**2 * (-np.sin(heading), np.cos(heading))
        inside = np.maximum(np.hypot(flat[:, 0] / 1.28, flat[:, 1]) / 0.099, 1.0)[:, None]
        height = rng.uniform(0.055, 0.096) + 0.012 * arc**2 * rng.uniform(-0.5, 1.5) + 0.25 * np.hypot(*(flat / inside).T)[:, None] ** 2
        blades.append(np.column_stack([flat / inside, height]) @ about.T + np.array([x, y, z]))
    stage.curve("Hay", blades, 0.0007, "hay", sides=0)
    spots = np.array(
        [(0.0, 0.0), (0.05, 0.012), (-0.05, 0.006), (0.024, 0.046), (-0.027, 0.047), (0.026, -0.042), (-0.026, -0.04), (0.077, -0.03)]
    )
    eggs = [(*np.add((about @ (*spot, 0.0))[:2], (x, y)), z + 0.114 + 0.002 * (i % 2)) for i, spot in enumerate(spots)]
    t = np.linspace(-np.pi / 2, np.pi / 2, 31)
    profile = np.column_stack([0.0215 * np.cos(t) * (1.0 - 0.13 * np.sin(t)), 0.0285 * np.sin(t)])
    profile[[0, -1], 0] = 0.0
    placements = [(place, (rng.uniform(0.9, 1.9), 0.0, rng.uniform(0, 6.28)), rng.uniform(0.95, 1.04)) for place in eggs]
    add_copies(stage, "Egg", [(lathe(profile, 40), "eggshell")], placements)
