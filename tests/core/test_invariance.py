"""The same scene elsewhere or in another unit is the same picture."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import METHODS, area_light, box, bumpy_sphere, floor, perspective_camera, render_passes, scaled, snapshot
from vir_addon.core.scene import PixelFilter
from vir_addon.core.settings import Method

WIDTH, HEIGHT = 120, 68
TOLERANCE = 1 / 255
VIEWS = 16


def still_life():
    meshes = [floor(6.0), box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4), bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 40)]
    lights = [area_light("Key", (2.0, -2.0, 5.0)), area_light("Rim", (-4.0, 3.0, 2.0), (0.0, 0.0, 0.5), (0.5, 0.5), strength=40.0)]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    return snapshot(meshes, lights, camera, WIDTH, HEIGHT, pixel_filter=PixelFilter())


def moved(scene, shift):
    """As extraction leaves it when it takes another origin: transforms carry the shift."""
    placed = scene.instances.world_from_object.copy()
    placed[:, :3, 3] += shift
    camera, lights = scene.camera.world_from_view.copy(), []
    camera[:3, 3] += shift
    for light in scene.lights:
        matrix = light.world_from_light.copy()
        matrix[:3, 3] += shift
        lights.append(dataclasses.replace(light, world_from_light=matrix))
    return dataclasses.replace(
        scene,
        instances=dataclasses.replace(scene.instances, world_from_object=placed),
        camera=dataclasses.replace(scene.camera, world_from_view=camera),
        lights=tuple(lights),
    )


def assert_same_pictures(first, second, method):
    assert list(first) == list(second)
    for name, image in first.items():
        difference = np.abs(image - second[name])
        # a point that lies within rounding (a ten-thousandth of a texel) of a texel's border is drawn on either side of it: of the quarter
        # of a million points here a few are at an outline in some view, and one sample of a pixel there sees it
        assert np.count_nonzero(difference > TOLERANCE) <= (2 if method is Method.IVIR else 0), name
        assert difference.max() <= 1.2 / VIEWS, name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_another_unit_is_the_same_picture(device, method, factor):
    scene = still_life()
    arguments = {"method": method, "view_count": VIEWS, "map_resolution_px": 512, "stochastic_culling": False}
    assert_same_pictures(render_passes(scene, device, **arguments), render_passes(scaled(scene, factor), device, **arguments), method)


@pytest.mark.parametrize("method", METHODS)
def test_another_origin_is_the_same_picture(device, method):
    scene = still_life()
    arguments = {"method": method, "view_count": VIEWS, "map_resolution_px": 512}
    assert_same_pictures(
        render_passes(scene, device, **arguments),
        render_passes(moved(scene, np.array([3.3, -5.1, 2.7])), device, **arguments),
        method,
    )


def test_two_runs_have_the_same_bits(device):
    for method in METHODS:
        first, second = (render_passes(still_life(), device, method=method, view_count=VIEWS, map_resolution_px=512) for _ in range(2))
        for name in first:
            np.testing.assert_array_equal(first[name], second[name])
