"""The papers' baseline: cubes that are shaded whole, mip-mapped and looked up by direction."""

from __future__ import annotations

import numpy as np
import pytest

from tests.core.test_reflections import HEIGHT, WIDTH, box_colors, camera_rays, colored_box
from tests.scenes import (
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    snapshot,
)
from vir_addon.core.cost import SHADING_NS_PER_TEXEL
from vir_addon.core.errors import UsageError
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.plan import plan
from vir_addon.core.scene import FilterShape, PixelFilter
from vir_addon.core.settings import Effect, ReflectionLookUp, ReflectionMethod, Settings

RADIUS_M = 0.8
WHOLE_PIXELS = PixelFilter(FilterShape.BOX, 1.0)
MVR = {"effects": (Effect.REFLECTION,), "reflection_method": ReflectionMethod.MVR, "bounces": 1, "view_count": 1}


def rendered(scene, device, look_up=ReflectionLookUp.SHADED, sample_count=1, **settings):
    """What is shown, where nothing but reflectors is, and statistics."""
    with prepared_renderer(
        scene, device, reflection_look_up=look_up, reflection_sample_count=sample_count, **{**MVR, **settings}
    ) as renderer:
        render_batches(renderer)
        passes = renderer.read_passes()
        color = passes[REFLECTION_COLOR_PASS_NAME]
        return passes[REFLECTION_PASS_NAME] * color, (color > 0.99).all(axis=-1), renderer


def ball_in_a_box(half_m=3.0, eye=(0.3, -2.6, 0.4)):
    quads, materials = colored_box(half_m)
    ball = bumpy_sphere("ball", (0, 0, 0), RADIUS_M, 64, bump_share=0.0)
    camera = perspective_camera(eye, (0, 0, 0), WIDTH, HEIGHT, 0.4)
    materials = [*materials, mirror()]
    return snapshot([*quads, ball], [], camera, WIDTH, HEIGHT, materials=materials, world=World(), pixel_filter=WHOLE_PIXELS)


def test_a_ball_shows_the_colour_that_lies_in_the_rays_direction(device):
    scene = ball_in_a_box()
    image, shown, renderer = rendered(scene, device, reflection_cube_px=256)
    (cube,) = renderer.reflections.planned.maps
    eye, directions = camera_rays(scene.camera, WIDTH, HEIGHT)
    along = -(directions @ eye)
    passing = np.linalg.norm(eye + along[..., None] * directions, axis=-1)
    normal = (eye + (along - np.sqrt(np.maximum(RADIUS_M**2 - passing**2, 0)))[..., None] * directions) / RADIUS_M
    reflected = directions - 2 * (directions * normal).sum(axis=-1, keepdims=True) * normal
    reflected /= np.linalg.norm(reflected, axis=-1, keepdims=True)
    colors, from_edge_m = box_colors(np.broadcast_to(cube.center_ws, reflected.shape), reflected, 3.0)
    # of rims, where pixels show much, levels are coarse
    turned = np.linalg.norm(np.diff(reflected, axis=1, append=np.nan), axis=-1)
    far = shown & (from_edge_m > 0.6) & (turned < 0.05)
    assert far.sum() > 1000 and len(np.unique(colors[far], axis=0)) > 3
    np.testing.assert_allclose(image[far], colors[far], atol=0.02)


def test_every_texel_that_sees_a_surface_is_shaded(device):
    """Of a closed box all, whoever looks; deferred shading takes as many as there are rays."""
    scene = ball_in_a_box()
    *_, renderer = rendered(scene, device, reflection_cube_px=96)
    found = renderer.statistics.reflections
    assert found.shaded_count == 6 * 96 * 96
    assert 1000 < found.ray_count < WIDTH * HEIGHT
    *_, deferred = rendered(scene, device, ReflectionLookUp.DIRECTION, reflection_cube_px=96)
    assert deferred.statistics.reflections.shaded_count == deferred.statistics.reflections.ray_count == found.ray_count


def test_coarser_levels_are_means_of_finer_ones(device):
    """From far away a pixel of the ball shows much at once, of stripes all around it both colours: one look-up has the mean, one ray one of
    them."""
    count, width, height = 64, 40, 22
    angles = 2 * np.pi * np.arange(count + 1) / count
    corners = 40.0 * np.stack([np.cos(angles), np.sin(angles), np.full(count + 1, -1.0)], axis=-1)
    stripes = [rectangle(f"stripe {k}", corners[k], corners[k + 1] - corners[k], (0, 0, 80)) for k in range(count)]
    ball = bumpy_sphere("ball", (0, 0, 0), 1.0, 96, bump_share=0.0)
    camera = perspective_camera((2.0, -30.0, 3.0), (0, 0, 0), width, height, 0.06)
    materials = [*[matte((0, 0, 0), (k % 2,) * 3) for k in range(count)], mirror()]
    scene = snapshot([*stripes, ball], [], camera, width, height, materials=materials, world=World(), pixel_filter=WHOLE_PIXELS)
    truth, shown, _ = rendered(scene, device, ReflectionLookUp.DIRECTION, 256, reflection_cube_px=256)
    filtered, also_shown, _ = rendered(scene, device, reflection_cube_px=256)
    single, *_ = rendered(scene, device, ReflectionLookUp.DIRECTION, reflection_cube_px=256)
    shown &= also_shown

    def rms(image):
        return np.sqrt(((image - truth)[shown] ** 2).mean())

    assert shown.sum() > 50
    assert rms(filtered) < 0.6 * rms(single)
    np.testing.assert_allclose(filtered[shown].mean(axis=0), truth[shown].mean(axis=0), atol=0.05)


