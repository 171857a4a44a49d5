"""Where to sample: lights and pixels, in an order whose every prefix is well distributed.

Both use the first two dimensions of the Sobol sequence, a (0, 2)-sequence: every aligned run of 2^k points is stratified in
all elementary boxes of area 2^-k, so each batch covers the light evenly and any number of batches does so better. An Owen scramble
(Laine & Karras 2011 hash, constants of Burley 2020) makes different lights independent without spoiling that.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

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


def _mixed(seed: int, dimension: int) -> int:
    """A scramble's own seed (the finalizer of MurmurHash3). Its lowest bits decide which half and quarter of the square each point
    falls into: seeds that share some would put all lights' points, or both coordinates of one, into the same ones."""
    x = seed + dimension * 0x9E3779B9 & 0xFFFFFFFF
    x = (x ^ x >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    x = (x ^ x >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return x ^ x >> 16


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
    return _scrambled_points(np.arange(count, dtype=np.uint32), seed)


def _scrambled_points(index: np.ndarray, seed: int) -> np.ndarray:
    x = _owen_scramble(_reverse_bits(index), _mixed(seed, 1))
    y = _owen_scramble(_second_sobol_dimension(index), _mixed(seed, 2))
    return (np.stack([x, y], axis=-1).astype(np.float64) + 0.5) / 2.0**32


def shuffled_unit_square_points(count: int, seed: int) -> np.ndarray:
    """(count, 2) float64 in [0, 1): as `unit_square_points`, in an order of the seed's own. Of two that are used side by side, one says
    nothing of the other; without that, the same points of both would lie in the same halves, quarters and so on."""
    index = _owen_scramble(np.arange(count, dtype=np.uint32), _mixed(seed, 3))
    return _scrambled_points(index, seed)


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


@dataclass(frozen=True)
class Cone:
    """Directions from a light's centre."""

    axis: tuple[int, int, int]
    """one of the light's own, towards either end, along `views.light_axes`"""
    half_rad: float


def cone_of(light: Light) -> Cone:
    """Where a point light or spot shines."""
    return Cone((0, 0, 1), light.widest_half_cone_rad)


def light_samples(light: Light, count: int, cone: Cone | None = None) -> np.ndarray:
    """(count, 3) float64 metres from the light's centre along `views.light_axes`: in the plane of an area light, on the sphere of a
    point light or spot. Suns: offsets of the rays' directions a metre along the axis. One sample is the centre.

    cone: of a point light or spot, around all receivers, when that is less than `cone_of` it
    """
    samples_m = np.zeros((count, 3))
    if count == 1:
        return samples_m
    points = unit_square_points(count, stable_seed(light.name))
    if light.shape.is_omni:
        return light.radius_m * _sphere_directions(light, cone or cone_of(light), points)
    if light.shape is LightShape.SUN:
        samples_m[:, :2] = _sun_offsets(light, points)
        return samples_m
    unit = points - 0.5
    if light.shape is LightShape.ELLIPSE:
        cosine, sine = math.cos(light.disc_turn_rad), math.sin(light.disc_turn_rad)
        unit = square_to_disk(points) / 2 @ np.array([[cosine, sine], [-sine, cosine]])
    samples_m[:, :2] = unit * [light.size_x_m, light.size_y_m]
    return samples_m


def sample_patch_m(light: Light, count: int) -> float:
    """Of an area light: no place of it is farther than this from the nearest of `light_samples`, metres. Of a (0, 2)-sequence every cell of
    a grid of at most `count` cells has a point; discs are mapped from the square."""
    cells = 2 ** (max(count, 1).bit_length() - 1 >> 1)
    return math.hypot(light.size_x_m, light.size_y_m) / cells


MAX_SUN_ANGLE_RAD = math.radians(85)
"""Rays at larger angles to a sun's axis run at this one: only suns wider than 170 degrees have them."""


def _sun_offsets(light: Light, points: np.ndarray) -> np.ndarray:
    """(n, 2) in [0, 1)^2 -> (n, 2) tangents of directions, uniform in solid angle over the sun's cone"""
    disk = square_to_disk(points)
    squared = (disk**2).sum(axis=1)
    cosine = 1 - squared * (1 - math.cos(math.atan(light.size_x_m / 2)))
    cosine = np.maximum(cosine, math.cos(MAX_SUN_ANGLE_RAD))
    tangent = np.sqrt(1 - cosine**2) / cosine
    return disk * (tangent / np.sqrt(np.maximum(squared, 1e-30)))[:, None]


SPHERE_TABLE_SIZE = 4096
"""steps of the angle to a spot's axis; the density's integral over one is taken as linear"""


def _sphere_density(light: Light, cone: Cone, polar_rad: np.ndarray) -> np.ndarray:
    """Of samples on the sphere, by the angle to the cone's axis, not normalized: the largest cosine to the sphere's normal under which
    anything within the cone may see a place of it. With a soft falloff both sides of the sphere count (see `lib/delivered.glsl`)."""
    half = cone.half_rad
    if half >= math.pi:
        return np.ones_like(polar_rad)
    density = np.cos(np.minimum(np.maximum(polar_rad - half, 0), np.pi / 2))
    if light.has_soft_falloff:
        density = np.maximum(density, -np.cos(np.maximum(np.minimum(polar_rad + half, np.pi), np.pi / 2)))
    return density


def _sphere_directions(light: Light, cone: Cone, points: np.ndarray) -> np.ndarray:
    """(n, 2) in [0, 1)^2 -> (n, 3) unit vectors along right, up, forward, distributed as `_sphere_density`"""
    polar_rad = np.linspace(0, np.pi, SPHERE_TABLE_SIZE + 1)
    cumulative = _cumulative_sphere_density(light, cone, polar_rad)
    chosen = np.interp(points[:, 0], cumulative / cumulative[-1], polar_rad)
    azimuth = 2 * np.pi * points[:, 1]
    along = int(np.flatnonzero(cone.axis)[0])
    directions = np.empty((len(points), 3))
    directions[:, (along + 1) % 3] = np.sin(chosen) * np.cos(azimuth)
    directions[:, (along + 2) % 3] = np.sin(chosen) * np.sin(azimuth)
    directions[:, along] = cone.axis[along] * np.cos(chosen)
    return directions


def _cumulative_sphere_density(light: Light, cone: Cone, polar_rad: np.ndarray) -> np.ndarray:
    middle = (polar_rad[1:] + polar_rad[:-1]) / 2
    return np.concatenate([[0], np.cumsum(-np.diff(np.cos(polar_rad)) * _sphere_density(light, cone, middle))])


def sample_weights(light: Light, samples_m: np.ndarray, cone: Cone | None = None) -> np.ndarray:
    """(n,) float64 what each of `light_samples` counts, so that means of weighted samples are means over the light's surface."""
    if not light.shape.is_omni or len(samples_m) == 1:
        return np.ones(len(samples_m))
    cone = cone or cone_of(light)
    polar_rad = np.arccos(np.clip(samples_m @ cone.axis / light.radius_m, -1, 1))
    mean = _cumulative_sphere_density(light, cone, np.linspace(0, np.pi, SPHERE_TABLE_SIZE + 1))[-1] / 2
    return mean / np.maximum(_sphere_density(light, cone, polar_rad), 1e-3)


def _filter_density(shape: FilterShape, x: np.ndarray) -> np.ndarray:
    """Of the filter over [-1/2, 1/2] of its width, not normalized."""
    if shape is FilterShape.GAUSSIAN:
        return np.exp(-2 * (2 * x) ** 2)
    if shape is FilterShape.BLACKMAN_HARRIS:
        v = 2 * np.pi * (x + 0.5)
        return 0.35875 - 0.48829 * np.cos(v) + 0.14128 * np.cos(2 * v) - 0.01168 * np.cos(3 * v)
    return np.ones_like(x)


MAX_UNSHUFFLED_OFFSETS = 16
"""so many were measured to be no better shuffled"""


def pixel_offsets(pixel_filter: PixelFilter, count: int) -> np.ndarray:
    """(count, 2) float64 pixels from the pixel's centre, distributed as the filter (so that plain averaging filters). Many come in an order
    of their own: in that of the light's points, each would lie in its pixel as the points that it sees lie in their parts of the light."""
    if count == 1:
        return np.zeros((1, 2))
    points_of = shuffled_unit_square_points if count > MAX_UNSHUFFLED_OFFSETS else unit_square_points
    return _filtered(points_of(count, stable_seed("pixel")), pixel_filter)


def _filtered(points: np.ndarray, pixel_filter: PixelFilter) -> np.ndarray:
    """(n, 2) in [0, 1)^2 -> (n, 2) pixels from the pixel's centre"""
    grid = np.linspace(-0.5, 0.5, 1025)
    density = _filter_density(pixel_filter.shape, 0.5 * (grid[1:] + grid[:-1]))
    cumulative = np.concatenate([[0], np.cumsum(density)])
    return np.interp(points, cumulative / cumulative[-1], grid) * pixel_filter.width_px


POISSON_CANDIDATES = 32
"""of which the farthest from all places so far is taken"""


def poisson_offsets(pixel_filter: PixelFilter, count: int) -> np.ndarray:
    """(count, 2) float64 as of `pixel_offsets`, none near another: every prefix is a Poisson-disc pattern of the filter's square, whose
    sides count as joined (Mitchell 1991, "Spectrally Optimal Sampling for Distribution Ray Tracing")."""
    generator = np.random.default_rng(stable_seed("poisson"))
    points = np.full((count, 2), 0.5)
    for k in range(1, count):
        candidates = generator.random((POISSON_CANDIDATES, 2))
        apart = np.abs(candidates[:, None] - points[:k])
        squared = (np.minimum(apart, 1 - apart) ** 2).sum(axis=-1).min(axis=1)
        points[k] = candidates[squared.argmax()]
    return _filtered(points, pixel_filter)
