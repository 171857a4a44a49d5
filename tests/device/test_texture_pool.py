"""Released textures come back to whoever asks for their size, and what they were left with shows nowhere."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.scenes import METHODS_AND_HYBRID, area_light, bumpy_sphere, floor, perspective_camera, point_light, render_passes, snapshot
from vir_addon.device.interface import TextureFormat
from vir_addon.device.texture_pool import TexturePool

SMALL, LARGE = (16, 16, TextureFormat.R32UI), (64, 16, TextureFormat.RGBA32F)
SMALL_BYTES, LARGE_BYTES = 16 * 16 * 4, 64 * 16 * 16
WIDTH, HEIGHT = 48, 27


@dataclass
class CountedHandle:
    releases: list["CountedHandle"] = field(default_factory=list)

    def release(self):
        self.releases.append(self)


def test_a_texture_comes_back_once_and_only_for_its_size():
    pool, handle = TexturePool(LARGE_BYTES), CountedHandle()
    pool.keep(LARGE, handle)
    assert pool.unused_bytes == LARGE_BYTES
    assert pool.take(SMALL) is None
    assert pool.take((16, 64, TextureFormat.RGBA32F)) is None
    assert pool.take((64, 16, TextureFormat.DEPTH32F)) is None
    assert pool.take(LARGE) is handle
    assert pool.take(LARGE) is None
    assert pool.unused_bytes == 0
    assert not handle.releases


def test_the_latest_comes_back_first_and_the_oldest_goes_first():
    released = []
    handles = [CountedHandle(released) for _ in range(4)]
    pool = TexturePool(2 * SMALL_BYTES)
    for handle in handles:
        pool.keep(SMALL, handle)
    assert released == handles[:2]
    assert pool.unused_bytes == 2 * SMALL_BYTES
    assert pool.take(SMALL) is handles[3]


def test_what_is_larger_than_the_pool_is_not_kept():
    pool, handle = TexturePool(LARGE_BYTES - 1), CountedHandle()
    pool.keep(LARGE, handle)
    assert handle.releases == [handle]
    assert pool.unused_bytes == 0


@pytest.mark.parametrize("name", ["moderngl", "gpu"])
def test_a_texture_released_twice_is_not_given_to_two(device_called, name):
    device = device_called(name)
    texture = device.create_texture(24, 24, TextureFormat.RGBA32F)
    texture.release()
    texture.release()
    ones, twos = (device.upload_texture(np.full((24, 24, 4), value, np.float32)) for value in (1, 2))
    np.testing.assert_array_equal(device.read(ones), 1)
    np.testing.assert_array_equal(device.read(twos), 2)
    ones.release()
    twos.release()


@pytest.mark.parametrize("method", METHODS_AND_HYBRID)
def test_what_was_left_in_textures_shows_nowhere(device_called, monkeypatch, method):
    device = device_called("moderngl")
    lights = [area_light("Key", (1.5, -1.0, 3.0)), point_light("Lamp", (-1.0, -1.0, 2.0))]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    scene = snapshot([floor(6.0), bumpy_sphere("ball", (0.0, 0.0, 0.8), 0.6, 60)], lights, camera, WIDTH, HEIGHT)
    expected = render_passes(scene, device, method=method, view_count=32, map_resolution_px=256)
    keep = TexturePool.keep

    def keep_with_litter(pool, size, handle):
        width, height, texture_format = size
        handle.write(np.full(width * height * texture_format.channel_count, 0.25, np.float32))
        keep(pool, size, handle)

    monkeypatch.setattr(TexturePool, "keep", keep_with_litter)
    for _ in range(2):
        passes = render_passes(scene, device, method=method, view_count=32, map_resolution_px=256)
    for name, image in expected.items():
        np.testing.assert_array_equal(passes[name], image, err_msg=name)
