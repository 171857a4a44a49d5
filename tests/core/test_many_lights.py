"""Many lights in one scene: memory does not grow with what each would keep for itself."""

import contextlib

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    bumpy_sphere,
    floor,
    perspective_camera,
    point_light,
    prepared_renderer,
    render_passes,
    snapshot,
    spot_light,
    sun_light,
)
from vir_addon.core.errors import UsageError
from vir_addon.core.plan import check_device, plan
from vir_addon.core.settings import Method, Settings

WIDTH, HEIGHT = 48, 27


def scene_with(lights):
    meshes = [floor(6.0), bumpy_sphere("ball", (0.0, 0.0, 0.8), 0.6, 60), bumpy_sphere("other", (1.5, 0.5, 0.6), 0.5, 60)]
    return snapshot(meshes, lights, perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT), WIDTH, HEIGHT)


def ring_of_lights(count):
    kinds = (area_light, point_light, spot_light, sun_light)
    for index in range(count):
        angle = 2 * np.pi * index / count
        yield kinds[index % 4](f"Light {index:02}", (3 * np.cos(angle), 3 * np.sin(angle), 4.0))


@contextlib.contextmanager
def live_bytes(device, monkeypatch):
    """Yields a function: bytes of textures that were made since and not released."""
    live = {}

    def counting(make):
        def made(*arguments):
            texture = make(*arguments)
            live[id(texture)] = (texture, texture.byte_count)
            release = texture.release

            def released():
                live.pop(id(texture), None)
                release()

            texture.release = released
            return texture

        return made

    for name in ("create_texture", "upload_texture"):
        monkeypatch.setattr(device, name, counting(getattr(device, name)))
    yield lambda: sum(size for _, size in live.values())
    monkeypatch.undo()


def peak_bytes(device, monkeypatch, light_count, **settings):
    with (
        live_bytes(device, monkeypatch) as live,
        prepared_renderer(scene_with(list(ring_of_lights(light_count))), device, **settings) as made,
    ):
        peak = live()
        for batch in range(2):
            device.run(made.render_batch, batch)
            peak = max(peak, live())
    return peak


@pytest.mark.parametrize(
    "method", [Method.MVR, Method.MICRO, *(pytest.param(each, marks=pytest.mark.slow) for each in (Method.IVIR, Method.HYBRID))]
)
def test_forty_lights_take_little_more_memory_than_eight(device, monkeypatch, method):
    arguments = {"method": method, "view_count": 16, "map_resolution_px": 128, "replay_buffer_mib": 16}
    few, many = (peak_bytes(device, monkeypatch, count, **arguments) for count in (8, 40))
    per_light = 32 * WIDTH * HEIGHT
    # sums of each pixel, a table of work groups for each face
    assert many - few <= 32 * (per_light + 6 * 16 * 4096) + (1 << 20)
    assert many < 80 << 20


def test_points_made_again_are_the_same(device):
    scene = scene_with(list(ring_of_lights(8)))
    arguments = {"method": Method.IVIR, "view_count": 16, "map_resolution_px": 128, "cull_hidden": False}
    kept, again = (render_passes(scene, device, replay_buffer_mib=mib, **arguments) for mib in (256, 5))
    for name, image in kept.items():
        np.testing.assert_array_equal(again[name], image)


def test_lights_that_need_no_map_get_none(device, monkeypatch):
    """Nor does the device have to be able to make it."""
    monkeypatch.setattr("vir_addon.core.light_work.DepthMaps", None)
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    scene = snapshot([floor(6.0)], [point_light("Bulb", (1.0, 0.0, 3.0)), sun_light("Sun")], camera, WIDTH, HEIGHT)
    passes = render_passes(scene, device, view_count=16, map_resolution_px=128)
    assert len(passes) == 3 and all(image.min() == 1.0 for image in passes.values())
    monkeypatch.setattr(device, "max_texture_size_px", 1024)
    check_device(plan(scene, Settings(view_count=64, map_resolution_px=8192)), device)
    with pytest.raises(UsageError, match="largest texture"):
        check_device(plan(scene_with(list(ring_of_lights(4))), Settings(view_count=64, map_resolution_px=8192)), device)
