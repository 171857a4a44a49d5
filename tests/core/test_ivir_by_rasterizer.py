"""Points that geometry shader and rasterizer make, as published, against those of the kernels."""

import types

import numpy as np
import pytest

from tests.core.test_point_coverage import SCENES, first_maps, made
from tests.scenes import (
    check_portions,
    floor,
    leaves,
    perspective_camera,
    point_light,
    prepared_renderer,
    render_batches,
    rmse,
    snapshot,
    sun_light,
)
from vir_addon.core.errors import UsageError
from vir_addon.core.plan import check_device, plan
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Settings

COMPUTE, RASTERIZER = PointGeneration.COMPUTE, PointGeneration.RASTERIZER


def lit_leaves(*lights):
    meshes = [leaves("leaves", (0.0, 0.0, 1.4), 1.6, 300, 0.2), floor(4.0)]
    return snapshot(meshes, lights or [sun_light()], perspective_camera((0.5, -5.0, 3.5), (0.0, 0.0, 0.8), 64, 36), 64, 36)


@pytest.fixture
def rasterizing_device(device):
    if not device.stores_from_geometry:
        with pytest.raises(UsageError, match=r"geometry shaders.*the device moderngl.*the point generation compute"):
            check_device(plan(lit_leaves(), Settings(method=Method.IVIR, point_generation=RASTERIZER)), device)
        pytest.skip("no geometry shaders")
    return device


@pytest.mark.parametrize(("storage", "culling"), [(PointStorage.BUFFERED, False), (PointStorage.BUFFERLESS, True)])
@pytest.mark.parametrize(
    ("name", "map_px"),
    [
        pytest.param(name, map_px, marks=pytest.mark.slow if map_px == 256 and name != "room" else ())
        for name in SCENES
        for map_px in (64, 256)
    ],
)
def test_the_same_texels_are_covered(rasterizing_device, name, map_px, storage, culling):
    """With triangles of a part of a texel, of some and of many."""
    scene, device = made(name), rasterizing_device
    arguments = {"map_px": map_px, "method": Method.IVIR, "points": storage, "stochastic_culling": culling}
    compute, rasterizer = (first_maps(scene, device, range(4), point_generation=by, **arguments)[0] for by in (COMPUTE, RASTERIZER))
    assert np.isfinite(compute).mean() > 0.05
    np.testing.assert_array_equal(np.isfinite(rasterizer), np.isfinite(compute))
    # depths as well: the points are the same, as far as a GPU's compiler rounds alike in a kernel and a geometry shader
    np.testing.assert_allclose(rasterizer, compute, rtol=1e-6)


@pytest.mark.parametrize("storage", [PointStorage.BUFFERED, pytest.param(PointStorage.BUFFERLESS, marks=pytest.mark.slow)])
def test_passes_and_counts_agree(rasterizing_device, storage):
    """Of a light with one face, one with parallel views and one with a cube."""
    scene = lit_leaves(sun_light("Sun"), point_light("Lamp", eye=(0.2, 0.1, 1.5), radius_m=0.1))
    counts, images = [], []
    for by in (COMPUTE, RASTERIZER):
        arguments = {"method": Method.IVIR, "points": storage, "point_generation": by, "view_count": 8, "map_resolution_px": 64}
        with prepared_renderer(scene, rasterizing_device, **arguments) as renderer:
            render_batches(renderer)
            images.append(np.array(list(renderer.read_passes().values())))
            made_by = [work.statistics for work in renderer.works]
            assert [made.method for made in made_by] == [f"ivir {storage.value}" + " by rasterizer" * (by is RASTERIZER)] * 2
            counts.append([(made.face_count, made.point_count, made.culled_triangle_count) for made in made_by])
    assert (images[0] < 0.9).mean() > 0.05
    assert counts[0] == counts[1] and max(made[0] for made in counts[0]) > 1
    assert rmse(*images) <= 0.002


@pytest.mark.slow
def test_portions_make_the_same_picture(rasterizing_device):
    check_portions(made("room"), rasterizing_device, 2, method=Method.IVIR, point_generation=RASTERIZER, view_count=8)


def test_a_device_without_geometry_shaders_is_refused_before_any_work():
    device = types.SimpleNamespace(name="gpu", stores_from_fragments=False, stores_from_geometry=False, max_texture_size_px=16384)
    with pytest.raises(UsageError, match=r"geometry shaders.*the device moderngl.*the point generation compute"):
        check_device(plan(lit_leaves(), Settings(method=Method.IVIR, point_generation=RASTERIZER)), device)
    check_device(plan(lit_leaves(), Settings(method=Method.IVIR)), device)


@pytest.mark.parametrize("method", [method for method in Method if method is not Method.IVIR])
def test_other_methods_have_no_choice(method):
    with pytest.raises(UsageError, match=f"not with {method.value}; choose the method ivir"):
        Settings(method=method, point_generation=RASTERIZER)
