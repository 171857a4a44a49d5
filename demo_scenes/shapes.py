"""Closed-form modelling: points and faces as numpy arrays, no bpy. Lengths in metres, angles in radians."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


def _no_faces(corners: int) -> np.ndarray:
    return np.zeros((0, corners), dtype=np.int64)


@dataclass(frozen=True)
class Shape:
    """Faces are counter-clockwise seen from outside."""

    points: np.ndarray
    quads: np.ndarray = field(default_factory=lambda: _no_faces(4))
    triangles: np.ndarray = field(default_factory=lambda: _no_faces(3))

    def moved(self, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> Shape:
        return Shape(np.add(self.points, (x_m, y_m, z_m)), self.quads, self.triangles)

    def turned(self, rotation: np.ndarray) -> Shape:
        return Shape(self.points @ rotation.T, self.quads, self.triangles)

    def flipped(self) -> Shape:
        return Shape(self.points, self.quads[:, ::-1], self.triangles[:, ::-1])


def joined(shapes: list[Shape]) -> Shape:
    starts = np.cumsum([0] + [len(s.points) for s in shapes[:-1]])
    return Shape(
        np.concatenate([s.points for s in shapes]),
        np.concatenate([s.quads + start for s, start in zip(shapes, starts, strict=True)]),
        np.concatenate([s.triangles + start for s, start in zip(shapes, starts, strict=True)]),
    )


def repeated(shape: Shape, places: np.ndarray, frames: np.ndarray, scales: np.ndarray) -> Shape:
    """One shape of many copies. places: (n, 3); frames: (n, 3, 3), a copy's axes as columns; scales: (n,)"""
    points = np.einsum("nij,pj->npi", frames * scales[:, None, None], shape.points) + places[:, None]
    starts = len(shape.points) * np.arange(len(places))[:, None, None]
    return Shape(points.reshape(-1, 3), (shape.quads + starts).reshape(-1, 4), (shape.triangles + starts).reshape(-1, 3))


