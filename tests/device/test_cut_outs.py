"""What casts through an opacity map, against closed forms and float64 integrals, on both devices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    bumpy_sphere,
    camera_from_above,
    floor,
    point_light,
    prepared_renderer,
    rectangle,
    render_pass,
    rmse,
    snapshot,
    sun_light,
    with_opacity,
)
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.material import Extension
from vir_addon.core.passes.eye import EyePass
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.settings import Method

RASTERIZED = (Method.MVR, Method.MICRO)
CARD_HEIGHT_M, LIGHT_HEIGHT_M = 1.0, 4.0
CARD_SIDE_M = 2.0
WIDTH, HEIGHT, WIDTH_M = 96, 48, 1.6
QUADRATURE = 160
UVS = ((0, 0), (1, 0), (1, 1), (0, 1))
CHECKER = np.indices((8, 8)).sum(axis=0) % 2
"""squares of a quarter metre"""


def card(texels=CHECKER, uvs=UVS, height_m=CARD_HEIGHT_M, side_m=CARD_SIDE_M, **fields):
    plain = rectangle("card", (-side_m / 2, -side_m / 2, height_m), (side_m, 0, 0), (0, side_m, 0))
    return with_opacity(plain, texels, uvs, **fields)


def seen_from_above(occluders, light, width_px=WIDTH, height_px=HEIGHT, width_m=WIDTH_M):
    camera = camera_from_above((0.0, 0.0), width_m, width_px, height_px)
    visible = [True] + [False] * len(occluders)
    return snapshot([floor(), *occluders], [light], camera, width_px, height_px, visible_to_camera=visible)


def floor_points():
    x = (np.arange(WIDTH) + 0.5) / WIDTH * WIDTH_M - WIDTH_M / 2
    y = (np.arange(HEIGHT) + 0.5) / WIDTH * WIDTH_M - WIDTH_M / 2 * HEIGHT / WIDTH
    return np.meshgrid(x, y)


def checker_hides(x, y):
    """At places of the card's plane."""
    column, row = (np.floor((a / CARD_SIDE_M + 0.5) * 8).astype(int) for a in (x, y))
    inside = (column >= 0) & (column < 8) & (row >= 0) & (row < 8)
    return inside & ((column + row) % 2 == 1)


def lit_by_square(x, y, side_m):
    """float64, both cosines are height over distance"""
    u, v = np.meshgrid(*[(np.arange(QUADRATURE) + 0.5) / QUADRATURE * side_m - side_m / 2] * 2, indexing="ij")
    share = CARD_HEIGHT_M / LIGHT_HEIGHT_M
    weight = 1 / ((u - x) ** 2 + (v - y) ** 2 + LIGHT_HEIGHT_M**2) ** 2
    return (weight * ~checker_hides(x + (u - x) * share, y + (v - y) * share)).sum() / weight.sum()


def lit_by_sun(x, y, angle_rad):
    """Rays uniform in solid angle, each worth its cosine to the floor: uniform over the disc of their sines."""
    u, v = np.meshgrid(*[(np.arange(QUADRATURE) + 0.5) / QUADRATURE * 2 - 1] * 2, indexing="ij")
    disc = u**2 + v**2 < 1
    sines = np.stack([u[disc], v[disc]]) * np.sin(angle_rad / 2)
    tangents = CARD_HEIGHT_M * sines / np.sqrt(1 - (sines**2).sum(axis=0))
    return 1 - checker_hides(x + tangents[0], y + tangents[1]).mean()


LIGHTS = {
    "area": (area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(0.6, 0.6)), lambda x, y: lit_by_square(x, y, 0.6)),
    "sun": (sun_light(angle_rad=0.15), lambda x, y: lit_by_sun(x, y, 0.15)),
}


def error_of_checkered_card(device, method, name, **settings):
    light, lit = LIGHTS[name]
    image = render_pass(seen_from_above([card(is_interpolated=False)], light), device, method=method, **settings)
    x, y = (a[::4, ::2] for a in floor_points())
    truth = np.array([lit(*at) for at in zip(x.ravel(), y.ravel(), strict=True)]).reshape(x.shape)
    assert truth.min() < 0.1 and truth.max() > 0.9
    return rmse(image[::4, ::2], truth)


