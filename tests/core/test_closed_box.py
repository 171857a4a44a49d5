"""No light leaves a closed box, whatever the resolution and wherever its faces look."""

import numpy as np
import pytest

from tests.scenes import METHODS, area_light, box, floor, perspective_camera, rectangle, render_pass, snapshot
from vir_addon.core.settings import PointStorage

WIDTH, HEIGHT = 96, 54


def boxed_light(inside_out, light_turned=False):
    target = (0.4, 0.2, 0.0) if light_turned else (0.0, 0.0, 0.0)
    light = area_light(eye=(0.0, 0.0, 2.0), target=target, size_m=(0.5, 0.3))
    meshes = [
        floor(6.0),
        rectangle("wall", (-6, 4, 0), (12, 0, 0), (0, 0, 6)),
        box("around", (0.05, 0.02, 1.9), (0.6, 0.5, 0.4), inside_out=inside_out, turn_rad=0.2),
    ]
    camera = perspective_camera((0.0, -8.0, 4.0), (0.0, 0.0, 1.5), WIDTH, HEIGHT)
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("resolution_px", [64, 100, 256, *(pytest.param(size, marks=pytest.mark.slow) for size in (1024, 2048))])
def test_outside_is_black(device, method, inside_out, resolution_px):
    scene = boxed_light(inside_out)
    image = render_pass(scene, device, method=method, view_count=16, map_resolution_px=resolution_px)
    assert (image == 0).mean() > 0.5
    # the background is 1 and nothing is in between
    assert set(np.unique(image)) <= {0.0, 1.0}
    rows = np.arange(HEIGHT)
    assert (image[rows < HEIGHT // 3] == 0).all()


@pytest.mark.parametrize("inside_out", [False, True])
def test_outside_is_black_for_a_slanted_light_and_points_as_they_come(device, inside_out):
    scene = boxed_light(inside_out, light_turned=True)
    image = render_pass(scene, device, method=METHODS[1], view_count=16, map_resolution_px=128, points=PointStorage.BUFFERLESS)
    assert set(np.unique(image)) == {0.0, 1.0}
