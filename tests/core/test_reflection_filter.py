"""Filtering by the gradient of normals around one eye sample, as published, with as many samples in every pixel or as few as it takes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.core.test_reflections import colored_box, mirrored_colors
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    snapshot,
)
from vir_addon.core.errors import UsageError
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.plan import plan
from vir_addon.core.sampling import pixel_offsets, poisson_offsets
from vir_addon.core.scene import FilterShape, PixelFilter
from vir_addon.core.settings import ADAPTIVE_STEP, POISSON_SAMPLES, RECURSIVE_SAMPLES, Effect, ReflectionFilter, Settings

WIDTH, HEIGHT = 96, 54
WHOLE_PIXELS = PixelFilter(FilterShape.BOX, 1.0)
HALF_M, RADIUS_M = 3.0, 0.8
CAMERA = ((0.3, -2.6, 0.4), (0, 0, 0))
FINE = 8


def ball_in_a_box():
    quads, materials = colored_box(HALF_M)
    ball = bumpy_sphere("ball", (0, 0, 0), RADIUS_M, 48, bump_share=0.0)
    camera = perspective_camera(*CAMERA, WIDTH, HEIGHT, 0.4)
    return snapshot([*quads, ball], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror()], world=World(), pixel_filter=WHOLE_PIXELS)


def ball_truth():
    """Means over pixels, and the pixels that show nothing but the ball."""
    camera = perspective_camera(*CAMERA, FINE * WIDTH, FINE * HEIGHT, 0.4)
    colors, _, distance = mirrored_colors(camera, FINE * WIDTH, FINE * HEIGHT, RADIUS_M, HALF_M)
    blocks = HEIGHT, FINE, WIDTH, FINE
    return colors.reshape(*blocks, 3).mean(axis=(1, 3)), (distance.reshape(blocks) < 0.95 * RADIUS_M).all(axis=(1, 3))


def rendered(scene, device, kind, sample_count, **settings):
    """What is shown, rays of a pixel, and the renderer, closed."""
    chosen = {"effects": (Effect.REFLECTION,), "bounces": 1, "view_count": 1, **settings}
    with prepared_renderer(scene, device, reflection_filter=kind, reflection_sample_count=sample_count, **chosen) as renderer:
        render_batches(renderer)
        passes = renderer.read_passes()
        device.run(renderer.update_errors)
        image = passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME]
        return image, renderer.statistics.reflections.rays_per_pixel, renderer


def rms(error, shown):
    return float(np.sqrt((error[shown] ** 2).mean()))


@pytest.mark.parametrize("count", [4, 9, 25])
def test_a_poisson_pattern_keeps_its_points_apart(count):
    """However many of them are taken; a sequence of low discrepancy brings some nearer to each other."""

    def least_apart(points):
        apart = np.abs(points[:, None] - points)
        distances = np.sqrt((np.minimum(apart, 1 - apart) ** 2).sum(axis=-1))
        return distances[~np.eye(len(points), dtype=bool)].min()

    points = poisson_offsets(WHOLE_PIXELS, POISSON_SAMPLES)
    assert points.shape == (POISSON_SAMPLES, 2) and (np.abs(points) <= 0.5).all()
    # farther than half of what is possible
    assert least_apart(points[:count]) > 0.5 * np.sqrt(2 / np.sqrt(3) / count)
    if count > 4:
        assert least_apart(points[:count]) > least_apart(pixel_offsets(WHOLE_PIXELS, count))


def test_samples_by_the_gradient_of_normals_filter_what_a_ball_shows(device):
    scene, (truth, shown) = ball_in_a_box(), ball_truth()
    image, ray_count, renderer = rendered(scene, device, ReflectionFilter.POISSON, POISSON_SAMPLES)
    single, *_ = rendered(scene, device, ReflectionFilter.EYE, 1)
    apart, *_ = rendered(scene, device, ReflectionFilter.EYE, 32)
    # all of one eye sample, and no more of them than asked for
    assert ray_count == POISSON_SAMPLES and renderer.statistics.eye_sample_count == 1
    error = rms(image - truth, shown)
    assert error < 0.3 * rms(single - truth, shown)
    # nearly as well as by rays that have eye samples of their own
    assert error < 1.5 * rms(apart - truth, shown)


def test_what_a_flat_mirror_shows_is_filtered_too(device):
    """Its normal has no gradient: the place moves as well."""
    glass = rectangle("glass", (-2, 1, -1), (4, 0, 0), (0, 0, 4))
    stripes = [rectangle(f"stripe {k}", (0.2 * k - 3.0, -4, 0), (0.1, 0, 0), (0, 0, 3)) for k in range(30)]
    camera = perspective_camera((0.0, -3.0, 1.0), (0.0, 1.0, 1.0), WIDTH, HEIGHT, 0.3)
    materials = [mirror(), *[matte((0, 0, 0), (1, 1, 1))] * len(stripes)]
    scene = snapshot([glass, *stripes], [], camera, WIDTH, HEIGHT, materials=materials, world=World(), pixel_filter=WHOLE_PIXELS)
    truth, *_ = rendered(scene, device, ReflectionFilter.EYE, 64)
    shown = np.ones((HEIGHT, WIDTH), bool)
    filtered, *_ = rendered(scene, device, ReflectionFilter.POISSON, POISSON_SAMPLES)
    single, *_ = rendered(scene, device, ReflectionFilter.EYE, 1)
    assert rms(filtered - truth, shown) < 0.35 * rms(single - truth, shown)


def test_pixels_have_no_more_samples_than_lessen_their_variance(device):
    scene, (truth, shown) = ball_in_a_box(), ball_truth()
    image, ray_count, renderer = rendered(scene, device, ReflectionFilter.ADAPTIVE, POISSON_SAMPLES)
    few, *_ = rendered(scene, device, ReflectionFilter.POISSON, ADAPTIVE_STEP)
    as_many, *_ = rendered(scene, device, ReflectionFilter.POISSON, POISSON_SAMPLES)
    assert ADAPTIVE_STEP < ray_count < 0.6 * POISSON_SAMPLES
    assert rms(as_many - truth, shown) < rms(image - truth, shown) < rms(few - truth, shown)
    # within a wall's image all samples are equal: the first four tell
    even = np.ones_like(shown)
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            even &= (np.roll(truth, step, axis) == truth).all(axis=-1)
    np.testing.assert_allclose(image[shown & even], truth[shown & even], atol=1e-4)
    # what settled after a few rays is no surer for the rounds after that
    _, _, all_of_them = rendered(scene, device, ReflectionFilter.POISSON, 28)
    assert renderer.statistics.reflections.error_estimate > 1.1 * all_of_them.statistics.reflections.error_estimate


def test_pixels_settle_no_sooner_than_lamps_have_shown_some_of_their_views(device):
    """Which the rays of a batch share: the more batches, the fewer views a batch has, and the sooner by chance rays agree."""
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 0.6), 0.5, 32, bump_share=0.0), box("post", (0.9, -0.7, 0.4), (0.15, 0.15, 0.4))]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.5), WIDTH, HEIGHT, 0.3)
    materials = [matte((0.8, 0.8, 0.8)), mirror(), matte((0.2, 0.3, 0.6))]
    lamp = area_light(eye=(1.5, -2, 2.5), target=(0, 0, 0), size_m=(2.0, 2.0))
    scene = snapshot(meshes, [lamp], camera, WIDTH, HEIGHT, materials=materials, world=World(), pixel_filter=WHOLE_PIXELS)
    truth, *_ = rendered(scene, device, ReflectionFilter.POISSON, 64, view_count=256)
    shown = truth.sum(axis=-1) > 0
    errors, rays = {}, {}
    for count in (25, 64):
        image, rays[count], renderer = rendered(scene, device, ReflectionFilter.ADAPTIVE, count, view_count=16)
        errors[count] = rms(np.clip(image, 0, 1) - np.clip(truth, 0, 1), shown)
    assert renderer.reflections.least_rounds == 16 < rays[64] < 40
    # what has one view has shown it after a batch
    bulb = dataclasses.replace(scene, lights=(point_light(eye=(1.5, -2, 2.5), radius_m=0.0),))
    _, few, _ = rendered(bulb, device, ReflectionFilter.ADAPTIVE, 64, view_count=16)
    assert few < 14
    assert shown.sum() > 300 and errors[64] < 0.9 * errors[25]


@pytest.mark.parametrize("kind", [ReflectionFilter.POISSON, ReflectionFilter.ADAPTIVE])
def test_a_few_of_the_rays_go_on_and_count_for_all(device, kind):
    """Two parallel mirrors with wide stripes beyond: within stripes' images every ray finds the same."""
    left, right = rectangle("left", (-1, -1, -1), (0, 8, 0), (0, 0, 3)), rectangle("right", (1, -1, -1), (0, 8, 0), (0, 0, 3))
    quads, materials = colored_box(9.0)
    camera = perspective_camera((0.0, -2.5, 0.3), (0.5, 1.0, 0.4), WIDTH, HEIGHT, 0.5)
    scene = snapshot(
        [*quads, left, right],
        [],
        camera,
        WIDTH,
        HEIGHT,
        materials=[*materials, mirror(), mirror()],
        world=World(),
        pixel_filter=WHOLE_PIXELS,
    )
    expected, *_ = rendered(scene, device, ReflectionFilter.EYE, 32, bounces=3)
    image, ray_count, renderer = rendered(scene, device, kind, POISSON_SAMPLES, bounces=3)
    work = renderer.reflections
    if kind is ReflectionFilter.POISSON:
        assert (work.recursive_rounds.sum(), len(work.recursive_rounds)) == (RECURSIVE_SAMPLES, POISSON_SAMPLES)
    else:
        assert ray_count < POISSON_SAMPLES
    fewer, *_ = rendered(scene, device, kind, POISSON_SAMPLES, bounces=1)
    # nor are there edges of mirrors, where some rays go on and others end
    even = np.ones((HEIGHT, WIDTH), bool)
    for picture in (expected, fewer, rendered(scene, device, ReflectionFilter.EYE, 16, bounces=2)[0]):
        for axis in (0, 1):
            for step in (-2, -1, 1, 2):
                even &= np.isclose(np.roll(picture, step, axis), picture, atol=1e-3).all(axis=-1)
    goes_on = even & ~np.isclose(fewer, expected, atol=0.05).all(axis=-1)
    assert goes_on.sum() > 50
    np.testing.assert_allclose(image[even], expected[even], atol=2e-3)


