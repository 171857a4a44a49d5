"""Where to sample: lights and pixels, in an order whose every prefix is well distributed.

Both use the first two dimensions of the Sobol sequence, a (0, 2)-sequence: every aligned run of 2^k points is stratified in
all elementary boxes of area 2^-k, so each batch covers the light evenly and any number of batches does so better. An Owen scramble
(Laine & Karras 2011 hash, constants of Burley 2020) makes different lights independent without spoiling that.
"""

from __future__ import annotations

import zlib

import numpy as np

from .scene import FilterShape, Light, LightShape, PixelFilter


def _reverse_bits(x: np.ndarray) -> np.ndarray:
    x = np.asarray(x, np.uint32)
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> np.uint32(shift)) & np.uint32(mask)) | ((x & np.uint32(mask)) << np.uint32(shift))
    return (x >> np.uint32(16)) | (x << np.uint32(16))


def _owen_scramble(x: np.ndarray, seed: int) -> np.ndarray:
    """Nested uniform scramble of bit-reversed-and-back numbers (Burley 2020, "Practical Hash-based Owen Scrambling")."""
    with np.errstate(over="ignore"):
        x = _reverse_bits(x)
        x = x + np.uint32(seed)
        for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
            x = x ^ (x * np.uint32(factor))
        return _reverse_bits(x)


def _second_sobol_dimension(index: np.ndarray) -> np.ndarray:
    result = np.zeros_like(index)
    direction = np.uint32(1 << 31)
    remaining = index.copy()
    while remaining.any():
        result = result ^ np.where(remaining & np.uint32(1), direction, np.uint32(0))
        remaining = remaining >> np.uint32(1)
        direction = direction ^ (direction >> np.uint32(1))
    return result


def unit_square_points(count: int, seed: int) -> np.ndarray:
    """(count, 2) float64 in [0, 1): the first `count` points of a scrambled (0, 2)-sequence."""
    index = np.arange(count, dtype=np.uint32)
    x = _owen_scramble(_reverse_bits(index), seed * 2 + 1 & 0xFFFFFFFF)
    y = _owen_scramble(_second_sobol_dimension(index), seed * 2 + 0x9E3779B9 & 0xFFFFFFFF)
    return (np.stack([x, y], axis=-1).astype(np.float64) + 0.5) / 2.0**32


def stable_seed(name: str) -> int:
    """The same name gives the same samples in every run and whatever else is in the scene."""
    return zlib.crc32(name.encode()) & 0x3FFFFFFF


def square_to_disk(points: np.ndarray) -> np.ndarray:
    """(n, 2) in [0, 1)^2 -> (n, 2) in the unit disk, areas kept (Shirley & Chiu 1997, concentric map)."""
    p = 2 * points - 1
    x, y = p[:, 0], p[:, 1]
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(wide, np.pi / 4 * np.where(x != 0, y / x, 0), np.pi / 2 - np.pi / 4 * np.where(y != 0, x / y, 0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def area_light_samples(light: Light, count: int) -> np.ndarray:
    """(count, 2) float64 metres from the light's centre along its x and y. One sample is the centre."""
    if count == 1:
        return np.zeros((1, 2))
    points = unit_square_points(count, stable_seed(light.name))
    unit = square_to_disk(points) / 2 if light.shape is LightShape.ELLIPSE else points - 0.5
    return unit * [light.size_x_m, light.size_y_m]


def _filter_density(shape: FilterShape, x: np.ndarray) -> np.ndarray:
    """Of the filter over [-1/2, 1/2] of its width, not normalized."""
    if shape is FilterShape.GAUSSIAN:
        return np.exp(-2 * (2 * x) ** 2)
    if shape is FilterShape.BLACKMAN_HARRIS:
        v = 2 * np.pi * (x + 0.5)
        return 0.35875 - 0.48829 * np.cos(v) + 0.14128 * np.cos(2 * v) - 0.01168 * np.cos(3 * v)
    return np.ones_like(x)


def pixel_offsets(pixel_filter: PixelFilter, count: int) -> np.ndarray:
    """(count, 2) float64 pixels from the pixel's centre, distributed as the filter (so that plain averaging filters)."""
    if count == 1:
        return np.zeros((1, 2))
    points = unit_square_points(count, stable_seed("pixel"))
    grid = np.linspace(-0.5, 0.5, 1025)
    density = _filter_density(pixel_filter.shape, 0.5 * (grid[1:] + grid[:-1]))
    cumulative = np.concatenate([[0], np.cumsum(density)])
    return np.interp(points, cumulative / cumulative[-1], grid) * pixel_filter.width_px
