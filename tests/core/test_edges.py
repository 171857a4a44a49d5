"""Pixels that an edge crosses are the filter's mean of its two sides: closed form for straight edges at any place and angle."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import area_light, camera_from_above, floor, rectangle, render_pass, snapshot
from vir_addon.core.scene import FilterShape, PixelFilter
from vir_addon.core.settings import Method

SIZE_PX, SIZE_M = 40, 1.0
LIGHT_HEIGHT_M, CARD_HEIGHT_M = 4.0, 1.0
EYE_SAMPLES = 16
VIEWS = 8 * EYE_SAMPLES
FILTERS = {
    "box": PixelFilter(FilterShape.BOX, 1.0),
    "gaussian": PixelFilter(FilterShape.GAUSSIAN, 3.0),
    "blackman-harris": PixelFilter(FilterShape.BLACKMAN_HARRIS, 3.0),
    "wide blackman-harris": PixelFilter(FilterShape.BLACKMAN_HARRIS, 6.0),
}


def edge_scene(angle_rad, distance_m, pixel_filter):
    """Seen from above: a lit card over all places p with n . p < distance, the shadow that it casts past its edge, and lit floor. A light
    nearly without size, whose many views bring many eye samples."""
    n, along = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0]), np.array([-np.sin(angle_rad), np.cos(angle_rad), 0.0])
    card = rectangle("card", distance_m * n - along + [0, 0, CARD_HEIGHT_M], 2 * along, -2 * n)
    light = area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(1e-4, 1e-4))
    camera = camera_from_above((0, 0), SIZE_M, SIZE_PX, SIZE_PX)
    return snapshot([floor(), card], [light], camera, SIZE_PX, SIZE_PX, pixel_filter=pixel_filter)


def share_of_filter(pixel_filter, angle_rad, at_px):
    """What share of the filter lies before a line at these distances from its middle. Independent densities, summed on a fine grid."""
    u = (np.arange(400) + 0.5) / 400 - 0.5
    density = {
        FilterShape.BOX: np.ones_like(u),
        FilterShape.GAUSSIAN: np.exp(-8 * u**2),
        FilterShape.BLACKMAN_HARRIS: 0.35875
        + 0.48829 * np.cos(2 * np.pi * u)
        + 0.14128 * np.cos(4 * np.pi * u)
        + 0.01168 * np.cos(6 * np.pi * u),
    }[pixel_filter.shape]
    weight = np.multiply.outer(density, density).ravel()
    place = (np.add.outer(u * np.cos(angle_rad), u * np.sin(angle_rad)) * pixel_filter.width_px).ravel()
    order = np.argsort(place)
    return np.interp(at_px, place[order], np.cumsum(weight[order]) / weight.sum())


def expected(angle_rad, distance_m, pixel_filter):
    """The pass, the shares of pixels before the card's edge and before its shadow's, and how far the nearer of them is, in pixels."""
    x = ((np.arange(SIZE_PX) + 0.5) / SIZE_PX - 0.5) * SIZE_M
    along = np.cos(angle_rad) * x[None, :] + np.sin(angle_rad) * x[:, None]
    shadow_m = distance_m * LIGHT_HEIGHT_M / (LIGHT_HEIGHT_M - CARD_HEIGHT_M)
    edges_px = [(edge_m - along) * SIZE_PX / SIZE_M for edge_m in (distance_m, shadow_m)]
    card, shadow = (share_of_filter(pixel_filter, angle_rad, edge_px) for edge_px in edges_px)
    squared = x[None, :] ** 2 + x[:, None] ** 2
    on_card, on_floor = (h**2 / (squared + h**2) ** 2 for h in (LIGHT_HEIGHT_M - CARD_HEIGHT_M, LIGHT_HEIGHT_M))
    lit = card * on_card + (1 - shadow) * on_floor
    return lit / (card * on_card + (1 - card) * on_floor), card, shadow, np.abs(edges_px).min(axis=0)


def rms(values):
    return float(np.sqrt((values**2).mean()))


def assert_filtered(device, method, angle_rad, distance_m, pixel_filter):
    """Within a quarter everywhere, no worse than as many independent samples of the filter where the edge passes pixels at many places,
    and exact away from it. An eye sample may be moved by a sixth of a pixel, and maps have texels: a twentieth of a pixel here."""
    image = render_pass(edge_scene(angle_rad, distance_m, pixel_filter), device, method=method, view_count=VIEWS, map_resolution_px=512)
    truth, card, shadow, nearest_px = expected(angle_rad, distance_m, pixel_filter)
    reach_px = pixel_filter.width_px / 2 * (abs(np.cos(angle_rad)) + abs(np.sin(angle_rad)))
    away = nearest_px > reach_px + 0.3
    assert away.any() and np.abs(image - truth)[away].max() < 2e-3
    assert np.abs(image - truth).max() < 0.25
    if abs(np.sin(4 * angle_rad)) > 0.3:
        near = nearest_px < reach_px
        independent = np.sqrt(((card * (1 - card) + shadow * (1 - shadow))[near] / EYE_SAMPLES).mean())
        assert rms((image - truth)[near]) < independent


@settings(max_examples=12)
@given(angle_rad=st.floats(0, 2 * np.pi), distance_m=st.floats(0.05, 0.3), name=st.sampled_from(sorted(FILTERS)))
def test_edges_are_filtered(device, angle_rad, distance_m, name):
    assert_filtered(device, Method.MVR, angle_rad, distance_m, FILTERS[name])


@pytest.mark.parametrize("name", FILTERS)
def test_edges_of_points_are_filtered(device, name):
    assert_filtered(device, Method.IVIR, 0.4, 0.23, FILTERS[name])


@pytest.mark.parametrize("angle_rad", [0.3, 4.0])
@pytest.mark.parametrize("name", FILTERS)
def test_edges_are_as_wide_as_the_filter(device, name, angle_rad):
    """Edges of pixels at many places within them, taken together, are neither sharper nor softer nor elsewhere."""
    pixel_filter, distance_m = FILTERS[name], 0.2
    image = render_pass(edge_scene(angle_rad, distance_m, pixel_filter), device, method=Method.MVR, view_count=VIEWS, map_resolution_px=512)
    errors = {
        factor: image - expected(angle_rad, distance_m, dataclasses.replace(pixel_filter, width_px=factor * pixel_filter.width_px))[0]
        for factor in (0.67, 1.0, 1.5)
    }
    assert rms(errors[1.0]) < 0.9 * min(rms(errors[0.67]), rms(errors[1.5]))
    (_, card, shadow, _) = expected(angle_rad, distance_m, pixel_filter)
    crossed = (card * (1 - card) + shadow * (1 - shadow)) > 1e-3
    assert abs(errors[1.0][crossed].mean()) < 0.01
