"""Leaving out pixels that are known to be wholly lit or dark: what it changes, and that it is done."""

import numpy as np
import pytest

from tests.core.test_micro_triangles import scene_named
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    perspective_camera,
    point_light,
    prepared_renderer,
    render_batches,
    render_passes,
    rmse,
    snapshot,
    spot_light,
)
from vir_addon.core.passes.accumulate import STATE_BACKGROUND, STATE_DARK, STATE_LIT, pass_image
from vir_addon.core.passes.tiles import PROBE_COUNT, PROBE_STEP_PX, probe_px
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.scene import PixelFilter
from vir_addon.core.settings import Hardware, Method, Resolve, Settings
from vir_addon.device.owned import Owned


def both(scene, device, **settings):
    return [render_passes(scene, device, resolve=resolve, **settings) for resolve in (Resolve.ADAPTIVE, Resolve.FULL)]


def settled_shares(scene, device, **settings):
    for progress in render(scene, plan(scene, Settings(**settings)), device):
        statistics = progress.statistics
    return [made.settled_share for made in statistics.passes]


@pytest.mark.parametrize("view_count", [64, pytest.param(128, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["sphere", "room", "leaves", "low light"])
def test_shortcut_changes_little(device, name, view_count):
    scene = scene_named(name)
    arguments = {"method": Method.MICRO, "view_count": view_count, "map_resolution_px": 512}
    adaptive, full = both(scene, device, **arguments)
    for pass_name in full:
        error = rmse(adaptive[pass_name], full[pass_name])
        print(f"{name} {view_count} {pass_name}: RMSE {error:.5f}")
        assert error <= 0.002
    (share,) = settled_shares(scene, device, resolve=Resolve.ADAPTIVE, **arguments)
    print(f"settled {share:.3f}")
    assert share > (0.3 if name == "sphere" else 0.0)


def test_nothing_changes_far_from_penumbrae(device):
    scene = scene_named("room")
    adaptive, full = both(scene, device, method=Method.MICRO, view_count=64, map_resolution_px=512)
    for name in full:
        certain = (full[name] == 0) | (full[name] == 1)
        assert certain.mean() > 0.2
        np.testing.assert_array_equal(adaptive[name][certain], full[name][certain])


def test_combined_pass_weighs_lights_alike(device):
    """A pixel settled for one light goes on for another: the sums have different numbers of samples."""
    lights = [
        area_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 0.0), name="Key", strength=3.0),
        area_light(eye=(-3.0, 1.0, 2.0), target=(0.0, 0.0, 0.0), size_m=(2.0, 2.0), name="Fill"),
    ]
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.4), 160, 90)
    scene = snapshot([floor(4.0), box("box", (0.0, 0.0, 0.5), (0.5, 0.4, 0.5))], lights, camera, 160, 90)
    adaptive, full = both(scene, device, view_count=64, map_resolution_px=256)
    assert rmse(adaptive["VIR Shadow"], full["VIR Shadow"]) <= 0.002


SPREAD_LIGHTS = {
    # their first samples say little of how much a place gets that few of them reach
    "a spot's rim": spot_light(name="Spot", eye=(0.0, -0.5, 4.0), radius_m=0.3, cone_rad=0.8, cone_blend=0.3, strength=40.0),
    "a near lamp": point_light(name="Lamp", eye=(-0.6, -0.8, 0.5), radius_m=0.3, strength=4.0),
    "a narrow spread": area_light(name="Beam", eye=(0.0, -0.5, 4.0), size_m=(1.5, 1.5), spread_rad=0.6, strength=40.0),
}


def beside_a_sealed_light(light):
    sealed = area_light(name="Sealed", eye=(1.2, 0.0, 0.5), target=(1.2, 0.0, 0.0), size_m=(0.3, 0.3), strength=20.0)
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.4), 160, 90)
    return snapshot([floor(4.0), box("box", (1.2, 0.0, 0.5), (0.5, 0.4, 0.5))], [light, sealed], camera, 160, 90)


