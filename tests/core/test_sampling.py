"""Points on lights and in pixels: stratified in every prefix, areas kept, distributed as the filter."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad

from tests.scenes import area_light, point_light
from vir_addon.core.sampling import (
    Cone,
    light_samples,
    pixel_offsets,
    sample_weights,
    square_to_disk,
    stable_seed,
    unit_square_points,
)
from vir_addon.core.scene import FilterShape, LightShape, PixelFilter

SEEDS = st.integers(0, 0x3FFFFFFF)


@given(seed=SEEDS, log_run=st.integers(0, 8), run=st.integers(0, 5))
def test_aligned_runs_are_stratified(seed, log_run, run):
    """The defining property of a (0, 2)-sequence: one point in every elementary box of area 2^-k."""
    count = 1 << log_run
    points = unit_square_points((run + 1) * count, seed)[run * count :]
    for log_columns in range(log_run + 1):
        boxes = (points * [1 << log_columns, 1 << (log_run - log_columns)]).astype(np.int64)
        assert len(np.unique(boxes, axis=0)) == count, f"{1 << log_columns} columns"


def star_discrepancy(points: np.ndarray) -> float:
    """The largest difference between a box's area and its share of the points, over boxes with a corner at 0."""
    count = len(points)
    x, y = (np.append(np.unique(axis), 1.0) for axis in points.T)
    worst = 0.0
    for compare in (np.less, np.less_equal):  # a corner moves past a point
        inside = compare(points[:, 0], x[:, None]).astype(float) @ compare(points[:, 1], y[:, None]).astype(float).T
        worst = max(worst, float(np.abs(inside / count - x[:, None] * y).max()))
    return worst


@given(seed=SEEDS, count=st.integers(1, 200))
def test_every_prefix_covers_the_square_evenly(seed, count):
    """A prefix of n points is one net of 2^m points for every binary digit of n. A box with a corner at 0 is m + 1 strips (widths 2^-1
    to 2^-m, and what is left), in each of which a net errs by less than a point: n D* <= sum of (m + 1)."""
    bound = sum(digit + 1 for digit in range(count.bit_length()) if count >> digit & 1)
    assert count * star_discrepancy(unit_square_points(count, seed)) <= bound


def test_each_point_is_uniform_over_names():
    """Scrambled as if at random: a light's name does not prefer any part of it. Pearson's test at five standard deviations."""
    points = np.stack([unit_square_points(4, stable_seed(f"Light {number}")) for number in range(1024)])
    for index in range(4):
        cells = (points[:, index] * 8).astype(np.int64)
        counts = np.bincount(cells[:, 0] * 8 + cells[:, 1], minlength=64)
        assert ((counts - 16) ** 2 / 16).sum() < 63 + 5 * np.sqrt(2 * 63), index


@given(st.floats(0.001, 0.999), st.floats(0.001, 0.999))
def test_disk_map_keeps_areas(x, y):
    """A square of area 1 becomes a disk of area pi; by differences, but on the diagonals, where the map has a kink."""
    step = 1e-5
    assume(min(abs(x - y), abs(x + y - 1)) > 4 * step)
    right, left, upper, lower = square_to_disk(np.array([[x + step, y], [x - step, y], [x, y + step], [x, y - step]]))
    jacobian = np.stack([right - left, upper - lower]) / (2 * step)
    assert abs(np.linalg.det(jacobian)) == pytest.approx(np.pi, rel=1e-6)
    assert np.linalg.norm(square_to_disk(np.array([[x, y]]))) < 1


def test_disk_map_covers_the_disk_once():
    """Cells of a fine grid fall into rings and sectors of one area equally often, up to what a ring's rim cuts."""
    grid = (np.stack(np.meshgrid(np.arange(400), np.arange(400)), axis=-1).reshape(-1, 2) + 0.5) / 400
    x, y = square_to_disk(grid).T
    ring = (np.hypot(x, y) ** 2 * 10).astype(np.int64)
    sector = ((np.arctan2(y, x) + np.pi) / (2 * np.pi) * 16).astype(np.int64) % 16
    counts = np.bincount(ring * 16 + sector, minlength=160)
    assert counts.min() > 0.9 * 1000 and counts.max() < 1.1 * 1000


SIDES_M = st.just(0.0) | st.floats(1e-3, 100.0)


@given(shape=st.sampled_from([LightShape.RECTANGLE, LightShape.ELLIPSE]), size=st.tuples(SIDES_M, SIDES_M), name=st.text())
def test_light_samples_lie_on_the_light(shape, size, name):
    light = area_light(name, size_m=size, shape=shape)
    samples = light_samples(light, 64)
    assert (np.abs(samples[:, :2]) <= np.array(size) / 2).all() and (samples[:, 2] == 0).all()
    if shape is LightShape.ELLIPSE and min(size) > 0:
        assert (((samples[:, :2] / (np.array(size) / 2)) ** 2).sum(axis=1) <= 1 + 1e-12).all()
    # more views go on where fewer end, and one view is the centre
    np.testing.assert_array_equal(light_samples(light, 16), samples[:16])
    np.testing.assert_array_equal(light_samples(light, 1), [[0, 0, 0]])