def welded(shape: Shape) -> Shape:
    """Points of one place (to a hundredth of a millimetre) become one point."""
    _, first, index = np.unique(np.round(shape.points, 5), axis=0, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    return Shape(shape.points[first], index[shape.quads], index[shape.triangles])


def rotation_about(axis: str, angle: float) -> np.ndarray:
    """3x3 rotation about 'x', 'y' or 'z'."""
    c, s = np.cos(angle), np.sin(angle)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = np.eye(3)
    matrix[j, j], matrix[j, k], matrix[k, j], matrix[k, k] = c, -s, s, c
    return matrix


def mm(text: str) -> np.ndarray:
    """Points written compactly: "45 0, 50 6" is (0.045, 0) and (0.05, 0.006)."""
    return np.array([[float(word) for word in point.split()] for point in text.split(",")]) / 1000.0


def frames_facing(forward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(..., 3, 3) columns x = forward, z = as near to up as can be; unit vectors"""
    side = unit(np.cross(up, forward))
    return np.stack([forward, side, np.cross(forward, side)], axis=-1)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def waves(points: np.ndarray, wavelength_m: float, seed: int, count: int = 16) -> np.ndarray:
    """Smooth noise of unit variance: plane waves of random direction and phase around one wavelength."""
    rng = np.random.default_rng(seed)
    dims = points.shape[-1]
    directions = unit(rng.normal(size=(count, dims))) * rng.uniform(0.6, 1.6, size=(count, 1)) * (2 * np.pi / wavelength_m)
    return np.cos(points @ directions.T + rng.uniform(0, 2 * np.pi, count)).sum(axis=-1) * np.sqrt(2.0 / count)


def spline(controls: np.ndarray | list, count: int) -> np.ndarray:
    """`count` points on the Catmull-Rom curve through the control points, evenly spaced by parameter."""
    knots = np.asarray(controls, dtype=float)
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    t = np.linspace(0, len(knots) - 1, count)
    i = np.minimum(t.astype(int), len(knots) - 2)
    f = (t - i)[:, None]
    a, b, c, d = (padded[i + k] for k in range(4))
    return 0.5 * (2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2 + (3 * b - a - 3 * c + d) * f**3)


def sheet(points: np.ndarray, wrap_rows: bool = False, wrap_columns: bool = False) -> Shape:
    """Quads over a (rows, columns, 3) lattice; the normal is column direction x row direction."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap_rows:
        index = np.concatenate([index, index[:1]])
    if wrap_columns:
        index = np.concatenate([index, index[:, :1]], axis=1)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    return Shape(points.reshape(-1, 3), quads.reshape(-1, 4))


def _with_poles(rings: Shape, columns: int, first: np.ndarray | None, last: np.ndarray | None) -> Shape:
    """Close the open ends of a ring lattice with one point each."""
    points, triangles = [rings.points], []
    here = np.arange(columns)
    ahead = (here + 1) % columns
    count = len(rings.points)
    for pole, ring, order in ((first, 0, (1, 0)), (last, count - columns, (0, 1))):
        if pole is None:
            continue
        edge = np.stack([here, ahead], axis=-1)[:, order] + ring
        triangles.append(np.column_stack([edge, np.full(columns, sum(len(p) for p in points))]))
        points.append(np.reshape(pole, (1, 3)))
    return Shape(np.concatenate(points), rings.quads, np.concatenate(triangles) if triangles else _no_faces(3))


def lathe(profile: np.ndarray, segments: int = 64) -> Shape:
    """Turn a (radius, height) profile about z. It runs up the outside and down the inside; radius 0 closes an end."""
    profile = np.asarray(profile, dtype=float)
    first = profile[0] if profile[0, 0] < 1e-6 else None
    last = profile[-1] if profile[-1, 0] < 1e-6 else None
    body = profile[1 if first is not None else 0 : -1 if last is not None else None]
    angle = np.arange(segments) * (2 * np.pi / segments)
    radius, height = np.maximum(body[:, :1], 1e-5), np.broadcast_to(body[:, 1:], (len(body), segments))
    rings = sheet(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1), wrap_columns=True)
    poles = [None if end is None else np.array([0.0, 0.0, end[1]]) for end in (first, last)]
    return _with_poles(rings, segments, *poles)


def frames_along(path: np.ndarray, closed: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangents and two normals that twist as little as possible (open paths: carried along; closed: projected from z)."""
    if closed:
        tangent = unit(np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0))
        side = unit(np.cross(tangent, [0.0, 0.0, 1.0]))
        return tangent, side, np.cross(tangent, side)
    tangent = unit(np.gradient(path, axis=0))
    side = np.empty_like(path)
    side[0] = unit(np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))]))
    for i in range(1, len(path)):
        side[i] = unit(side[i - 1] - tangent[i] * (side[i - 1] @ tangent[i]))
    return tangent, side, np.cross(tangent, side)


def tube(path: np.ndarray, radius_m: float | np.ndarray, sides: int = 6, closed: bool = False) -> Shape:
    """A round tube along a path, capped with a point at each end unless closed."""
    path = np.asarray(path, dtype=float)
    tangent, side, up = frames_along(path, closed)
    angle = np.arange(sides) * (2 * np.pi / sides)
    radius = np.broadcast_to(radius_m, len(path))[:, None, None]
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    rings = sheet(path[:, None] + radius * ring, wrap_rows=closed, wrap_columns=True)
    if closed:
        return rings
    ends = path[[0, -1]] + tangent[[0, -1]] * np.array([[-0.3], [0.3]]) * radius[[0, -1], 0]
    return _with_poles(rings, sides, ends[0], ends[1])


def box(size_m: tuple[float, float, float], centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))])
    quads = np.array([[3, 2, 1, 0], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    return Shape(corners * size_m + np.asarray(centre_m), quads)


def holed_slab(outer: np.ndarray, inner: np.ndarray, thickness_m: float) -> Shape:
    """A rectangular slab in the xy plane, z from -thickness to 0, with a rectangular hole; rectangles are ((x0, y0), (x1, y1))."""
    rings = []
    for (x0, y0), (x1, y1) in (outer, inner, inner, outer):
        rings.append([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    heights = np.array([0.0, 0.0, -thickness_m, -thickness_m])
    points = np.concatenate([np.array(rings), np.broadcast_to(heights[:, None, None], (4, 4, 1))], axis=-1)
    return sheet(points, wrap_rows=True, wrap_columns=True)


def ellipsoid(radii_m: tuple[float, float, float], rings: int = 16, segments: int = 24) -> Shape:
    t = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.column_stack([np.cos(t), np.sin(t)])
    profile[[0, -1], 0] = 0.0
    ball = lathe(profile, segments)
    return Shape(ball.points * radii_m, ball.quads, ball.triangles)