@pytest.mark.parametrize("case", SPREAD_LIGHTS)
def test_combined_pass_weighs_what_few_samples_light(device, case):
    """Settled tiles have had a quarter of a light's samples, their neighbours all: blocks showed at a spot's rim."""
    adaptive, full = both(beside_a_sealed_light(SPREAD_LIGHTS[case]), device, view_count=64, map_resolution_px=256)
    error = rmse(adaptive["VIR Shadow"], full["VIR Shadow"])
    print(f"{case}: {error:.5f}, {np.abs(adaptive['VIR Shadow'] - full['VIR Shadow']).max():.4f} at most")
    assert error <= 0.002


def test_tiles_that_go_on_weigh_what_they_missed(device):
    """Lamps among what they light, each with probes in the maps of several faces, and tiles that are looked up again."""
    lights = [
        point_light(name="Omni", eye=(0.3, 0.2, 1.6), radius_m=0.25, strength=20.0),
        point_light(name="Low", eye=(-1.5, -1.0, 1.2), radius_m=0.2, strength=10.0),
    ]
    meshes = [
        floor(4.0),
        box("box", (1.2, 0.0, 0.5), (0.5, 0.4, 0.5)),
        bumpy_sphere("ball", (-0.8, 0.5, 0.6), 0.5, 14),
        box("high", (0.2, 0.3, 2.6), (0.4, 0.4, 0.1)),
    ]
    width, height = 480, 270
    scene = snapshot(meshes, lights, perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.4), width, height), width, height)
    adaptive, full = both(scene, device, method=Method.MICRO, view_count=64, map_resolution_px=256)
    error = rmse(adaptive["VIR Shadow"], full["VIR Shadow"])
    print(f"{error:.5f}, {np.abs(adaptive['VIR Shadow'] - full['VIR Shadow']).max():.4f} at most")
    assert error <= 0.0008


def test_what_is_shown_is_what_is_read(device):
    """The picture of the preview stays on the device, and weighs settled tiles there."""
    scene = beside_a_sealed_light(SPREAD_LIGHTS["a near lamp"])
    with prepared_renderer(scene, device, resolve=Resolve.ADAPTIVE, view_count=64, map_resolution_px=256) as renderer, Owned() as owned:
        render_batches(renderer)
        assert max(work.accumulator.settled_share for work in renderer.works) > 0.1
        picture = owned.own(device.upload_texture(np.zeros((90, 160, 4), np.float32)))
        assert device.run(renderer.draw_shadows, picture, None)
        shown = device.run(device.read, picture)
        read = renderer.read_passes()["VIR Shadow"]
    np.testing.assert_allclose(pass_image(shown[..., 0], shown[..., 1], shown[..., 2]), read, atol=1e-5)


def test_hard_shadows_keep_their_antialiased_edges(device):
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.4), 160, 90)
    light = area_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 0.0), size_m=(0.0, 0.0))
    meshes = [floor(1.5), box("box", (0.0, 0.0, 0.5), (0.5, 0.4, 0.5), turn_rad=0.4)]
    scene = snapshot(meshes, [light], camera, 160, 90, pixel_filter=PixelFilter())
    adaptive, full = both(scene, device, map_resolution_px=1024)
    (name,) = (name for name in full if name != "VIR Shadow")
    edges = (full[name] > 0) & (full[name] < 1)
    assert edges.sum() > 50
    np.testing.assert_allclose(adaptive[name], full[name], atol=1e-6)


def plate_with_hole(height_m, hole_m):
    """Four boxes around a square hole. It shows every place below it a small part of a light above, of which few samples are in."""
    half_m = 2.0
    wide_m = (half_m + hole_m / 2) / 2
    aside_m = hole_m / 2 + wide_m
    turns = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    return [
        box(
            f"plate {number}",
            (x * aside_m + y * (wide_m - hole_m / 2), y * aside_m - x * (wide_m - hole_m / 2), height_m),
            (wide_m, wide_m, 0.02),
        )
        for number, (x, y) in enumerate(turns)
    ]


