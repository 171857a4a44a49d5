"""Shading of those texels alone that samples of the filter ask for, once each, as densely as the eye's pixels are."""

from __future__ import annotations

import numpy as np
import pytest

from tests.core.test_reflection_filter import ball_in_a_box, rms
from tests.core.test_shaded_maps import rendered
from tests.scenes import bumpy_sphere, floor, matte, mirror, perspective_camera, point_light, rectangle, render_passes, snapshot
from vir_addon.core.errors import UsageError
from vir_addon.core.material import World
from vir_addon.core.plan import plan
from vir_addon.core.scene import FilterShape, PixelFilter
from vir_addon.core.settings import POISSON_SAMPLES, Effect, ReflectionFilter, ReflectionLookUp, Settings

WIDTH, HEIGHT = 96, 54
DIRECTION, LAZY = ReflectionLookUp.DIRECTION, ReflectionLookUp.LAZY
POISSON = {"reflection_filter": ReflectionFilter.POISSON}
ALL_TEXELS = {**POISSON, "points_per_eye_pixel": 4.0}
"""where a pixel shows fewer than some eight texels"""
WHOLE_PIXELS = PixelFilter(FilterShape.BOX, 1.0)


def lit_balls(hidden_by=(), sun_height_m=3.0):
    """A mirror ball and another on a floor, which are lit by a lamp and the world."""
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 0.6), 0.5, 48, bump_share=0.0), bumpy_sphere("other", (1.2, -0.6, 0.4), 0.4, 24)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.5), WIDTH, HEIGHT, 0.3)
    lights = [point_light(eye=(1, -2, sun_height_m), radius_m=0.2, strength=100.0)]
    materials = [matte((0.8, 0.8, 0.8)), mirror(), matte((0.7, 0.3, 0.2), (0.0, 0.1, 0.0)), *[matte()] * len(hidden_by)]
    world = World((0.2, 0.2, 0.3))
    return snapshot([*meshes, *hidden_by], lights, camera, WIDTH, HEIGHT, materials=materials, world=world, pixel_filter=WHOLE_PIXELS)


def test_samples_show_what_rays_by_direction_do(device):
    """In a box whose sides have one colour each, texel by texel: but where a texel holds an edge."""
    scene = ball_in_a_box()
    expected, shown, before = rendered(scene, device, DIRECTION, POISSON_SAMPLES, reflection_cube_px=64, **POISSON)
    image, also_shown, renderer = rendered(scene, device, LAZY, POISSON_SAMPLES, reflection_cube_px=64, **ALL_TEXELS)
    np.testing.assert_array_equal(also_shown, shown)
    found = renderer.statistics.reflections
    assert found.ray_count == POISSON_SAMPLES * before.statistics.reflections.ray_count
    assert renderer.plan.batch_count == 1 and before.plan.batch_count == 5
    error = np.abs(image - expected)[shown].max(axis=-1)
    assert shown.sum() > 500 and np.ptp(expected[shown]) > 0.5
    assert (error < 1e-4).mean() > 0.7 and error.mean() < 0.01


def test_25_samples_filter_what_a_ball_shows(device):
    scene, cube = ball_in_a_box(), {"reflection_cube_px": 96}
    truth, shown, _ = rendered(scene, device, DIRECTION, 256, **cube)
    image, *_ = rendered(scene, device, LAZY, POISSON_SAMPLES, **ALL_TEXELS, **cube)
    single, *_ = rendered(scene, device, DIRECTION, 1, **cube)
    followed, *_ = rendered(scene, device, DIRECTION, POISSON_SAMPLES, **POISSON, **cube)
    assert rms(image - truth, shown) < 0.4 * rms(single - truth, shown)
    assert rms(image - truth, shown) < 1.2 * rms(followed - truth, shown)


def test_a_texel_is_shaded_once_and_only_if_a_sample_needs_it(device):
    scene = lit_balls()
    *_, whole = rendered(scene, device, ReflectionLookUp.SHADED)
    *_, lazy = rendered(scene, device, LAZY, POISSON_SAMPLES, **ALL_TEXELS)
    found, before = lazy.statistics.reflections, whole.statistics.reflections
    assert 0 < found.shaded_count < before.shaded_count < found.ray_count
    assert found.map_bytes < before.map_bytes
    # a wall before half of the ball hides what is needed for that half, and nothing else changes
    wall = rectangle("wall", (0.25, -1.0, 0.0), (1.5, 0, 0), (0, 0, 2.0))
    *_, behind = rendered(lit_balls([wall]), device, LAZY, POISSON_SAMPLES, **ALL_TEXELS)
    assert behind.statistics.reflections.shaded_count < 0.8 * found.shaded_count


