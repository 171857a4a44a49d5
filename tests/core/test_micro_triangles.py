"""Micro-triangle rasterization against the hardware rasterizer, texel by texel: two implementations of one rule of coverage."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from tests.core.test_point_coverage import HEIGHT, MAP_PX, WIDTH, leaves_scene, made
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    check_portions,
    error_against_rasterization,
    floor,
    perspective_camera,
    prepared_renderer,
    render_pass,
    rmse,
    snapshot,
    sun_light,
)
from vir_addon.core.methods import micro
from vir_addon.core.passes.shadow_maps import DepthMaps
from vir_addon.core.passes.small_triangles import BLOCK_TEXELS
from vir_addon.core.settings import Method
from vir_addon.device.interface import EMPTY_DEPTH_BITS


def low_light_scene():
    """A floor all around a low light: four sides of the cube have casters, small and large, seen from between them."""
    meshes = [floor(8.0)]
    for k in range(6):
        x, y = 2.5 * np.cos(k), 2.5 * np.sin(k)
        meshes.append(bumpy_sphere(f"sphere {k}", (x, y, 0.6), 0.5, 60))
        meshes.append(box(f"box {k}", (1.8 * y, -1.8 * x, 0.4), (0.3, 0.2, 0.4), turn_rad=float(k)))
    camera = perspective_camera((0.5, -9.0, 7.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT)
    return snapshot(meshes, [area_light(eye=(0.0, 0.0, 1.2), target=(0.0, 0.0, 0.0), size_m=(0.5, 0.3))], camera, WIDTH, HEIGHT)


def sun_scene():
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT)
    meshes = [bumpy_sphere("sphere", (0.3, 0.2, 1.2), 1.0, 224), box("box", (-1.5, 0.5, 0.4), (0.3, 0.2, 0.4), turn_rad=0.5), floor(4.0)]
    return snapshot(meshes, [sun_light(eye=(3.0, -2.0, 5.0), target=(0.0, 0.0, 0.0), angle_rad=0.3)], camera, WIDTH, HEIGHT)


def scene_named(name):
    return {"low light": low_light_scene, "sun": sun_scene}[name]() if name in ("low light", "sun") else made(name)


def maps_of_all_faces(scene, device, selected, **settings):
    """[depths (view, row, column) of some views, infinite where nothing is], and the methods' counts added up"""
    found, counts = [], {}
    with prepared_renderer(scene, device, map_resolution_px=MAP_PX, view_count=64, **settings) as renderer:
        for fitted, _, method in renderer.works[0].faces:
            if method is None:
                continue
            maps = DepthMaps(device, fitted.views.map_width_px, fitted.views.map_height_px, len(selected))
            method.fill(maps, selected)
            bits = device.run(device.read, maps.texture)
            device.run(maps.release)
            depth = np.where(bits == EMPTY_DEPTH_BITS, np.inf, bits.view(np.float32))
            found.append(depth.reshape(len(selected), MAP_PX, MAP_PX))
            counts = {name: counts.get(name, 0) + count for name, count in method.counts().items()}
    return found, counts


@pytest.mark.parametrize("name", ["sphere", "room", "leaves", "low light", "sun"])
def test_maps_are_those_of_the_hardware_rasterizer(device, name):
    """But for texels whose centre an edge passes nearer than the two round corners apart."""
    scene, selected = scene_named(name), range(0, 4)
    truth, _ = maps_of_all_faces(scene, device, selected, method=Method.MVR)
    micro, counts = maps_of_all_faces(scene, device, selected, method=Method.MICRO)
    assert len(truth) == len(micro) == (4 if name == "low light" else 1)
    assert name not in ("sphere", "low light", "sun") or counts["small_triangle_count"] > 1000
    assert name == "sphere" or counts["large_triangle_count"] > 5
    for true_maps, maps in zip(truth, micro, strict=True):
        covered = np.isfinite(true_maps)
        both = covered & np.isfinite(maps)
        apart = covered != np.isfinite(maps)
        # where two surfaces' outlines cross a texel, either may be what its centre sees
        deviating = np.abs(np.where(both, maps, 0) - np.where(both, true_maps, 0)) > 1e-3 * np.where(both, true_maps, 1)
        print(f"{name}: {apart.sum()} covered by one only, {deviating.sum()} at another depth, of {covered.sum()}")
        assert covered.sum() > 1000
        assert apart.sum() <= 2e-4 * covered.sum() + 4 and deviating.sum() <= 1e-3 * covered.sum()


def test_looking_at_a_texel_before_its_update_changes_no_map(device, monkeypatch):
    assert device.is_software
    maps, _ = maps_of_all_faces(made("leaves"), device, range(0, 8), method=Method.MICRO)
    monkeypatch.setattr(device, "is_software", False)
    others, _ = maps_of_all_faces(made("leaves"), device, range(0, 8), method=Method.MICRO)
    np.testing.assert_array_equal(maps, others)


def test_triangles_that_share_an_edge_leave_nothing_between_them(device):
    """Inside a finely tessellated sphere's outline no texel is empty, whatever the view."""
    (maps,), counts = maps_of_all_faces(made("sphere"), device, range(0, 8), method=Method.MICRO)
    assert counts["small_triangle_count"] > 10_000
    for view in maps:
        covered = np.isfinite(view)
        assert covered.sum() > 10_000
        np.testing.assert_array_equal(ndimage.binary_fill_holes(covered), covered)


