"""Percentage-closer soft shadows: right where blockers and receivers are parallel planes, elsewhere as far off as docs/passes.md says."""

import dataclasses

import numpy as np
import pytest

from tests.core.test_closed_form import LIGHT_HEIGHT_M, LIGHT_SIDE_M, OCCLUDER_HEIGHT_M, floor_points, integrated, rendered
from tests.penumbrae import SCENES, still_life, traced_pass
from tests.scenes import (
    area_light,
    box,
    camera_from_above,
    disc,
    floor,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    render_pass,
    render_passes,
    rmse,
    snapshot,
    spot_light,
    sun_light,
    with_opacity,
)
from vir_addon.core.methods.pcss import PercentageCloserSoftShadows
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.scene import LightShape
from vir_addon.core.settings import Method, Resolve, Settings

WIDTH, HEIGHT = 96, 24


def half_plane(height_m, light, camera):
    """x < 0 at a height, over a floor that alone is in the picture"""
    occluder = rectangle("half plane", (-8, -8, height_m), (8, 0, 0), (0, 16, 0))
    return snapshot([floor(), occluder], [light], camera, WIDTH, HEIGHT, visible_to_camera=[True, False])


LIGHT = area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(LIGHT_SIDE_M, LIGHT_SIDE_M))


def test_straight_edge(device):
    width_m = 1.0
    image = rendered(device, rectangle("half plane", (-8, -8, OCCLUDER_HEIGHT_M), (8, 0, 0), (0, 16, 0)), Method.PCSS, width_m)
    x, y = floor_points(width_m)
    truth = integrated(x[::8], y[::8], lambda at_x, _: at_x < 0)
    assert rmse(image[::8], truth) <= 0.004
    assert np.abs(image[::8] - truth).max() <= 0.03
    assert (image[:, :40] == 0).all() and (image[:, -40:] == 1).all()


def test_disc(device):
    """With a core, which is wholly dark."""
    width_m, radius_m = 1.6, 0.25
    image = rendered(device, disc("disc", (0, 0, OCCLUDER_HEIGHT_M), radius_m), Method.PCSS, width_m)
    x, y = floor_points(width_m)
    truth = integrated(x[::4, ::2], y[::4, ::2], lambda at_x, at_y: at_x**2 + at_y**2 < radius_m**2)
    assert rmse(image[::4, ::2], truth) <= 0.005
    assert np.abs(image[::4, ::2] - truth).max() <= 0.03
    assert image[truth.shape[0] * 2, truth.shape[1]] == 0


