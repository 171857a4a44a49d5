"""A vase of blossoming branches: bevelled curves, and geometry-nodes instances of leaves and blossoms. Metres."""

from __future__ import annotations

import numpy as np

from .shapes import Shape, ellipsoid, frames_facing, joined, lathe, mm, sheet, spline, tube, unit
from .stage import Stage

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def add_vase(stage: Stage, x: float, y: float, z: float) -> float:
    """Returns the height of its mouth."""
    outside = spline(mm("45 0, 50 6, 83 60, 96 115, 78 170, 40 215, 30 245, 37 272, 42 280"), 72)
    inside = spline(mm("40 281, 34 271, 26 245, 36 213, 72 170, 90 115, 77 60, 44 12"), 40)
    profile = np.concatenate([[[0.0, 0.003], [0.036, 0.003], [0.04, 0.0]], outside, inside, [[0.0, 0.010]]])
    stage.add("Vase", [(lathe(profile, 112), "celadon")], (x, y, z))
    return z + 0.28


def leaf(length: float = 0.056, width: float = 0.0135) -> Shape:
    """Along +x from its stalk at the origin, upper side +z, folded along the midrib and drooping."""
    t = np.linspace(0.0, 1.0, 11)
    half = 0.5 * width * np.sin(np.pi * np.clip(t * 1.08 - 0.08, 0.0, 1.0) ** 0.85) + 0.0006
    across = np.linspace(-1.0, 1.0, 5)
    y = half[:, None] * across
    z = 0.35 * np.abs(y) - 0.011 * (t[:, None] ** 2) + 0.0007 * np.sin(9 * t[:, None] + 2 * across) * np.abs(across)
    return sheet(np.stack([np.broadcast_to(t[:, None] * length, y.shape), y, z], axis=-1)).flipped()


def petal(length: float = 0.0125, width: float = 0.0115) -> Shape:
    """Along +x, cupped towards +z, with a notch at its tip."""
    t, s = np.linspace(0.0, 1.0, 6)[:, None], np.linspace(-1.0, 1.0, 6)[None, :]
    half = (
        0.5
        * width
        * (0.16 + 0.84 * np.sin(np.pi * 0.5 * np.clip(t * 1.5, 0, 1)))
        * np.sqrt(np.clip(1.0 - np.clip((t - 0.62) / 0.5, 0, 1) ** 2, 0.02, 1))
    )
    x = length * t * (1.0 - 0.10 * np.exp(-((s / 0.25) ** 2)) * t**4)
    y = half * s
    z = 0.0045 * t**1.4 + 18.0 * y**2 - 0.0025 * t**5
    return sheet(np.stack(np.broadcast_arrays(x, y, z), axis=-1)).flipped()


def blossom_parts() -> list[tuple[Shape, str]]:
    """Looks along +z; its stalk starts at the origin."""
    lift = 0.014
    petals = []
    for i in range(5):
        angle = 2 * np.pi * i / 5
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
        petals.append(petal().moved(0.0012, 0, 0.0004 * (i % 2)).turned(turn).moved(z_m=lift))
    stamens = []
    for i in range(9):
        angle, reach = i * GOLDEN_ANGLE, 0.0022 + 0.0022 * (i % 3) / 2
        tip = np.array([reach * np.cos(angle), reach * np.sin(angle), lift + 0.0075 - 0.0012 * (i % 3)])
        stamens += [tube(np.array([[0, 0, lift], tip * (0.45, 0.45, 1.0), tip]), 0.00022, 3), ellipsoid((0.0007,) * 3, 2, 4).moved(*tip)]
    stalk = tube(spline([[0, 0, 0], [0.0012, 0, 0.006], [0, 0, lift + 0.0008]], 5), np.array([0.0006, 0.0006, 0.0007, 0.0013, 0.0018]), 5)
    return [(joined(petals), "petal"), (joined(stamens), "stamen"), (stalk, "stalk")]


def _limb(rng: np.random.Generator, start: np.ndarray, heading: np.ndarray, length: float, lift: float, wobble: float) -> np.ndarray:
    """A path that wanders a little and bends upwards (positive lift) or droops."""
    step = 0.015
    points, drift = [start], np.zeros(3)
    for _ in range(max(int(length / step), 3)):
        drift = 0.75 * drift + rng.normal(size=3) * wobble
        heading = unit(heading + drift + np.array([0.0, 0.0, lift * step]))
        points.append(points[-1] + heading * step)
    return np.array(points)