def test_lights_and_shadows_beside_it_are_what_they_are_without(device):
    """Where shadows have eye samples of their own, rays are from the pixel's places all the same."""
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0.3, 0.5), 0.5, 24, bump_share=0.0)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.4), WIDTH, HEIGHT, 0.4)
    lights = [point_light(eye=(1, -2, 3), radius_m=0.0, strength=100.0)]
    scene = snapshot(meshes, lights, camera, WIDTH, HEIGHT, materials=[matte(), mirror()], world=World(), pixel_filter=WHOLE_PIXELS)
    both = (Effect.SHADOW, Effect.REFLECTION)
    expected, *_ = rendered(scene, device, ReflectionFilter.EYE, 64)
    image, _, renderer = rendered(scene, device, ReflectionFilter.POISSON, POISSON_SAMPLES, effects=both)
    alone, *_ = rendered(scene, device, ReflectionFilter.POISSON, POISSON_SAMPLES)
    assert renderer.statistics.eye_sample_count > 1
    ball = np.linalg.norm(alone, axis=-1) > 0
    inner = ball & np.roll(ball, 2, 0) & np.roll(ball, -2, 0) & np.roll(ball, 2, 1) & np.roll(ball, -2, 1)
    assert inner.sum() > 100
    assert rms(image - expected, inner) < 1.5 * rms(alone - expected, inner) + 0.005


def test_passes_per_reflector_say_that_they_cannot_adapt():
    with pytest.raises(UsageError, match="choose another filter than adaptive"):
        Settings(effects=(Effect.REFLECTION,), per_reflector=True, reflection_filter=ReflectionFilter.ADAPTIVE)


@pytest.mark.parametrize(("sample_count", "batches"), [(25, (5, 5)), (5, (1, 5)), (24, (6, 4)), (7, (2, 4))])
def test_as_many_samples_as_asked_for_where_batches_share_them_evenly(sample_count, batches):
    chosen = plan(
        ball_in_a_box(),
        Settings(effects=(Effect.REFLECTION,), reflection_filter=ReflectionFilter.POISSON, reflection_sample_count=sample_count),
    )
    assert (chosen.batch_count, chosen.eye_samples_per_batch) == batches
