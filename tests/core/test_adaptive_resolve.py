"""Leaving out pixels that are known to be wholly lit or dark: what it changes, and that it is done."""

import numpy as np
import pytest

from tests.core.test_micro_triangles import scene_named
from tests.scenes import area_light, box, floor, perspective_camera, prepared_renderer, render_passes, rmse, snapshot
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.scene import PixelFilter
from vir_addon.core.settings import Method, Resolve, Settings


def both(scene, device, **settings):
    return [render_passes(scene, device, resolve=resolve, **settings) for resolve in (Resolve.ADAPTIVE, Resolve.FULL)]


def settled_shares(scene, device, **settings):
    for progress in render(scene, plan(scene, Settings(**settings)), device):
        statistics = progress.statistics
    return [made.settled_share for made in statistics.passes]


@pytest.mark.parametrize("view_count", [64, 128])
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


def test_it_is_off_unless_asked_for(device):
    """Behind a table, where 3 of 64 samples of a window reach, the first 16 may all be dark."""
    scene = scene_named("sphere")
    assert settled_shares(scene, device) == settled_shares(scene, device, resolve=Resolve.FULL) == [0.0]
    with prepared_renderer(scene, device) as renderer:
        assert renderer.works[0].accumulator.settled_batch_count == 0