def test_lights_and_shadows_are_on_texels_as_on_what_rays_meet(device):
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 0.6), 0.5, 48, bump_share=0.0), bumpy_sphere("other", (1.2, -0.6, 0.4), 0.4, 24)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.5), WIDTH, HEIGHT, 0.3)
    lights = [point_light(eye=(1, -2, 3), radius_m=0.0, strength=100.0)]
    materials = [matte((0.8, 0.8, 0.8)), mirror(), matte((0.7, 0.3, 0.2), (0.0, 0.1, 0.0))]
    scene = snapshot(meshes, lights, camera, WIDTH, HEIGHT, materials=materials, world=World((0.2, 0.2, 0.3)), pixel_filter=WHOLE_PIXELS)
    expected, shown, _ = rendered(scene, device, ReflectionLookUp.DIRECTION, 32, reflection_cube_px=256)
    image, *_ = rendered(scene, device, sample_count=2, reflection_cube_px=256)
    error = np.abs(image - expected)[shown]
    assert expected[shown].mean() > 0.1
    assert np.median(error) < 0.02 * expected[shown].mean()
    np.testing.assert_allclose(image[shown].mean(axis=0), expected[shown].mean(axis=0), rtol=0.03)


def test_what_is_kept_of_texels_counts_in_the_memory_of_maps(device):
    meshes = [floor(4.0), *(bumpy_sphere(f"ball {k}", (k - 1.0, 0, 0.6), 0.4, 24, bump_share=0.0) for k in range(3))]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.5), WIDTH, HEIGHT, 0.3)
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[matte((0.8, 0.8, 0.8)), *[mirror()] * 3], world=World())
    taken = {}
    for look_up in (ReflectionLookUp.SHADED, ReflectionLookUp.DIRECTION):
        *_, renderer = rendered(scene, device, look_up, reflection_cube_px=128, reflection_map_mib=20)
        found = taken[look_up] = renderer.statistics.reflections
        assert found.map_bytes <= 20 << 20
    assert taken[ReflectionLookUp.SHADED].map_texel_count < taken[ReflectionLookUp.DIRECTION].map_texel_count
    assert taken[ReflectionLookUp.SHADED].map_bytes == 176 * taken[ReflectionLookUp.SHADED].map_texel_count


def test_shaded_cubes_show_one_bounce_and_flat_mirrors_have_them_too():
    with pytest.raises(UsageError, match="shaded cubes show one bounce, not 2"):
        Settings(effects=(Effect.REFLECTION,), reflection_look_up=ReflectionLookUp.SHADED, bounces=2)
    settings = Settings(effects=(Effect.REFLECTION,), reflection_look_up=ReflectionLookUp.SHADED, reflection_sample_count=8)
    meshes = [floor(1.0), bumpy_sphere("ball", (0, 0, 0.6), 0.5, 24), bumpy_sphere("other", (1.2, 0, 0.6), 0.5, 24)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.5), WIDTH, HEIGHT, 0.3)
    chosen = plan(snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[mirror()] * 3, world=World()), settings)
    assert chosen.reflections.bounces == 1 and all(each.is_cube for each in chosen.reflections.maps)
    assert (chosen.batch_count, chosen.eye_samples_per_batch) == (8, 1)


def test_plans_count_the_shading_of_every_texel_in_every_round():
    scene = ball_in_a_box()
    predicted = {}
    for look_up in (ReflectionLookUp.MARCH, ReflectionLookUp.DIRECTION, ReflectionLookUp.SHADED):
        for count in (1, 4):
            settings = Settings(reflection_look_up=look_up, reflection_sample_count=count, **MVR)
            predicted[look_up, count] = plan(scene, settings).reflections.predicted_ms
    assert predicted[ReflectionLookUp.DIRECTION, 1] == predicted[ReflectionLookUp.MARCH, 1]
    texels = sum(each.texel_count for each in plan(scene, settings).reflections.maps)
    more_ms = predicted[ReflectionLookUp.SHADED, 4] - predicted[ReflectionLookUp.SHADED, 1]
    assert more_ms > 3 * texels * SHADING_NS_PER_TEXEL * 1e-6
    # and of no ray that is followed
    assert more_ms < 3.5 * texels * SHADING_NS_PER_TEXEL * 1e-6