def under_a_hole(light, height_m, hole_m):
    camera = perspective_camera((0.0, -1.5, 0.6), (0.0, 0.0, 0.0), 160, 96)
    return snapshot([floor(4.0), *plate_with_hole(height_m, hole_m)], [light], camera, 160, 96)


LIGHTS_OVER_HOLES = {
    "area": (area_light(eye=(0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), size_m=(2.0, 2.0)), 1.0, 1),
    "lamp": (point_light(eye=(0.0, 0.0, 2.0), radius_m=0.8), 0.7, 2),
}


@pytest.mark.parametrize("name", LIGHTS_OVER_HOLES)
def test_what_only_few_samples_see_is_found_again(device, name):
    light, height_m, least_mapped_count = LIGHTS_OVER_HOLES[name]
    scene = under_a_hole(light, height_m, hole_m=0.06)
    arguments = {"view_count": 64, "map_resolution_px": 1024}
    with prepared_renderer(scene, device, resolve=Resolve.FULL, **arguments) as renderer:
        render_batches(renderer)
        full = renderer.read_passes()
        _, _, all_surfaces = device.run(renderer.works[0].accumulator.read)
    dim = (full["VIR Shadow"] > 0) & (full["VIR Shadow"] < 0.1)
    shares = []
    with prepared_renderer(scene, device, resolve=Resolve.ADAPTIVE, **arguments) as renderer:
        (work,) = renderer.works
        mapped_count = sum(method is not None for _, _, method in work.faces)
        for batch in range(renderer.plan.batch_count):
            device.run(renderer.render_batch, batch)
            shares.append(work.accumulator.settled_share)
        adaptive = renderer.read_passes()
        _, _, surfaces = device.run(work.accumulator.read)
    # however a tile's rounds were left out and taken up again, they count as often as everyone's
    np.testing.assert_allclose(surfaces, all_surfaces, atol=1e-5)
    error = rmse(adaptive["VIR Shadow"], full["VIR Shadow"])
    print(f"{name}: RMSE {error:.5f}, dim {dim.mean():.3f}, {mapped_count} maps a view, settled after each batch {shares}")
    assert dim.mean() > 0.02
    assert mapped_count >= least_mapped_count
    assert max(shares) > shares[-1]
    assert error <= 0.002


def test_a_first_batch_settles_only_what_has_nothing_dark_nearby(device):
    arguments = {"method": Method.MICRO, "view_count": 64, "map_resolution_px": 256, "resolve": Resolve.ADAPTIVE}
    with prepared_renderer(scene_named("sphere"), device, **arguments) as renderer:
        (work,) = renderer.works
        device.run(renderer.render_batch, 0)
        early = work.accumulator.tile_states
        device.run(renderer.render_batch, 1)
        settled = work.accumulator.tile_states
    assert set(np.unique(early)) <= {0, STATE_LIT, STATE_BACKGROUND}
    assert 0 < (early != 0).mean() < (settled != 0).mean()
    np.testing.assert_array_equal(settled[early != 0], early[early != 0])
    assert (settled == STATE_DARK).any()
    for row, column in np.argwhere(settled == STATE_DARK):
        assert not early[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].any()


def test_it_is_on_unless_turned_off(device):
    scene = scene_named("sphere")
    assert settled_shares(scene, device) == settled_shares(scene, device, resolve=Resolve.ADAPTIVE)
    assert settled_shares(scene, device)[0] > 0.3
    assert settled_shares(scene, device, resolve=Resolve.FULL) == [0.0]
    assert settled_shares(scene, device, hardware=Hardware.GPU) == [0.0]


def test_probes_reach_every_pixel():
    shape = (16, 24)
    counts = np.zeros(shape, int)
    for batch in range(PROBE_COUNT):
        x, y = probe_px(batch)
        counts[y::PROBE_STEP_PX, x::PROBE_STEP_PX] += 1
        # spread out in every prefix: no probe beside another before a quarter of them is through
        assert counts[:4, :4].sum() == batch + 1
    assert (counts == 1).all()