@pytest.mark.parametrize("name", ["sphere", "room", "leaves", "low light", "sun"])
def test_passes_agree_with_multiview_rasterization(device, name):
    scene = scene_named(name)
    error = error_against_rasterization(scene, device, Method.MICRO, map_resolution_px=512)
    print(f"{name}: RMSE {error:.5f}")
    assert error <= 0.001


@pytest.mark.parametrize("method", [Method.MICRO, Method.HYBRID])
def test_the_same_frame_gives_the_same_bits(device, method):
    """Kernels list triangles in any order; leaves pass through each other, and where two are equally deep the first one drawn is kept."""
    scene = made("leaves")
    arguments = {"method": method, "small_triangle_points": 0, "view_count": 64, "map_resolution_px": 256}
    first = render_pass(scene, device, **arguments)
    for _ in range(5):
        np.testing.assert_array_equal(render_pass(scene, device, **arguments), first)


@pytest.mark.parametrize("name", ["leaves", "low light"])
def test_portions_make_the_same_picture(device, name):
    scene = scene_named(name)
    if name == "leaves":
        meshes, light = leaves_scene()
        dense = bumpy_sphere("dense", (0.6, 0.4, 0.9), 0.5, 150)
        scene = snapshot([*meshes, dense], [light], scene.camera, WIDTH, HEIGHT)
    check_portions(scene, device, 2 if name == "leaves" else 1, method=Method.MICRO)


def test_gathering_in_several_goes_makes_the_same_maps(device, monkeypatch):
    scene, selected = low_light_scene(), range(16, 20)
    expected, counts = maps_of_all_faces(scene, device, selected, method=Method.MICRO)
    monkeypatch.setattr(micro, "GROUPS_AT_ONCE", 7)
    found, same_counts = maps_of_all_faces(scene, device, selected, method=Method.MICRO)
    assert same_counts == counts and len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["sphere", "leaves", "low light"])
def test_leaving_hidden_triangles_out_changes_little(device, name):
    scene = scene_named(name)
    arguments = {"method": Method.MICRO, "view_count": 64, "map_resolution_px": 512}
    culled, everything = (render_pass(scene, device, cull_hidden=dropped, **arguments) for dropped in (True, False))
    assert rmse(culled, everything) <= 0.002


def test_hidden_triangles_are_left_out(device):
    """Of an open surface both sides are gathered; what faces away stands behind and is found hidden."""
    meshes = [bumpy_sphere("sphere", (0.0, 0.0, 1.2), 1.0, 224), floor(4.0)]
    open_sphere = dataclasses.replace(meshes[0], is_closed=False)
    light = area_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 1.0))
    camera = perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT)
    scene = snapshot([open_sphere, meshes[1]], [light], camera, WIDTH, HEIGHT)
    _, counts = maps_of_all_faces(scene, device, range(0, 8), method=Method.MICRO)
    assert counts["small_triangle_count"] > 0.95 * len(open_sphere.triangles)
    assert 0.3 < counts["kept_small_triangle_count"] / counts["small_triangle_count"] < 0.7


def test_what_is_kept_lies_in_the_order_of_its_places(device):
    """Nothing lost, nothing twice, the blocks of texels one after the other, and in each half of the list some from everywhere."""
    scene, selected = made("sphere"), range(0, 8)
    lists = {}
    for cull_hidden in (False, True):
        with prepared_renderer(
            scene, device, method=Method.MICRO, map_resolution_px=MAP_PX, view_count=64, cull_hidden=cull_hidden
        ) as renderer:
            ((fitted, _, method),) = renderer.works[0].faces
            maps = DepthMaps(device, fitted.views.map_width_px, fitted.views.map_height_px, len(selected))
            method.fill(maps, selected)
            count = method.kept_count if cull_hidden else method.small_count
            lists[cull_hidden] = device.run(device.read, method.triangles.texture).reshape(-1, 4)[: 3 * count].reshape(count, 3, 4)
            table, scale = method.views_table(selected), 1 / np.array(fitted.views.texel_tangent)
            device.run(maps.release)
    gathered, kept = ({triangle.tobytes() for triangle in triangles[:, :, :3]} for triangles in lists.values())
    assert len(kept) == len(lists[True]) > 0.9 * len(gathered) and kept <= gathered
    # what was counted is what places were handed out by
    block = lists[True][:, 1, 3]
    assert np.count_nonzero(np.diff(block)) == len(np.unique(block)) - 1 > 100
    block_rows = [half // (-(-MAP_PX // BLOCK_TEXELS)) for half in np.array_split(block, 2)]
    assert all(np.ptp(each) > 0.8 * np.ptp(np.concatenate(block_rows)) and np.diff(np.unique(each)).max() <= 3 for each in block_rows)
    corner = lists[True][:, 0].astype(np.float64)
    places = corner[:, :2] - table[0, :2] * scale * corner[:, 2:3] - table[1, :2]
    # a corner on the border of two blocks may be rounded into either
    assert (np.clip(places, 0, MAP_PX - 1) // BLOCK_TEXELS @ [1, -(-MAP_PX // BLOCK_TEXELS)] != block).mean() < 1e-3