def test_as_many_places_are_shaded_as_are_asked_for_of_a_pixel(device):
    """From afar, where a pixel shows hundreds of texels: fewer of them, more error."""
    scene = lit_balls()
    cube = {"reflection_cube_px": 512, "reflection_map_mib": 1024}
    truth, shown, _ = rendered(scene, device, DIRECTION, 128, **cube, view_count=16)
    counts, errors = [], []
    for share in (0.25, 1.0, 4.0):
        image, _, renderer = rendered(scene, device, LAZY, 25, **cube, **POISSON, points_per_eye_pixel=share)
        found = renderer.statistics.reflections
        counts.append(found.shaded_count / (found.ray_count / 25))
        errors.append(rms(image - truth, shown))
    # a part of what pixels show is sky, and blocks are squares whose sides are powers of 2
    assert all(0.3 * share < count < 2.0 * share + 0.5 for share, count in zip((0.25, 1.0, 4.0), counts, strict=True))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.1 * truth[shown].std()


def test_lights_and_shadows_are_on_places_as_on_what_rays_meet(device):
    """In several batches, with views of the lamp of their own."""
    scene = lit_balls()
    views = {"view_count": 64, "reflection_cube_px": 128, "batch_view_count": 16}
    expected, shown, _ = rendered(scene, device, DIRECTION, 64, **views)
    image, _, renderer = rendered(scene, device, LAZY, 50, **views, **ALL_TEXELS)
    assert renderer.plan.batch_count > 1
    error = np.abs(image - expected)[shown]
    assert expected[shown].mean() > 0.1
    assert np.median(error) < 0.02 * expected[shown].mean()
    np.testing.assert_allclose(image[shown].mean(axis=0), expected[shown].mean(axis=0), rtol=0.03)


def test_the_same_picture_in_every_run(device):
    scene = lit_balls()
    image, *_ = rendered(scene, device, LAZY, POISSON_SAMPLES, **POISSON)
    again, *_ = rendered(scene, device, LAZY, POISSON_SAMPLES, **POISSON)
    np.testing.assert_array_equal(again, image)


@pytest.mark.parametrize("look_up", [LAZY, ReflectionLookUp.SHADED])
def test_shadows_beside_it_do_not_change_what_is_shaded(device, look_up):
    """They would have several eye samples a batch; what is shaded is of one."""
    scene, chosen = lit_balls(), {"reflection_look_up": look_up, "bounces": 1, "view_count": 64, "device": device}
    chosen |= {**POISSON, "reflection_sample_count": POISSON_SAMPLES} if look_up is LAZY else {"reflection_sample_count": 4}
    alone = render_passes(scene, effects=(Effect.REFLECTION,), **chosen)["VIR Reflection"]
    beside = render_passes(scene, effects=(Effect.SHADOW, Effect.REFLECTION), **chosen)["VIR Reflection"]
    shown = alone.any(axis=-1)
    assert shown.sum() > 500
    np.testing.assert_allclose(beside[shown].mean(axis=0), alone[shown].mean(axis=0), rtol=0.04)
    assert rms(beside - alone, shown) < 0.1


def test_what_it_is_not_for_is_refused():
    chosen = {"effects": (Effect.REFLECTION,), "reflection_look_up": LAZY}
    for other in (ReflectionFilter.EYE, ReflectionFilter.ADAPTIVE):
        with pytest.raises(UsageError, match="choose the reflection filter poisson"):
            Settings(**chosen, reflection_filter=other)
    with pytest.raises(UsageError, match="lazy cubes show one bounce, not 2"):
        Settings(**chosen, **POISSON, bounces=2)


def test_plans_count_samples_and_places_and_no_batches_for_them():
    scene = lit_balls()
    predicted = {}
    for look_up in (LAZY, DIRECTION, ReflectionLookUp.SHADED):
        chosen = {"effects": (Effect.REFLECTION,), "view_count": 1, "reflection_sample_count": 25, **POISSON, "bounces": 1}
        planned = plan(scene, Settings(reflection_look_up=look_up, **chosen))
        predicted[look_up] = planned.reflections.predicted_ms
        if look_up is LAZY:
            assert (planned.batch_count, planned.eye_samples_per_batch, planned.eye_sample_count) == (1, 1, 1)
            assert all(each.is_cube for each in planned.reflections.maps)
    assert predicted[LAZY] < 0.2 * min(predicted[DIRECTION], predicted[ReflectionLookUp.SHADED])
