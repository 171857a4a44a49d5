"""Is a triangle mesh closed? Answered without building an edge table."""

from __future__ import annotations

import functools

import numpy as np

_BLOCK = 1 << 15
"""triangles looked at together: temporaries stay in the cache, which is worth a factor of three"""

_FEW = 1 << 14
"""vertices of meshes for which the random numbers are kept: making them takes as long as the rest"""


def is_closed(triangles: np.ndarray, vertex_count: int) -> bool:
    """Is every directed edge met by its reverse as often as it occurs?

    triangles: (triangle_count, 3) int32. Vertices that coincide without being shared do not close a surface.

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


def _random_numbers(count: int) -> np.ndarray:
    """(count,) uint64"""
    return np.random.default_rng(20220).integers(0, 1 << 64, count, dtype=np.uint64)


@functools.cache
def _few_numbers() -> np.ndarray:
    return _random_numbers(_FEW)