def _grow(rng: np.random.Generator, path: np.ndarray, radius: float, depth: int, limbs: list) -> None:
    """Append (path, radii, depth) of a limb and of all that springs from it."""
    along = np.linspace(0.0, 1.0, len(path))
    limbs.append((path, radius * (1.0 - 0.72 * along) * (1.0 + 0.10 * np.sin(np.arange(len(path)) * 2.1)), depth))
    if depth == 0:
        return
    tangents = unit(np.gradient(path, axis=0))
    spin = rng.uniform(0, 2 * np.pi)
    first, gap = (8, 3) if depth == 2 else (4, 4)
    for i in range(min(first, len(path) // 3), len(path) - 1, gap):
        spin += GOLDEN_ANGLE + rng.normal() * 0.3
        side = unit(np.cross(tangents[i], [0.3, 0.2, 1.0]))
        out = np.cos(spin) * side + np.sin(spin) * np.cross(tangents[i], side)
        heading = unit(tangents[i] + out * rng.uniform(0.6, 1.0))
        length = (len(path) - i) * 0.015 * rng.uniform(0.35, 0.62) + 0.03
        _grow(rng, _limb(rng, path[i], heading, length, 2.0, 0.05), radius * (1.0 - 0.6 * along[i]) * 0.55, depth - 1, limbs)


def _foliage(rng: np.random.Generator, limbs: list) -> tuple[list, list]:
    """(point, frame, scale) of leaves and of blossoms along the younger limbs."""
    leaves, blossoms = [], []
    for path, radii, depth in limbs:
        tangents = unit(np.gradient(path, axis=0))
        for i in range(3 if depth < 2 else len(path) * 2 // 3, len(path)):
            spin = i * GOLDEN_ANGLE + rng.normal() * 0.4
            side = unit(np.cross(tangents[i], [0.2, -0.3, 1.0]))
            out = np.cos(spin) * side + np.sin(spin) * np.cross(tangents[i], side)
            if rng.random() < 0.33:
                facing = unit(out + 0.25 * tangents[i] + rng.normal(size=3) * 0.25 + (0, -0.15, 0.1))
                blossoms.append(
                    (path[i] + out * radii[i] * 0.6, frames_facing(unit(np.cross(facing, side + 0.3)), facing), rng.uniform(1.0, 1.5))
                )
            elif rng.random() < 0.72:
                forward = unit(out + 0.7 * tangents[i] + rng.normal(size=3) * 0.15)
                up = unit(np.array([0.0, -0.15, 1.0]) + rng.normal(size=3) * 0.35)
                leaves.append((path[i] + out * radii[i] * 0.6, frames_facing(forward, up), rng.uniform(0.75, 1.3)))
    return leaves, blossoms


def add_branches(
    stage: Stage, x: float, y: float, mouth_z: float, headings: list[tuple[float, float, float, float]], seed: int = 11
) -> None:
    """Each heading is (x, y, z, length): the main branches leave the vase's mouth that way."""
    rng = np.random.default_rng(seed)
    limbs: list = []
    for i, (hx, hy, hz, length) in enumerate(headings):
        heading = unit(np.array([hx, hy, hz]))
        lean = np.array([hx, hy]) / max(np.hypot(hx, hy), 0.2) * 0.016
        start = np.array([x - 2.5 * lean[0], y - 2.5 * lean[1], mouth_z - 0.16])
        neck = np.array([x + lean[0], y + lean[1], mouth_z])
        path = np.concatenate([np.linspace(start, neck, 8)[:-1], _limb(rng, neck, heading, length, 1.2, 0.035)])
        _grow(rng, spline(path[::2], len(path)), 0.0048 - 0.0004 * i, 2, limbs)
    stage.curve("Branches", [p for p, _, _ in limbs], 1.0, "bark", tapers=[r for _, r, _ in limbs], sides=2)
    leaves, blossoms = _foliage(rng, limbs)
    for name, material, share in (("Leaf Young", "leaf young", leaves[::3]), ("Leaf", "leaf", leaves[1::3] + leaves[2::3])):
        points, frames, scales = (np.array(part) for part in zip(*share, strict=True))
        stage.scatter(f"{name} Cluster", stage.prototype(name, [(leaf(), material)]), points, frames, scales)
    points, frames, scales = (np.array(part) for part in zip(*blossoms, strict=True))
    stage.scatter("Blossoms", stage.prototype("Blossom", blossom_parts()), points, frames, scales)


def add_fallen_petals(stage: Stage, centre: tuple[float, float, float], spread_m: tuple[float, float], count: int, seed: int = 3) -> None:
    rng = np.random.default_rng(seed)
    flat = np.clip(rng.normal(size=(count, 2)), -1.8, 1.8) * spread_m + centre[:2]
    points = np.column_stack([flat, np.full(count, centre[2] + 0.0008)])
    frames = []
    for _ in range(count):
        angle = rng.uniform(0, 2 * np.pi)
        up = unit(np.array([0, 0, 1.0]) + rng.normal(size=3) * 0.12)
        frames.append(frames_facing(unit(np.cross(up, [np.cos(angle), np.sin(angle), 0.0])), up))
    stage.scatter("Fallen Petals", stage.prototype("Petal", [(petal(), "petal")]), points, np.array(frames), rng.uniform(0.8, 1.3, count))
