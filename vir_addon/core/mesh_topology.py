"""Is a triangle mesh closed, do its faces look outwards, what hangs together? Answered without building an edge table."""

from __future__ import annotations

import functools

import numpy as np

_BLOCK = 1 << 15
"""triangles looked at together: temporaries stay in the cache, which is worth a factor of three"""

_FEW = 1 << 14
"""vertices of meshes for which the random numbers are kept: making them takes as long as the rest"""


def has_outside(positions: np.ndarray, triangles: np.ndarray) -> bool:
    """Is the surface closed, with its faces outwards? (vertex_count, 3) float32 and (triangle_count, 3) int32"""
    return is_closed(triangles, len(positions)) and faces_outward(positions, triangles)


def is_closed(triangles: np.ndarray, vertex_count: int) -> bool:
    """Is every directed edge met by its reverse as often as it occurs?

    triangles: (triangle_count, 3) of integers. Vertices that coincide without being shared do not close a surface.

    Every vertex a gets a random 64-bit number r(a); an edge from a to b counts r(a) r(b) (r(a) - r(b)), which is minus what its reverse
    counts, so the sum over a closed mesh is 0 modulo 2^64. Over any other mesh it is a polynomial in the random numbers that is not zero
    everywhere, and is hit by chance about once in 2^40. For one triangle the three terms are (r(a) - r(b)) (r(b) - r(c)) (r(a) - r(c)):
    three look-ups. The numbers are always the same, so the answer is, too.
    """
    if len(triangles) == 0:
        return False
    numbers = _few_numbers() if vertex_count <= _FEW else _random_numbers(vertex_count)
    total = np.zeros((), dtype=np.uint64)
    for start in range(0, len(triangles), _BLOCK):
        corners = np.take(numbers, triangles[start : start + _BLOCK], mode="clip")
        first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
        product = first - second
        product *= second - third
        product *= first - third
        # An array, not a scalar: numpy warns of overflow in scalars, and overflow is meant here.
        np.add(total, product.sum(dtype=np.uint64), out=total)
    return int(total) == 0


def faces_outward(positions: np.ndarray, triangles: np.ndarray) -> bool:
    """Do all parts of a closed mesh enclose a positive volume? Those that are turned inside out do not, nor do walls of cavities.

    positions: (vertex_count, 3) float32; triangles: (triangle_count, 3) int32, not empty. Parts are told apart where their vertices do not
    lie between each other's, as they do not in objects that were joined; others count together.
    """
    lows, highs = np.empty((2, len(triangles)), np.int32)
    six_volumes = np.empty(len(triangles), np.float32)
    # near the mesh, where differences of large products would drown small volumes
    origin = positions[triangles[0, 0]]
    for start in range(0, len(triangles), _BLOCK):
        chosen = slice(start, start + _BLOCK)
        first, second, third = triangles[chosen].T
        lows[chosen] = np.minimum(np.minimum(first, second), third)
        highs[chosen] = np.maximum(np.maximum(first, second), third)
        corners = np.take(positions, triangles[chosen], axis=0, mode="clip") - origin
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = np.ascontiguousarray(corners.reshape(-1, 9).T).reshape(3, 3, -1)
        six_volumes[chosen] = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    # a part's last vertex is one that no triangle reaches beyond from before it
    reached_beyond = np.cumsum(np.bincount(lows, minlength=len(positions)) - np.bincount(highs, minlength=len(positions)))
    last_vertices = np.flatnonzero(reached_beyond == 0)
    part = np.searchsorted(last_vertices, lows) if len(last_vertices) > 1 else np.zeros(len(lows), np.int64)
    volumes = np.bincount(part, weights=six_volumes)
    return bool((volumes[np.bincount(part) > 0] > 0).all())


def welded(positions: np.ndarray) -> np.ndarray:
    """(vertex_count,) int32: for each vertex the number of a place; the same for all that coincide exactly. positions: (vertex_count, 3)
    float32. Places are told apart by 64-bit sums of random multiples of their bits. A fifth of a second for a million."""
    bits = (positions + np.float32(0)).view(np.uint32).astype(np.uint64)  # -0 is 0
    factors = np.random.default_rng(20221).integers(0, 1 << 63, 3, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    sums = bits @ factors
    return np.unique(sums ^ (sums >> np.uint64(29)), return_inverse=True)[1].astype(np.int32)


def parts_of(triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """(triangle_count,) int32: equal for triangles that hang together by their vertices, and only for these. triangles: (triangle_count, 3)
    of integers. Half a second for a million."""
    # Each vertex follows the lowest that it is known to hang together with; those followed are asked for theirs, which halves all ways.
    lowest = np.arange(vertex_count, dtype=np.int32)
    while True:
        of_corners = lowest[triangles]
        of_triangles = of_corners.min(axis=1)
        if (of_corners == of_triangles[:, None]).all():
            return of_triangles
        for followed in of_corners.T:
            np.minimum.at(lowest, followed, of_triangles)
        while not np.array_equal(further := lowest[lowest], lowest):
            lowest = further


def _random_numbers(count: int) -> np.ndarray:
    """(count,) uint64"""
    return np.random.default_rng(20220).integers(0, 1 << 64, count, dtype=np.uint64)


@functools.cache
def _few_numbers() -> np.ndarray:
    return _random_numbers(_FEW)
