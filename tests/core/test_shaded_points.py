"""Points with their own colours in words of 13 + 19 bits and of 32 + 32, against cubes of which every texel is shaded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.core.test_reflected_points import room_with_balls
from tests.core.test_reflections import HEIGHT, WIDTH
from tests.core.test_shaded_maps import rendered
from tests.scenes import bumpy_sphere, floor, matte, mirror, perspective_camera, prepared_renderer, render_batches, snapshot
from vir_addon.core.errors import UsageError
from vir_addon.core.material import World
from vir_addon.core.methods.reflected_points import ReflectedPoints
from vir_addon.core.passes.reflected_points import MAX_CUBES
from vir_addon.core.passes.shaded_points import FACES_PER_CHANNEL, bytes_per_point
from vir_addon.core.plan import plan
from vir_addon.core.reflections.reflectors import MAX_GROUPS, MAX_REFLECTORS
from vir_addon.core.settings import Effect, ReflectionLookUp, ReflectionMethod, ReflectionWords, Settings

IVIR = {"reflection_method": ReflectionMethod.IVIR, "stochastic_culling": False}
PACKED = {**IVIR, "reflection_words": ReflectionWords.PACKED}
WIDE = {**IVIR, "reflection_words": ReflectionWords.WIDE}


def shining_balls(brightness: float = 1.0, rows: int = 48):
    """A mirror ball among balls of small triangles that shine in one colour each: what is seen of them hangs on no place or direction."""
    positions = [(1.5 * np.cos(k), 1.5 * np.sin(k), 0.5) for k in range(6)]
    balls = [bumpy_sphere(f"ball {k}", at, 0.6, rows, bump_share=0.0) for k, at in enumerate(positions)]
    hues = np.random.default_rng(3).uniform(0.05, 1.0, (6, 3)) * brightness
    middle = bumpy_sphere("mirror", (0, 0, 0.5), 0.5, 64, bump_share=0.0)
    camera = perspective_camera((0.3, -2.6, 4.0), (0, 0, 0.5), WIDTH, HEIGHT, 0.25)
    materials = [matte((0, 0, 0), (0.2, 0.2, 0.2)), *(matte((0, 0, 0), tuple(hue)) for hue in hues), mirror()]
    return snapshot([floor(6.0), *balls, middle], [], camera, WIDTH, HEIGHT, materials=materials, world=World((0.1, 0.2, 0.3)))


def shown_texels(scene, device, **settings):
    """(n, 3) what the finest level of the first cube shows, and (n,) what instance it was of before points; read while it is there"""
    chosen = {"effects": (Effect.REFLECTION,), "bounces": 1, "view_count": 1, "reflection_cube_px": 128, **settings}
    with prepared_renderer(scene, device, reflection_look_up=ReflectionLookUp.SHADED, reflection_sample_count=1, **chosen) as renderer:
        render_batches(renderer)
        work = renderer.reflections
        count = 6 * work.maps.maps[0].width_px ** 2
        shown = device.read(work.shaded_maps.radiances).reshape(-1, 4)[:count, :3]
        return shown, device.read(work.shaded_maps.positions).reshape(-1, 4)[:count, 3]


def test_wide_words_show_what_shaded_texels_do(device):
    scene = shining_balls()
    expected, of = shown_texels(scene, device, **IVIR)
    image, drawn = shown_texels(scene, device, **WIDE)
    # what is seen of balls are points: nothing that was drawn before them is a ball
    assert (of >= 1).sum() > 2000 and (drawn >= 1).mean() < 0.2 * (of >= 1).mean()
    # nine bits of a channel; outlines move by no more than a texel
    is_other = np.abs(image - expected).max(axis=1) > 1 / 256
    assert is_other.mean() < 0.01


def test_packed_words_round_colours_to_6_7_and_6_bits(device):
    scene = shining_balls()
    expected, of = shown_texels(scene, device, **IVIR)
    image, _ = shown_texels(scene, device, **PACKED)
    steps = np.array([63, 127, 63])
    root = np.sqrt(image)
    of_surface = of >= 0
    np.testing.assert_allclose((root * steps)[of_surface], np.round(root * steps)[of_surface], atol=1e-3)
    error = np.abs(root - np.sqrt(expected))
    assert (error.max(axis=1) > 1e-4).mean() > 0.3
    assert (error > 0.5 / steps + 1e-4).any(axis=1).mean() < 0.01
    # the world is no word
    np.testing.assert_array_equal(image[~of_surface], expected[~of_surface])


def test_packed_words_hold_colours_up_to_1_and_wide_ones_all(device):
    scene = shining_balls(brightness=50.0)
    expected, of = shown_texels(scene, device, **IVIR)
    packed, _ = shown_texels(scene, device, **PACKED)
    wide, _ = shown_texels(scene, device, **WIDE)
    is_near = np.abs(wide - expected) <= 0.004 * expected.max(axis=1, keepdims=True)
    assert expected.max() > 30 and is_near.all(axis=1).mean() > 0.99
    assert packed[of >= 0].max() == 1.0


def test_of_surfaces_nearer_to_each_other_than_a_step_packed_words_show_the_darker(device):
    """13 bits of depth are a thousandth of it: sheets that are closer to each other are one."""

    def sheets(apart_m):
        near = bumpy_sphere("near", (0, 0, 0.5), 3.0 - apart_m, 120, bump_share=0.0)
        far = bumpy_sphere("far", (0, 0, 0.5), 3.0, 120, bump_share=0.0)
        camera = perspective_camera((0.3, -1.6, 1.4), (0, 0, 0.5), WIDTH, HEIGHT, 0.4)
        meshes = [near, far, bumpy_sphere("mirror", (0, 0, 0.5), 0.5, 64, bump_share=0.0)]
        materials = [matte((0, 0, 0), (1, 1, 1)), matte((0, 0, 0), (0.1, 0.1, 0.1)), mirror()]
        return snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=materials, world=World())

    for apart_m, shows_far in ((0.0005, True), (0.1, False)):
        scene = sheets(apart_m)
        wide, _ = shown_texels(scene, device, reflection_cube_px=64, reflection_map_mib=512, **WIDE)
        packed, _ = shown_texels(scene, device, reflection_cube_px=64, reflection_map_mib=512, **PACKED)
        assert (wide[:, 0] > 0.9).mean() > 0.99
        assert ((packed[:, 0] < 0.5).mean() > 0.4) == shows_far
        if not shows_far:
            assert (packed[:, 0] > 0.9).mean() > 0.99


def test_each_point_has_bits_of_the_views_that_see_it(device):
    """Of more cubes than a texel has bits for: the face that the direction lies in, where the point's front is seen."""
    mirrors = [bumpy_sphere(f"mirror {k}", (0.5 * (k % 5) - 1.0, 0.5 * (k // 5) - 1.0, 1.2), 0.2, 12, bump_share=0.0) for k in range(20)]
    ball = bumpy_sphere("ball", (0, 0, 0.4), 0.4, 24, bump_share=0.0)
    camera = perspective_camera((0, -3.0, 4.5), (0, 0, 1.0), WIDTH, HEIGHT, 0.3)
    materials = [matte(), *[mirror()] * 20]
    scene = snapshot([ball, *mirrors], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    chosen = {"effects": (Effect.REFLECTION,), "bounces": 1, "view_count": 1, "reflection_look_up": ReflectionLookUp.SHADED, **PACKED}
    with prepared_renderer(scene, device, **chosen) as renderer:
        points = renderer.reflections.shaded_points
        cloud, count = points.cloud, points.cloud.count
        assert len(cloud.numbers) == 20 and len(cloud.batches) == 2
        places = device.read(points.positions).reshape(-1, 4)[:count]
        texels = device.read(points.views).reshape(-1, 4)[: 2 * count].astype(np.int64).reshape(count, 2, 4)
        maps = [renderer.reflections.maps.maps[number] for number in cloud.numbers]
    bits = (texels[..., None] >> np.arange(FACES_PER_CHANNEL) & 1).reshape(count, 2, 16, 6)
    own = (places[:, 3] == 0) & (places[:, 2] > 0.45)
    outward = (places[own, :3] - (0, 0, 0.4)) / 0.4
    assert own.sum() > 200
    for k, cube in enumerate(maps):
        p = places[own, :3] - cube.center_ws
        axis = np.abs(p).argmax(axis=1)
        face = 2 * axis + (p[np.arange(len(p)), axis] < 0)
        # triangles lean by some degrees
        facing = -(outward * p).sum(axis=1) / np.linalg.norm(p, axis=1)
        seen = bits[own, k // 16, k % 16]
        is_seen = facing > 0.2
        np.testing.assert_array_equal(seen[is_seen].argmax(axis=1), face[is_seen])
        assert is_seen.any() and (seen[is_seen].sum(axis=1) == 1).all()
        assert not seen[facing < -0.2].any()
    assert not bits[:, 1, 4:].any()


@pytest.mark.parametrize("words", [PACKED, WIDE])
def test_the_same_picture_in_every_run_and_near_that_of_shaded_texels(device, words):
    """In a room with a dim lamp, walls that are splatted whole and a mirrored ball; whatever order points come in."""
    scene = room_with_balls(rows=30)
    (lamp,) = scene.lights
    scene = dataclasses.replace(scene, lights=(dataclasses.replace(lamp, strength=0.02 * lamp.strength),))
    settings = {"reflection_cube_px": 128, "sample_count": 1}
    expected, shown, numbered = rendered(scene, device, **settings, **{**words, "reflection_words": ReflectionWords.NUMBERS})
    image, _, renderer = rendered(scene, device, **settings, **words)
    again, *_ = rendered(scene, device, **settings, **words)
    np.testing.assert_array_equal(again, image)
    root, truth = np.sqrt(image[shown]), np.sqrt(expected[shown])
    assert truth.std() > 0.05
    # a step of red and blue is a 63rd
    assert np.sqrt(np.mean((root - truth) ** 2)) < (1 / 63 if words is PACKED else 0.1 / 63)
    np.testing.assert_allclose(root.mean(axis=0), truth.mean(axis=0), rtol=0.02)
    found, before = renderer.statistics.reflections, numbered.statistics.reflections
    assert found.shaded_count > before.shaded_count > 0 and found.map_bytes > before.map_bytes


def test_points_that_take_more_memory_than_maps_may_are_refused(device):
    with pytest.raises(UsageError, match="points that are shaded themselves take more memory than 30 MiB"):
        rendered(room_with_balls(rows=240), device, reflection_cube_px=64, reflection_map_mib=30, **PACKED)
    assert bytes_per_point(1) == 16 * 13 and bytes_per_point(17) == 16 * 14


@pytest.mark.parametrize("choice", [{"reflection_look_up": ReflectionLookUp.SHADED}, {"reflection_method": ReflectionMethod.IVIR}])
def test_words_of_colour_are_of_shaded_cubes_of_ivir(choice):
    with pytest.raises(UsageError, match="packed words are what ivir writes into shaded cubes"):
        Settings(effects=(Effect.REFLECTION,), reflection_words=ReflectionWords.PACKED, **choice)


def test_500_reflectors_share_cubes_that_one_cloud_serves():
    """Those with cubes of their own, and groups of others."""
    mirrors = [bumpy_sphere(f"mirror {k}", (0.5 * (k % 25) - 6, 0.5 * (k // 25) - 5, 0.2), 0.2, 8, bump_share=0.0) for k in range(500)]
    camera = perspective_camera((0, -9, 10), (0, 0, 0), 256, 144, 0.35)
    scene = snapshot(mirrors, [], camera, 256, 144, materials=[mirror()] * 500, world=World((0.1, 0.2, 0.3)))
    settings = Settings(effects=(Effect.REFLECTION,), bounces=1, view_count=1, reflection_look_up=ReflectionLookUp.SHADED, **PACKED)
    planned = plan(scene, settings).reflections
    assert sum(each.seen is not None for each in planned.reflectors) == len(planned.maps)
    assert MAX_REFLECTORS < len(planned.maps) <= MAX_REFLECTORS + MAX_GROUPS <= MAX_CUBES
    assert max(len(each.instances) for each in planned.reflectors if each.seen is not None) > 1


def test_more_cubes_than_one_cloud_serves_are_refused(device):
    """Before anything is drawn: points of the first cloud would be lost."""
    scene = shining_balls(rows=12)
    chosen = {"effects": (Effect.REFLECTION,), "bounces": 1, "view_count": 1, "reflection_look_up": ReflectionLookUp.SHADED, **PACKED}
    with prepared_renderer(scene, device, **chosen) as renderer:
        kept = renderer.reflections.kept_points
        arguments = kept.bounds, kept.settings, ReflectionMethod.IVIR
        ReflectedPoints(kept.maps, kept.cubes * MAX_CUBES, *arguments).release()
        with pytest.raises(UsageError, match="serve 256 cubes, not 257"):
            ReflectedPoints(kept.maps, kept.cubes * (MAX_CUBES + 1), *arguments)
