"""View-independent rasterization as first published: watertight like its successor, with about twice its points."""

import numpy as np
import pytest

from tests.core.test_point_coverage import first_maps, made
from tests.scenes import box, floor, perspective_camera, prepared_renderer, render_pass, rmse, snapshot, sun_light
from vir_addon.core.errors import UsageError
from vir_addon.core.plan import plan
from vir_addon.core.settings import Method, PointStorage, Settings


@pytest.mark.parametrize("name", ["sphere", "leaves"])
def test_no_texel_is_missed(device, name):
    scene = made(name)
    truth, _ = first_maps(scene, device, range(0, 4), method=Method.MVR)
    points, _ = first_maps(scene, device, range(0, 4), method=Method.VIR)
    covered = np.isfinite(truth)
    assert covered.sum() > 10_000
    assert (covered & ~np.isfinite(points)).sum() <= 1e-4 * covered.sum()


def test_pass_agrees_with_multiview_rasterization(device):
    scene = made("sphere")
    images = [render_pass(scene, device, method=method, view_count=64, map_resolution_px=512) for method in (Method.MVR, Method.VIR)]
    assert (images[0] < 0.9).mean() > 0.05
    print(f"RMSE {rmse(*images):.5f}")
    assert rmse(*images) <= 0.01


@pytest.mark.parametrize("is_watertight", [True, False])
def test_one_rate_for_all_takes_more_points(device, is_watertight):
    """The preprint of 2020 has 238 thousand against 122 thousand."""
    counts = {}
    for method in (Method.IVIR, Method.VIR):
        arguments = {"view_count": 8, "map_resolution_px": 512, "stochastic_culling": False, "watertight": is_watertight}
        with prepared_renderer(made("sphere"), device, method=method, **arguments) as renderer:
            counts[method] = renderer.works[0].statistics.point_count
    print(counts)
    assert 1.3 < counts[Method.VIR] / counts[Method.IVIR] < 4


def test_local_culling_leaves_out_only_what_is_hidden(device):
    """The maps are those of all points, a point at a time."""
    with prepared_renderer(made("leaves"), device, method=Method.VIR, view_count=8, map_resolution_px=256) as renderer:
        ((_, _, method),) = renderer.works[0].faces
        assert method.replay_flags == ["LOCAL_CULLING"] and method.point_count % method.points_per_invocation
        maps = renderer.store.maps(8)
        method.fill(maps, range(8))
        culled = device.run(device.read, maps.texture).view(np.float32).copy()
        method.replay_flags, method.points_per_invocation = [], 1
        method.fill(maps, range(8))
        every = device.run(device.read, maps.texture).view(np.float32)
    assert (every < 1e30).mean() > 0.1
    # the two project in another order of operations: rounding, and with it now and then a texel
    assert (np.abs(culled - every) > 1e-5 * every).mean() < 2e-4


def lit_by(light):
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    return snapshot(meshes, [light], perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), 48, 27), 48, 27)


def test_what_it_cannot_do_is_refused_with_what_can():
    with pytest.raises(UsageError, match=r"parallel.*the method ivir"):
        plan(lit_by(sun_light()), Settings(method=Method.VIR))
    with pytest.raises(UsageError, match=r"vir, which compares neighbours.*ivir"):
        Settings(method=Method.VIR, points=PointStorage.BUFFERLESS)
