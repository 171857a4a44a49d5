"""What casts through an opacity map, against closed forms and float64 integrals, on both devices."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scenes import (
    METHODS,
    area_light,
    camera_from_above,
    floor,
    rectangle,
    render_pass,
    rmse,
    snapshot,
    sun_light,
    with_opacity,
)
from vir_addon.core.settings import Method

RASTERIZED = (Method.MVR, Method.MICRO)
CARD_HEIGHT_M, LIGHT_HEIGHT_M = 1.0, 4.0
CARD_SIDE_M = 2.0
WIDTH, HEIGHT, WIDTH_M = 96, 48, 1.6
QUADRATURE = 160
UVS = ((0, 0), (1, 0), (1, 1), (0, 1))
CHECKER = np.indices((8, 8)).sum(axis=0) % 2
"""squares of a quarter metre"""


def card(texels=CHECKER, uvs=UVS, height_m=CARD_HEIGHT_M, side_m=CARD_SIDE_M, **fields):
    plain = rectangle("card", (-side_m / 2, -side_m / 2, height_m), (side_m, 0, 0), (0, side_m, 0))
    return with_opacity(plain, texels, uvs, **fields)


def seen_from_above(occluders, light, width_px=WIDTH, height_px=HEIGHT, width_m=WIDTH_M):
    camera = camera_from_above((0.0, 0.0), width_m, width_px, height_px)
    visible = [True] + [False] * len(occluders)
    return snapshot([floor(), *occluders], [light], camera, width_px, height_px, visible_to_camera=visible)


def floor_points():
    x = (np.arange(WIDTH) + 0.5) / WIDTH * WIDTH_M - WIDTH_M / 2
    y = (np.arange(HEIGHT) + 0.5) / WIDTH * WIDTH_M - WIDTH_M / 2 * HEIGHT / WIDTH
    return np.meshgrid(x, y)


def checker_hides(x, y):
    """At places of the card's plane."""
    column, row = (np.floor((a / CARD_SIDE_M + 0.5) * 8).astype(int) for a in (x, y))
    inside = (column >= 0) & (column < 8) & (row >= 0) & (row < 8)
    return inside & ((column + row) % 2 == 1)


def lit_by_square(x, y, side_m):
    """float64, both cosines are height over distance"""
    u, v = np.meshgrid(*[(np.arange(QUADRATURE) + 0.5) / QUADRATURE * side_m - side_m / 2] * 2, indexing="ij")
    share = CARD_HEIGHT_M / LIGHT_HEIGHT_M
    weight = 1 / ((u - x) ** 2 + (v - y) ** 2 + LIGHT_HEIGHT_M**2) ** 2
    return (weight * ~checker_hides(x + (u - x) * share, y + (v - y) * share)).sum() / weight.sum()


def lit_by_sun(x, y, angle_rad):
    """Rays uniform in solid angle, each worth its cosine to the floor: uniform over the disc of their sines."""
    u, v = np.meshgrid(*[(np.arange(QUADRATURE) + 0.5) / QUADRATURE * 2 - 1] * 2, indexing="ij")
    disc = u**2 + v**2 < 1
    sines = np.stack([u[disc], v[disc]]) * np.sin(angle_rad / 2)
    tangents = CARD_HEIGHT_M * sines / np.sqrt(1 - (sines**2).sum(axis=0))
    return 1 - checker_hides(x + tangents[0], y + tangents[1]).mean()


LIGHTS = {
    "area": (area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(0.6, 0.6)), lambda x, y: lit_by_square(x, y, 0.6)),
    "sun": (sun_light(angle_rad=0.15), lambda x, y: lit_by_sun(x, y, 0.15)),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", LIGHTS)
def test_checkered_card(device, method, name):
    light, lit = LIGHTS[name]
    image = render_pass(seen_from_above([card(is_interpolated=False)], light), device, method=method, view_count=64, map_resolution_px=512)
    x, y = (a[::4, ::2] for a in floor_points())
    truth = np.array([lit(*at) for at in zip(x.ravel(), y.ravel(), strict=True)]).reshape(x.shape)
    assert truth.min() < 0.1 and truth.max() > 0.9
    print(name, method, rmse(image[::4, ::2], truth), np.abs(image[::4, ::2] - truth).max())
    assert rmse(image[::4, ::2], truth) <= 0.01
    assert np.abs(image[::4, ::2] - truth).max() <= 0.04
