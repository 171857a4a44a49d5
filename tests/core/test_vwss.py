"""View-warped soft shadows: the source view against its equations, and its maps against the rasterizer's."""

import numpy as np
import pytest

from tests.core.test_point_coverage import first_maps, made, off_silhouette
from tests.core.test_vir import lit_by
from tests.scenes import point_light, prepared_renderer, render_pass, rmse, spot_light, sun_light
from vir_addon.core.errors import UsageError
from vir_addon.core.methods import vwss
from vir_addon.core.methods.vwss import WATERTIGHT_OVERSAMPLING, source_view
from vir_addon.core.plan import plan
from vir_addon.core.settings import Method, PointStorage, Settings
from vir_addon.core.views import Face, FaceViews

MAP_PX = 256
FRONT = Face("front", 0, np.eye(3), (-1, 1, -1, 1))


def symmetric_views(width_m, height_m, half_tangent, count=32):
    """Views spread over a rectangle, all with the same window around the axis."""
    generator = np.random.default_rng(5)
    centers = np.zeros((count, 3))
    centers[:, :2] = generator.uniform(-0.5, 0.5, (count, 2)) * [width_m, height_m]
    centers[:4, :2] = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) / 2 * [width_m, height_m]
    texel = 2 * half_tangent / MAP_PX
    first = np.full((count, 2), -MAP_PX // 2)
    return FaceViews(FRONT, centers, centers, (texel, texel), first, MAP_PX, MAP_PX, 0.01, 10.0, np.zeros(3))


@pytest.mark.parametrize(("width_m", "height_m", "half_tangent"), [(1.0, 1.0, 0.5), (0.3, 2.0, 0.2)])
def test_source_view_follows_its_equations(width_m, height_m, half_tangent):
    nearest_m = 4.0
    views = symmetric_views(width_m, height_m, half_tangent)
    source = source_view(views, nearest_m, is_watertight=False)
    back_m = max(width_m, height_m) / (2 * half_tangent)  # eq. 1
    np.testing.assert_allclose(source.eye_fs, [0, 0, -back_m], atol=1e-12)  # eq. 2
    np.testing.assert_allclose(source.texel_tangent, 2 * half_tangent / MAP_PX * nearest_m / (nearest_m + back_m))  # eq. 3
    # m' = (m z + d) / z texels, because it has the views' own field of view and, along the light's longer side, no wider one
    widest = max(source.bounds_texels[1] - source.bounds_texels[0], source.bounds_texels[3] - source.bounds_texels[2])
    assert widest == pytest.approx(MAP_PX * (nearest_m + back_m) / nearest_m, abs=3)
    assert source.near_m == pytest.approx(back_m + views.near_m)
    finer = source_view(views, nearest_m, is_watertight=True)
    np.testing.assert_allclose(np.divide(source.texel_tangent, finer.texel_tangent), WATERTIGHT_OVERSAMPLING)


def test_source_view_contains_what_any_view_sees():
    views = symmetric_views(0.7, 1.1, 0.35)
    source = source_view(views, 1.0, is_watertight=True)
    left, right, bottom, top = source.bounds_texels
    for z in np.geomspace(views.near_m, views.far_m, 12):
        for k in range(views.view_count):
            sides = np.array(views.window_tangents(k)) * z + views.centers_fs[k, [0, 0, 1, 1]] - source.eye_fs[[0, 0, 1, 1]]
            tangents = sides / (z - source.eye_fs[2])
            texels = tangents / np.repeat(source.texel_tangent, 2)
            assert left <= texels[0] + 1e-6 and texels[1] - 1e-6 <= right and bottom <= texels[2] + 1e-6 and texels[3] - 1e-6 <= top


def empty_share(scene, device, **settings):
    """Of texels away from outlines that the rasterizer covers."""
    truth, footprint = first_maps(scene, device, range(0, 4), method=Method.MVR)
    points, _ = first_maps(scene, device, range(0, 4), method=Method.VWSS, **settings)
    inside = np.array([off_silhouette(view, footprint) for view in truth])
    assert inside.sum() > 10_000
    return (inside & ~np.isfinite(points)).sum() / inside.sum()


@pytest.mark.parametrize(("name", "may_miss"), [("sphere", 5e-4), ("room", 1e-4), ("leaves", 1e-3)])
def test_few_texels_are_empty(device, name, may_miss):
    scene = made(name)
    watertight, published = (empty_share(scene, device, watertight=choice) for choice in (True, False))
    print(f"{name}: {watertight:.5f}, published {published:.5f}")
    assert watertight <= may_miss
    assert watertight < published < 0.03


def test_back_faces_fill_what_only_other_views_see(device):
    """Near a sphere's outline the source view sees backs of triangles that face other views."""
    scene = made("sphere")
    front, both = (empty_share(scene, device, watertight=False, back_faces=choice) for choice in (False, True))
    print(front, both)
    assert both < 0.1 * front


@pytest.mark.parametrize(("name", "error"), [("sphere", 0.02), ("room", 0.01)])
def test_passes_agree_with_multiview_rasterization(device, name, error):
    scene = made(name)
    images = [render_pass(scene, device, method=method, view_count=64, map_resolution_px=512) for method in (Method.MVR, Method.VWSS)]
    assert (images[0] < 0.9).mean() > 0.05
    print(f"{name}: RMSE {rmse(*images):.5f}")
    assert rmse(*images) <= error


@pytest.mark.parametrize(
    "other",
    [
        {"points": PointStorage.BUFFERLESS},
        {"views_per_thread": 1},
        {"views_per_thread": 3},
        {"points": PointStorage.BUFFERLESS, "views_per_thread": 3},
        {"replay_buffer_mib": 1},
    ],
)
def test_every_way_makes_the_same_picture(device, other):
    scene = made("room")
    arguments = {"method": Method.VWSS, "view_count": 16, "map_resolution_px": 256}
    with prepared_renderer(scene, device, **arguments, **other) as renderer:
        assert (renderer.works[0].statistics.portion_count > 1) == ("replay_buffer_mib" in other)
    images = [render_pass(scene, device, **arguments, **settings) for settings in ({}, other)]
    # a kernel and a fragment's shader may round differently, and so does a GPU's rasterizer where a part's viewport moves corners
    assert rmse(*images) <= (4e-3 if "replay_buffer_mib" in other else 1e-4)


def test_a_source_view_in_many_parts_makes_the_same_picture(device, monkeypatch):
    scene, arguments = made("sphere"), {"method": Method.VWSS, "view_count": 8, "map_resolution_px": 256}
    whole = render_pass(scene, device, **arguments)
    monkeypatch.setattr(vwss, "SOURCE_PART_PX", 100)
    assert rmse(render_pass(scene, device, **arguments), whole) <= 2e-3


@pytest.mark.parametrize("light", [sun_light("Other"), point_light("Other"), spot_light("Other")])
def test_other_lights_are_refused_with_what_can(light):
    with pytest.raises(UsageError, match=r"'Other'.*the method ivir"):
        plan(lit_by(light), Settings(method=Method.VWSS))


def test_a_thread_serves_at_least_a_view():
    with pytest.raises(UsageError, match="at least one view"):
        Settings(views_per_thread=0)
