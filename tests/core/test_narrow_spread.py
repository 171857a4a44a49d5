"""Area lights whose spread is so narrow that a receiver lies within that of few of the light's samples, or of none."""

import math

import numpy as np
import pytest

from tests.scenes import METHODS, area_light, camera_from_above, disc, floor, render_pass, snapshot
from vir_addon.core.sampling import light_samples, sample_patch_m

WIDTH = HEIGHT = 96
PICTURE_M = 3.0
LIGHT_M = 1.0
LIGHT_HEIGHT_M = 4.0
DISC_HEIGHT_M, DISC_RADIUS_M = 1.0, 0.25


def disc_under_a_narrow_light(spread_deg):
    light = area_light(eye=(0, 0, LIGHT_HEIGHT_M), target=(0, 0, 0), size_m=(LIGHT_M, LIGHT_M), spread_rad=math.radians(spread_deg))
    camera = camera_from_above((0.0, 0.0, 0.0), PICTURE_M, WIDTH, HEIGHT)
    meshes = [floor(3.0), disc("disc", (0.0, 0.0, DISC_HEIGHT_M), DISC_RADIUS_M)]
    meshes[1].triangles[:] = meshes[1].triangles[:, ::-1].copy()
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("spread_deg", [1, 3, 10])
def test_what_a_narrow_light_reaches_is_lit(device, method, spread_deg):
    image = render_pass(disc_under_a_narrow_light(spread_deg), device, method=method, view_count=64, map_resolution_px=512)
    place_m = ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5) * PICTURE_M
    x, y = np.meshgrid(place_m, place_m)
    from_axis, from_disc = np.maximum(np.abs(x), np.abs(y)), np.hypot(x, y)
    widening_m = LIGHT_HEIGHT_M * math.tan(math.radians(spread_deg) / 2)
    # what counts is straight above but for the spread, or for the way to the nearest sample: where that ray passes the disc's height
    blur_m = max(math.sqrt(2) * LIGHT_M / 8, widening_m) * DISC_HEIGHT_M / LIGHT_HEIGHT_M + 2 * PICTURE_M / WIDTH
    lit = (from_disc > DISC_RADIUS_M + blur_m) & (from_axis < LIGHT_M / 2 - PICTURE_M / WIDTH)
    assert lit.sum() > 200
    np.testing.assert_allclose(image[lit], 1.0, atol=1e-3)
    beyond = from_axis > LIGHT_M / 2 + widening_m + LIGHT_M / 4
    assert beyond.sum() > 200
    assert (image[beyond] == 0).all()


@pytest.mark.parametrize("count", [1, 3, 8, 32, 64, 100])
def test_no_place_of_a_light_is_farther_from_its_samples_than_a_patch(count):
    light = area_light(size_m=(2.0, 0.5))
    samples = light_samples(light, count)[:, :2]
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-0.25, 0.25, 41)), axis=-1).reshape(-1, 1, 2)
    assert np.linalg.norm(grid - samples, axis=-1).min(axis=1).max() <= sample_patch_m(light, count)