@pytest.mark.parametrize("method", [Method.MICRO, pytest.param(Method.MVR, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("name", "view_count"), [("area", 128), ("sun", 256)])
def test_checkered_card(device, method, name, view_count):
    """With 128 views the sun's samples alone are .009 to .013 off, by where the texels happen to lie."""
    assert error_of_checkered_card(device, method, name, view_count=view_count, map_resolution_px=512) <= 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", LIGHTS)
def test_checkered_card_in_splatted_maps(device, name):
    """Every outline is half a texel too far inside; maps of the default resolution have small ones."""
    assert error_of_checkered_card(device, Method.IVIR, name, view_count=256) <= 0.01


@pytest.mark.slow
@pytest.mark.parametrize("method", [Method.HYBRID, Method.VIR, Method.VWSS])
def test_other_methods_draw_the_same_cut_outs(device, method):
    """With the thresholds of `mvr`, so that without points the picture is the same, but for `vir`, which takes them for splatted."""
    if method is Method.VWSS and not device.stores_from_fragments:
        pytest.skip("refused on this device: test_parity.py")
    light, _ = LIGHTS["area"]
    soft = card(np.clip(np.hypot(*(np.indices((16, 16)) - 7.5)) / 4 - 0.5, 0, 1))
    ball = bumpy_sphere("ball", (0.5, 0.0, 0.4), 0.25, 120)
    for occluders in ([soft], [soft, ball]):
        scene = seen_from_above(occluders, light)
        images = [render_pass(scene, device, method=chosen, view_count=32, map_resolution_px=512) for chosen in (Method.MVR, method)]
        error = rmse(*images)
        print(f"{method.value}, {len(occluders)} occluders: {error:.5f}")
        assert images[0].std() > 0.1
        if method is Method.VIR or len(occluders) == 2:
            assert 1e-5 < error <= 0.01
        else:
            assert error <= 1e-6


def middle(image):
    """Mean of the middle of the picture."""
    height, width = image.shape
    return float(image[height // 3 : -height // 3, width // 3 : -width // 3].mean())


def pane(opacity, height_m=CARD_HEIGHT_M, side_m=CARD_SIDE_M):
    return card([[opacity]], height_m=height_m, side_m=side_m, is_interpolated=False)


@pytest.mark.parametrize(
    "method", [Method.MICRO, *(pytest.param(each, marks=pytest.mark.slow) for each in (Method.MVR, Method.IVIR, Method.HYBRID))]
)
def test_panes_let_their_share_through(device, method):
    """Half of what one pane lets through is stopped by another of opacity 0.5; no pixel is noisy behind one pane."""
    light = area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(0.4, 0.4))
    settings = {"method": method, "view_count": 64, "map_resolution_px": 64}
    one = render_pass(seen_from_above([pane(0.3)], light, 48, 24, 0.8), device, **settings)
    # 8 bits and 64 thresholds
    assert np.abs(one - 0.7).max() <= 1 / 64 + 1 / 255
    layers = [pane(0.5), pane(0.5, height_m=1.3), pane(0.5, height_m=1.6)]
    for count, expected, seeds in ((2, 0.25, 12), (3, 0.125, 12)):
        # each pair of seeds is a draw: their mean must be the product
        scenes = [
            dataclasses.replace(
                scene,
                instances=dataclasses.replace(scene.instances, stable_id=scene.instances.stable_id * np.uint32(2 * seed + 1)),
            )
            for scene in [seen_from_above(layers[:count], light, 24, 12, 0.4)]
            for seed in range(seeds)
        ]
        means = [middle(render_pass(scene, device, **settings)) for scene in scenes]
        # 64 draws without replacement in place of independent ones spread less than a binomial
        spread = np.sqrt(expected * (1 - expected) / 64 / seeds)
        assert abs(np.mean(means) - expected) <= 3 * spread, means
        assert np.std(means) <= 2 * np.sqrt(expected * (1 - expected) / 64), means


@pytest.mark.parametrize("method", RASTERIZED)
def test_a_light_without_size_has_other_thresholds_in_every_batch(device, method):
    """Its one view is drawn again in each of 8 batches."""
    light = point_light(eye=(0, 0, LIGHT_HEIGHT_M), radius_m=0.0)
    image = render_pass(seen_from_above([pane(0.5)], light, 48, 24, 0.8), device, method=method, map_resolution_px=64)
    np.testing.assert_allclose(image, 0.5, atol=1e-6)


def test_what_stands_behind_a_pane_is_kept(device):
    """Triangles hidden from a whole batch by a pane are in sight of others, so `micro` must not leave them out of its list."""
    light = area_light(eye=(0, 0, LIGHT_HEIGHT_M), size_m=(0.4, 0.4))
    ball = bumpy_sphere("ball", (0.0, 0.0, 0.4), 0.25, 32)
    scene = seen_from_above([ball, pane(0.95)], light, 48, 24, 1.6)
    images = [render_pass(scene, device, method=method, view_count=128, map_resolution_px=256) for method in RASTERIZED]
    assert images[0].min() < 0.001 < 0.03 < images[0].max()
    assert np.abs(images[0] - images[1]).max() <= 2 / 128


def seen_instances(scene, device):
    """(height, width) instance numbers at pixels' centres"""
    with prepared_renderer(scene, device, view_count=1) as renderer:
        return device.read(renderer.eye.buffers[0].positions)[..., 3].astype(int)


RING = np.random.default_rng(3).integers(0, 2, (5, 7)).astype(np.float64)


def sampled(texels, u, v, extension, *, is_interpolated):
    """Opacity at places of the image, float64."""
    height, width = texels.shape

    def texel(column, row):
        if extension is Extension.REPEAT:
            return texels[row % height, column % width]
        if extension is Extension.MIRROR:
            row, column = (np.where(i % (2 * n) < n, i % (2 * n), 2 * n - 1 - i % (2 * n)) for i, n in ((row, height), (column, width)))
            return texels[row, column]
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        value = texels[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return value * inside if extension is Extension.CLIP else value

    x, y = u * width, v * height
    if not is_interpolated:
        return texel(np.floor(x).astype(int), np.floor(y).astype(int))
    column, row = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    s, t = x - 0.5 - column, y - 0.5 - row
    bottom = texel(column, row) * (1 - s) + texel(column + 1, row) * s
    top = texel(column, row + 1) * (1 - s) + texel(column + 1, row + 1) * s
    return bottom * (1 - t) + top * t


@pytest.mark.parametrize("is_interpolated", [False, True])
@pytest.mark.parametrize("extension", Extension)
def test_the_eye_sees_through_holes(device, extension, is_interpolated):
    """A card seen from above, its image three times across it: what the picture shows at every pixel, card or floor."""
    size = 96
    uvs = np.array(UVS) * 3 - 1
    step = (np.arange(256) > 127.5).astype(np.float32)
    shown = card(RING, uvs, extension=extension, is_interpolated=is_interpolated, opacity=step)
    camera = camera_from_above((0.0, 0.0), CARD_SIDE_M, size, size)
    scene = snapshot([floor(), shown], [area_light()], camera, size, size)
    instances = seen_instances(scene, device)
    x = (np.arange(size) + 0.5) / size * 3 - 1
    opacity = sampled(RING, *np.meshgrid(x, x), extension, is_interpolated=is_interpolated)
    # texels' edges, and the line along which interpolated ones are half opaque, may fall to either side
    decided = np.abs(opacity - 0.5) > 0.03
    assert decided.mean() > 0.9 and 0.03 < (instances == 1).mean() < 0.95
    assert (instances[decided] == (opacity > 0.5)[decided]).mean() > 0.999


def test_the_eye_sees_the_share_that_is_not_there(device):
    """Of an opacity of 0.3, in any 4 x 4 samples of visibility."""
    size = 64
    scene = snapshot([floor(), pane(0.3)], [area_light()], camera_from_above((0.0, 0.0), 1.0, size, size), size, size)
    offsets = [(x / 3, y / 3) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    scene_data = SceneData(scene, device)
    eye = EyePass(scene_data, compute_bounds(scene), np.array(offsets))
    seen = np.zeros((size, size))
    for index in range(len(offsets)):
        eye.render([index], batch=0)
        seen += device.read(eye.buffers[0].positions)[..., 3] == 1
    eye.release()
    scene_data.release()
    assert abs(seen.mean() / 9 - 0.3) < 0.005
    assert seen.min() >= 1 and seen.max() <= 5


def test_every_rasterization_of_the_eye_has_thresholds_of_its_own(device):
    """In large pictures there is one for each of 32 offsets."""
    size = 64
    scene = snapshot([floor(), pane(0.3)], [area_light()], camera_from_above((0.0, 0.0), 1.0, size, size), size, size)
    scene_data = SceneData(scene, device)
    eye = EyePass(scene_data, compute_bounds(scene), np.zeros((32, 2)), visibility_texel_count=0)
    seen = []
    for index in range(32):
        eye.render([index], batch=0)
        seen.append((device.read(eye.buffers[0].positions)[..., 3] == 1).ravel())
    eye.release()
    scene_data.release()
    # independent ones agree on 0.3^2 + 0.7^2 of the pixels
    agreement = np.mean(np.equal(*np.array(seen)[np.array(np.triu_indices(32, 1))]), axis=-1)
    assert agreement.max() < 0.7
    assert abs(agreement.mean() - 0.58) < 0.02
    assert abs(np.mean(seen) - 0.3) < 0.005


def test_nothing_is_paid_without_opacity_maps(device):
    scene = snapshot([floor()], [area_light()], camera_from_above((0.0, 0.0), 1.0, 8, 8), 8, 8)
    scene_data = SceneData(scene, device)
    assert scene_data.opacity_maps is None
    scene_data.release()


def test_devices_draw_the_same_cut_outs(both):
    """Maps with soft edges, mirrored instances, on a sun and a sphere's cube."""
    soft = np.clip(np.hypot(*(np.indices((32, 32)) - 15.5)) / 8 - 0.5, 0, 1)
    for light in (sun_light(angle_rad=0.1), point_light(eye=(0.3, 0.2, 1.6), radius_m=0.1)):
        scene = seen_from_above([card(soft), card(soft, height_m=0.5, side_m=1.0)], light, 48, 24)
        a, b = (render_pass(scene, device, method=Method.MICRO, view_count=16, map_resolution_px=128) for device in both)
        assert a.std() > 0.1
        assert (np.abs(a - b) > 1e-3).mean() < 0.01
