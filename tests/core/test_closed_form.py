"""Penumbrae whose visibility is known: integrated over the light in float64, without a light sample in common with the renderer."""

import numpy as np
import pytest

from tests.scenes import METHODS, METHODS_BUT_SLOW_IVIR, area_light, camera_from_above, disc, floor, rectangle, render_pass, rmse, snapshot

LIGHT_HEIGHT_M, LIGHT_SIDE_M = 4.0, 1.0
OCCLUDER_HEIGHT_M = 1.0
WIDTH, HEIGHT = 192, 48
QUADRATURE = 200


def light_grid():
    x = (np.arange(QUADRATURE) + 0.5) / QUADRATURE * LIGHT_SIDE_M - LIGHT_SIDE_M / 2
    return np.meshgrid(x, x, indexing="ij")


def integrated(pixels_x, pixels_y, hidden_at):
    """The pass at points of the floor. hidden_at(x, y): whether the occluder is at that place of its plane."""
    u, v = light_grid()
    share = OCCLUDER_HEIGHT_M / LIGHT_HEIGHT_M
    image = np.empty(pixels_x.shape)
    for at in np.ndindex(pixels_x.shape):
        x, y = pixels_x[at], pixels_y[at]
        # both cosines are height over distance
        weight = 1 / ((u - x) ** 2 + (v - y) ** 2 + LIGHT_HEIGHT_M**2) ** 2
        seen = ~hidden_at(x + (u - x) * share, y + (v - y) * share)
        image[at] = (weight * seen).sum() / weight.sum()
    return image


def floor_points(width_m):
    x = (np.arange(WIDTH) + 0.5) / WIDTH * width_m - width_m / 2
    y = (np.arange(HEIGHT) + 0.5) / WIDTH * width_m - width_m / 2 * HEIGHT / WIDTH
    return np.meshgrid(x, y)


def rendered(device, occluder, method, width_m):
    light = area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(LIGHT_SIDE_M, LIGHT_SIDE_M))
    camera = camera_from_above((0.0, 0.0), width_m, WIDTH, HEIGHT)
    scene = snapshot([floor(), occluder], [light], camera, WIDTH, HEIGHT, visible_to_camera=[True, False])
    return render_pass(scene, device, method=method, view_count=256)


@pytest.mark.parametrize("method", METHODS_BUT_SLOW_IVIR)
def test_straight_edge(device, method):
    """A half plane x < 0."""
    width_m = 1.0  # the penumbra is a third of a metre wide
    image = rendered(device, rectangle("half plane", (-8, -8, OCCLUDER_HEIGHT_M), (8, 0, 0), (0, 16, 0)), method, width_m)
    x, y = floor_points(width_m)
    # the same for every row but for the weight, which turns with y: every eighth row
    truth = integrated(x[::8], y[::8], lambda at_x, _: at_x < 0)
    assert truth.min() < 0.001 and truth.max() > 0.999
    assert rmse(image[::8], truth) <= 0.01
    penumbra = (truth > 0.02) & (truth < 0.98)
    assert penumbra.mean() > 0.25
    assert rmse(image[::8][penumbra], truth[penumbra]) <= 0.01
    assert np.abs(image[::8] - truth).max() <= 0.03


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("radius_m", [0.25, pytest.param(0.06, marks=pytest.mark.slow)])
def test_disc(device, method, radius_m):
    """A core shadow inside a penumbra, and a disc too small for a core."""
    width_m = 1.6
    image = rendered(device, disc("disc", (0, 0, OCCLUDER_HEIGHT_M), radius_m), method, width_m)
    x, y = floor_points(width_m)
    truth = integrated(x[::4, ::2], y[::4, ::2], lambda at_x, at_y: at_x**2 + at_y**2 < radius_m**2)
    assert (truth.min() < 0.001) == (radius_m > 0.2)
    assert truth.max() > 0.999
    assert rmse(image[::4, ::2], truth) <= 0.01
    assert np.abs(image[::4, ::2] - truth).max() <= 0.05
