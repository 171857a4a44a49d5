"""Images in the .blend: exact values, ours only, still there after saving."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.fonts import find_label_font  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.images import find_image, write_images  # noqa: E402
from vir_addon.core.pass_set import PassSet, SetStatistics  # noqa: E402


@pytest.fixture(autouse=True)
def _empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def passes_of(height: int, width: int, *names: str) -> PassSet:
    random = np.random.default_rng(height * width)
    names = names or ("VIR Shadow", "VIR Shadow Key")
    return PassSet({name: random.random((height, width), dtype=np.float32) for name in names}, SetStatistics())


def pixels_of(image) -> np.ndarray:
    """(height, width, 4) float32"""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], -1)


def assert_shows(image, expected: np.ndarray):
    pixels = pixels_of(image)
    for channel in range(3):
        np.testing.assert_array_equal(pixels[..., channel], expected)
    assert (pixels[..., 3] == 1.0).all()


@pytest.mark.parametrize("pack", [True, False])
def test_values_are_exact_and_not_colours(pack):
    passes = passes_of(9, 16)
    images = write_images(passes, pack=pack)
    assert set(images) == {image.name for image in bpy.data.images} == set(passes.images)
    for name, image in images.items():
        assert image.is_float
        assert image.colorspace_settings.name == "Non-Color"
        assert_shows(image, passes.images[name])


def test_a_second_time_fills_the_same_images_in_another_size():
    first = write_images(passes_of(9, 16))
    passes = passes_of(5, 8)
    second = write_images(passes)
    assert first == second
    assert len(bpy.data.images) == 2
    assert_shows(second["VIR Shadow Key"], passes.images["VIR Shadow Key"])


def test_an_artists_image_of_the_same_name_is_left_alone():
    theirs = bpy.data.images.new("VIR Shadow Key", 2, 2)
    before = pixels_of(theirs)
    ours = write_images(passes_of(9, 16))["VIR Shadow Key"]
    assert ours != theirs and ours.name == "VIR Shadow Key.001"
    assert write_images(passes_of(9, 16))["VIR Shadow Key"] == ours
    np.testing.assert_array_equal(pixels_of(theirs), before)
    assert tuple(theirs.size) == (2, 2)


def test_a_copy_that_an_artist_keeps_is_not_the_one_that_is_filled():
    ours = write_images(passes_of(9, 16))["VIR Shadow Key"]
    ours.copy().name = "A kept one"
    assert find_image("VIR Shadow Key") == ours


def test_pictures_survive_saving_though_nothing_uses_them(tmp_path):
    write_images(passes_of(9, 16))
    passes = passes_of(5, 8)
    write_images(passes)
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    for name, expected in passes.images.items():
        assert_shows(find_image(name), expected)
        assert find_image(name).colorspace_settings.name == "Non-Color"


def test_names_as_long_as_blender_keeps():
    name = "VIR Shadow " + "é" * 26
    assert write_images(passes_of(2, 3, name))[name].name == name
    assert find_image(name) is not None


def test_blenders_font_can_write_what_lights_are_called():
    image_font = pytest.importorskip("PIL.ImageFont")
    font = image_font.truetype(str(find_label_font()), size=13)
    missing = bytes(font.getmask("\ufffe"))
    assert all(bytes(font.getmask(character)) != missing for character in "aüßéλЖ光ライト키")