def half_discs(light, cone, directions, count=128):
    """(n,) what of a sphere's light comes from beside a plane through its centre and each of the directions to its receivers, far away."""
    samples = light_samples(light, count, cone)
    cosine = samples @ directions.T / light.radius_m
    weight = sample_weights(light, samples, cone)[:, None] * np.maximum(cosine, 0)
    across = np.cross(directions, np.random.default_rng(3).normal(size=3))
    return (weight * (samples @ across.T > 0)).sum(axis=0) / weight.sum(axis=0)


@pytest.mark.parametrize("axis", [(0, 0, 1), (-1, 0, 0), (0, 1, 0)])
def test_samples_for_few_receivers_say_more(axis):
    """All that anything within the cone sees is there, at its weight: half of the light is half. And with less noise than from samples all
    around, of which half is out of sight."""
    half_rad = np.radians(30)
    rng = np.random.default_rng(5)
    directions = np.array(axis) + np.tan(half_rad) * 0.5 * rng.uniform(-1, 1, (50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    errors = {}
    for cone in (None, Cone(axis, half_rad)):
        lights = (point_light(str(seed), radius_m=0.3) for seed in range(40))
        errors[cone] = np.array([half_discs(light, cone, directions) for light in lights]) - 0.5
        assert abs(errors[cone].mean()) < 0.002
    of_all, of_few = (np.sqrt((error**2).mean()) for error in errors.values())
    assert of_few < 0.7 * of_all
    light = point_light(radius_m=0.3)
    samples = light_samples(light, 1024, Cone(axis, half_rad))
    np.testing.assert_allclose(np.linalg.norm(samples, axis=1), 0.3)
    # of the sphere's mean the far end is missing, which nothing sees
    missing = (1 - np.cos(np.pi / 2 - half_rad)) / 2
    assert sample_weights(light, samples, Cone(axis, half_rad)).mean() == pytest.approx(1 - missing, abs=0.01)


def density(shape: FilterShape, u: float) -> float:
    """Of the filters over u in [-1/2, 1/2] of their width: Cycles' and Blender's definitions, not normalized."""
    if shape is FilterShape.GAUSSIAN:
        return float(np.exp(-8 * u * u))
    if shape is FilterShape.BLACKMAN_HARRIS:
        # Harris 1978, four terms, written around the middle of the window
        return float(0.35875 + sum(a * np.cos(2 * np.pi * k * u) for k, a in ((1, 0.48829), (2, 0.14128), (3, 0.01168))))
    return 1.0


@pytest.mark.parametrize("width_px", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("shape", FilterShape)
def test_offsets_are_distributed_as_the_filter(shape, width_px):
    """Both coordinates of 2^k points have one point in each of 2^k equal shares: their distribution steps along the filter's."""
    count = 256
    offsets = pixel_offsets(PixelFilter(shape, width_px), count)
    assert (np.abs(offsets) <= width_px / 2).all()
    total, _ = quad(lambda u: density(shape, u), -0.5, 0.5)
    for axis in offsets.T:
        place = np.sort(axis) / width_px
        share = np.array([quad(lambda u: density(shape, u), -0.5, u)[0] for u in place]) / total
        number = np.arange(count)
        # 1e-4: the filter is tabulated in 1024 steps
        assert (share >= number / count - 1e-4).all() and (share <= (number + 1) / count + 1e-4).all()
    assert (pixel_offsets(PixelFilter(shape, width_px), 1) == 0).all()


@pytest.mark.parametrize(("view_count", "offset_count"), [(128, 32), (128, 64), (256, 32), (256, 64)])
@pytest.mark.parametrize("name", ["Key", "Fill", "Lamp.001"])
def test_offsets_do_not_follow_the_lights_points(name, view_count, offset_count):
    """A sixteenth of the light is seen from half of a pixel's quarters or more, for each of the four pairs of their coordinates: where an
    edge's shadow moves with both, they stand in for each other."""
    offsets = pixel_offsets(PixelFilter(FilterShape.BOX, 1.0), offset_count) + 0.5
    seen_from = np.repeat(offsets, view_count // offset_count, axis=0)
    points = unit_square_points(view_count, stable_seed(name))
    for place in points.T:
        for offset in seen_from.T:
            boxes = set(zip(np.floor(16 * place), np.floor(4 * offset), strict=True))
            assert len(boxes) >= 0.5 * 16 * 4