@pytest.mark.parametrize("height_m", [0.1, 0.4, 1.0, 2.0])
def test_contacts_harden(device, height_m):
    """The penumbra of a straight edge is as wide as the light times the ratio of distances: from the blocker to the receiver, and to the
    light. Its middle half in brightness is half of it: light arrives in proportion to how much of a square is seen, but for the cosines,
    which count its far side less.
    """
    expected_m = LIGHT_SIDE_M * height_m / (LIGHT_HEIGHT_M - height_m)
    width_m = 3 * expected_m
    image = render_pass(half_plane(height_m, LIGHT, camera_from_above((0.0, 0.0), width_m, WIDTH, HEIGHT)), device, method=Method.PCSS)
    row = image[HEIGHT // 2]
    x_m = (np.arange(WIDTH) + 0.5) / WIDTH * width_m
    assert row[0] == 0 and row[-1] == 1 and (np.diff(row) >= -1e-3).all()
    quarter, three_quarters = np.interp([0.25, 0.75], row, x_m)
    assert 2 * (three_quarters - quarter) == pytest.approx(expected_m, rel=0.04)


@pytest.mark.parametrize(
    "light",
    [
        area_light(eye=(0, 0, 4), size_m=(0.9, 0.4), shape=LightShape.ELLIPSE),
        area_light(eye=(1.5, 0, 4), target=(0, 0, 0), size_m=(1.0, 0.5), spread_rad=1.5),
        point_light(eye=(0.5, 0, 4), radius_m=0.4),
        point_light(eye=(0.5, 0, 4), radius_m=0.4, has_soft_falloff=True),
        spot_light(eye=(0.5, 0, 4), radius_m=0.4, cone_rad=0.8, cone_blend=0.5, has_soft_falloff=True),
        sun_light(eye=(1.0, 0, 4), angle_rad=0.3),
    ],
    ids=["ellipse", "slanted rectangle", "sphere", "disc facing the surface", "spot", "sun"],
)
def test_kinds_of_light(device, light):
    """What lies in planes across the light's axis, or nearly, is as by many maps."""
    scene = half_plane(1.0, light, camera_from_above((-0.15, 0.0), 1.6, WIDTH, HEIGHT))
    image = render_pass(scene, device, method=Method.PCSS)
    truth = render_pass(scene, device, method=Method.MVR, view_count=256, map_resolution_px=512)
    assert truth.min() < 0.01 and truth.max() > 0.99
    assert rmse(image, truth) <= 0.01
    assert np.abs(image - truth).max() <= 0.05


def test_lit_surfaces_are_lit(device):
    """Walls of a room around its lamp are in its maps, before one another; only where the room's corners pass through pixels they shadow
    a few."""
    meshes = [box("room", (0, 0, 1.5), (2.0, 2.0, 1.5), inside_out=True)]
    camera = perspective_camera((0.3, -1.8, 1.5), (0.0, 2.0, 0.6), 96, 54, 0.8)
    for light in (area_light(eye=(0, 0, 2.9)), point_light(eye=(0.2, 0, 1.6), radius_m=0.2)):
        image = render_pass(snapshot(meshes, [light], camera, 96, 54), device, method=Method.PCSS)
        assert (image < 0.99).mean() < 1e-3 and image.mean() > 0.999


ERRORS = {"still life": (0.020, 0.006), "foliage": (0.024, 0.012), "room": (0.048, 0.019)}
"""RMSE of pcss and of mvr at 64 views, with room for what changes with the size of the picture"""


@pytest.mark.parametrize("name", ["foliage", *(pytest.param(name, marks=pytest.mark.slow) for name in ("still life", "room"))])
def test_error_against_rays(device, name):
    scene = SCENES[name](64, 36)
    images, positions = [], None
    for method in (Method.PCSS, Method.MVR):
        with prepared_renderer(scene, device, method=method, view_count=64) as renderer:
            positions = device.run(device.read, renderer.eye.buffers[0].positions)
            render_batches(renderer)
            images.append(renderer.read_passes()["VIR Shadow Key"])
    truth = traced_pass(scene, positions, 100)
    pcss, mvr = (truth.errors(image)["all"] for image in images)
    assert pcss <= ERRORS[name][0]
    assert mvr <= ERRORS[name][1]
    assert truth.errors(images[0])["lit"] <= 0.01


def test_maps_hold_what_is_searched(device):
    """A picture of a part shows what the whole shows there: what casts into it may lie outside of it as seen from the light's centre."""
    for light in (LIGHT, point_light(eye=(0, 0, 4)), sun_light(eye=(0, 0, 4), angle_rad=0.25)):
        whole = render_pass(half_plane(1.0, light, camera_from_above((0.0, 0.0), 0.6, WIDTH, HEIGHT)), device, method=Method.PCSS)
        for third in (0, 2):
            centre = ((third - 1) * 0.6 / 3, 0.0)
            part = render_pass(half_plane(1.0, light, camera_from_above(centre, 0.6 / 3, WIDTH, HEIGHT)), device, method=Method.PCSS)
            seen = whole[:, third * WIDTH // 3 : (third + 1) * WIDTH // 3]
            assert np.ptp(part) > 0.01
            # along the edge nothing changes, and three pixels are one of the whole
            assert np.abs(part.reshape(HEIGHT, -1, 3).mean(axis=(0, 2)) - seen.mean(axis=0)).max() <= 0.01


def test_light_without_size_is_hard(device):
    for light in (area_light(eye=(2, -2, 5), size_m=(0, 0)), sun_light(eye=(2, -2, 5), angle_rad=0.0)):
        scene = dataclasses.replace(still_life(64, 36), lights=(light,))
        np.testing.assert_array_equal(*(render_pass(scene, device, method=method) for method in (Method.PCSS, Method.MVR)))


def test_same_bits_and_nothing_settles_wrongly(device):
    scene = still_life(96, 54)
    first = render_pass(scene, device, method=Method.PCSS)
    np.testing.assert_array_equal(first, render_pass(scene, device, method=Method.PCSS))
    assert rmse(first, render_pass(scene, device, method=Method.PCSS, resolve=Resolve.FULL)) <= 1e-3


def test_maps_are_kept_as_long_as_there_is_memory(device, monkeypatch):
    scene = dataclasses.replace(still_life(64, 36), lights=(area_light("A", eye=(2, -2, 5)), point_light("B", eye=(-2, -2, 4))))
    make, makers, passes = PercentageCloserSoftShadows._making, [], []
    monkeypatch.setattr(PercentageCloserSoftShadows, "_making", lambda method: (makers[-1].append(method), make(method))[1])
    for budget in (256, 1):
        makers.append([])
        passes.append(render_passes(scene, device, method=Method.PCSS, replay_buffer_mib=budget))
    kept, dropped = makers
    assert len(kept) == len(set(kept)) > 1
    assert len(dropped) > len(set(dropped)) == len(kept)
    for name, image in passes[0].items():
        np.testing.assert_array_equal(image, passes[1][name])


def test_cut_outs_are_there_in_a_share_of_batches(device):
    """A pane of one opacity hides all of the light in as many of the eight batches, wherever it is hidden."""
    pane = rectangle("pane", (-4, -4, 1.0), (8, 0, 0), (0, 8, 0))
    pane = with_opacity(pane, np.full((2, 2), 0.5), [(0, 0), (1, 0), (1, 1), (0, 1)])
    camera = camera_from_above((0.0, 0.0), 1.0, 32, 18)
    image = render_pass(snapshot([floor(), pane], [LIGHT], camera, 32, 18, visible_to_camera=[True, False]), device, method=Method.PCSS)
    np.testing.assert_allclose(image, 0.5, atol=1e-5)


def test_plan_and_statistics_say_how(device):
    scene = dataclasses.replace(still_life(64, 36), lights=(LIGHT,))
    work = plan(scene, Settings(method=Method.PCSS, view_count=200, blocker_sample_count=64, filter_sample_count=96))
    (line,) = work.passes
    assert (line.view_count, work.batch_count, work.eye_sample_count) == (1, 8, 16)
    assert "one map, 64 + 96 samples of it for every eye sample" in line.reason
    *_, progress = render(scene, work, device)
    (made,) = progress.statistics.passes
    assert (made.method, made.view_count, made.blocker_sample_count, made.filter_sample_count) == ("pcss", 1, 64, 96)


def test_more_samples_come_closer(device):
    """To what the method can do at all, in the first batch's two eye samples."""
    scene = still_life(64, 36)

    def first_batch(search_count, filter_count):
        settings = Settings(method=Method.PCSS, blocker_sample_count=search_count, filter_sample_count=filter_count)
        return next(render(scene, plan(scene, settings), device)).passes["VIR Shadow Key"]

    best = render_pass(scene, device, method=Method.PCSS, blocker_sample_count=128, filter_sample_count=128)
    few, published, more = (rmse(first_batch(*counts), best) for counts in ((2, 4), (32, 64), (64, 96)))
    assert few > 3 * published and published > more
