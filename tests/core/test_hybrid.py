"""Points and rasterized triangles in one map: together they must be what the rasterizer alone makes."""

import numpy as np
import pytest

from tests.core.test_micro_triangles import maps_of_all_faces, scene_named
from tests.scenes import (
    area_light,
    bumpy_sphere,
    check_portions,
    error_against_rasterization,
    floor,
    perspective_camera,
    prepared_renderer,
    render_pass,
    rmse,
    snapshot,
)
from vir_addon.core.errors import UsageError
from vir_addon.core.settings import Method, PointStorage, Settings
from vir_addon.device.interface import EMPTY_DEPTH_BITS

WIDTH, HEIGHT = 240, 135
SCENES = ("sphere", "room", "leaves", "low light", "sun")


def many_sizes_scene():
    """Spheres from triangles of a part of a texel to such of hundreds, beside and before each other."""
    spheres = [
        bumpy_sphere(f"sphere {rows}", (x, y, 0.9), 0.45, rows)
        for rows, x, y in ((200, -0.9, 0.2), (70, -0.3, -0.3), (30, 0.3, 0.25), (8, 0.9, -0.2))
    ]
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    return snapshot([*spheres, floor(4.0)], [area_light(eye=(1.0, -1.5, 5.0))], camera, WIDTH, HEIGHT)


NAMES = ["many sizes", *(pytest.param(name, marks=() if name == "leaves" else pytest.mark.slow) for name in SCENES)]


def scene_of(name):
    return many_sizes_scene() if name == "many sizes" else scene_named(name)


@pytest.mark.parametrize("storage", PointStorage)
@pytest.mark.parametrize("name", NAMES)
def test_no_texel_is_missed(device, name, storage):
    """What the rasterizer covers is covered; most of it at the rasterizer's own depth."""
    scene, selected = scene_of(name), range(0, 4)
    truth, _ = maps_of_all_faces(scene, device, selected, method=Method.MVR)
    hybrid, counts = maps_of_all_faces(scene, device, selected, method=Method.HYBRID, points=storage)
    assert counts["large_triangle_count"] > 10
    assert (counts["point_count"] > 10_000) == (name not in ("room", "leaves"))
    for true_maps, maps in zip(truth, hybrid, strict=True):
        covered = np.isfinite(true_maps)
        missed = (covered & ~np.isfinite(maps)).sum()
        print(f"{name} {storage.value}: {counts}, missed {missed} of {covered.sum()}")
        assert covered.sum() > 1000
        assert missed <= 0.001 * covered.sum()


@pytest.mark.parametrize("name", NAMES)
def test_passes_agree_with_multiview_rasterization(device, name):
    scene = scene_of(name)
    error = error_against_rasterization(scene, device, Method.HYBRID, map_resolution_px=512)
    print(f"{name}: RMSE {error:.5f}")
    assert error <= 0.01


@pytest.mark.parametrize("threshold", [0, 2, 32])
def test_the_threshold_moves_triangles_from_one_side_to_the_other(device, threshold):
    """Without points the maps are the rasterizer's own: nothing is enlarged, and nothing that RESOLVE would have to undo."""
    scene = many_sizes_scene()
    arguments = {"view_count": 64, "map_resolution_px": 512, "stochastic_culling": False}
    with prepared_renderer(scene, device, method=Method.HYBRID, small_triangle_points=threshold, **arguments) as renderer:
        made = renderer.works[0].statistics
    assert (made.point_count == 0) == (threshold == 0) and made.large_triangle_count > 100
    images = [
        render_pass(scene, device, method=method, small_triangle_points=threshold, **arguments) for method in (Method.MVR, Method.HYBRID)
    ]
    assert rmse(*images) <= (1e-6 if threshold == 0 else 0.01)


def test_lowest_bit_tells_points_from_rasterized_triangles(device):
    scene = many_sizes_scene()
    bits = {}
    for threshold in (0, 32):
        arguments = {"method": Method.HYBRID, "small_triangle_points": threshold, "view_count": 8, "map_resolution_px": 512}
        with prepared_renderer(scene, device, **arguments) as renderer:
            ((_, _, method),) = renderer.works[0].faces
            maps = renderer.store.maps(8)
            method.fill(maps, range(8))
            read = device.run(device.read, maps.texture)
            bits[threshold] = read[read != EMPTY_DEPTH_BITS] & 1
    assert len(bits[0]) > 10_000 and not bits[0].any()
    assert 0.2 < bits[32].mean() < 0.9


def test_portions_make_the_same_picture(device):
    check_portions(many_sizes_scene(), device, 2, method=Method.HYBRID)


def test_threshold_out_of_range():
    with pytest.raises(UsageError, match="33"):
        Settings(small_triangle_points=33)
