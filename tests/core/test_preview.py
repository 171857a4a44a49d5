"""Previews: values a viewer shows right, the right way up, under names every file system takes."""

import os
import sys

import numpy as np
import pytest

from vir_addon.core.errors import UsageError
from vir_addon.core.pass_set import PassSet, PassStatistics, SetStatistics
from vir_addon.core.preview import SHEET_WIDTH_PX, contact_sheet, encode_srgb, write_previews

Image = pytest.importorskip("PIL.Image")


def passes_of(names: list[str], height: int = 4, width: int = 6) -> PassSet:
    image = np.zeros((height, width), np.float32)
    image[0] = 1.0  # the bottom row
    return PassSet(dict.fromkeys(names, image), SetStatistics())


def test_srgb_curve_at_values_of_the_standard():
    linear = np.array([[0.0, 0.0031308, 0.2140411, 0.5, 1.0, 1.5, -0.5, np.nan]], np.float32)
    np.testing.assert_array_equal(encode_srgb(linear), [[0, 10, 127, 188, 255, 255, 0, 0]])


def test_pictures_are_the_right_way_up_and_say_their_encoding(tmp_path):
    paths = write_previews(tmp_path, "shot_0001", passes_of(["VIR Shadow", "VIR Shadow Key"]))
    assert [path.name for path in paths] == [
        "shot_0001_VIR_Shadow.png",
        "shot_0001_VIR_Shadow_Key.png",
        "shot_0001_contact_sheet.png",
    ]
    with Image.open(paths[1]) as picture:
        pixels = np.asarray(picture)
        assert picture.info["srgb"] == 0
        assert picture.info["Title"] == "VIR Shadow Key"
    assert (pixels[-1] == 255).all() and (pixels[:-1] == 0).all()
    assert sorted(os.listdir(tmp_path)) == sorted(path.name for path in paths)


def test_file_names_differ_on_every_file_system(tmp_path):
    paths = write_previews(tmp_path, "s", passes_of(["VIR Shadow a/b", "VIR Shadow A:b", "VIR Shadow 光"]))
    assert len({path.name.casefold() for path in paths}) == 4
    assert all(path.exists() for path in paths)


def test_previews_keep_the_name_of_their_file(tmp_path):
    paths = write_previews(tmp_path, "é 日本_0001", passes_of(["VIR Shadow"]))
    assert [path.name for path in paths] == ["é 日本_0001_VIR_Shadow.png", "é 日本_0001_contact_sheet.png"]


def test_contact_sheet_shows_every_pass_and_stays_in_its_width():
    passes = passes_of([f"VIR Shadow light {index} with a name that is longer than its picture" for index in range(5)], 270, 480)
    passes.statistics.passes = [PassStatistics("VIR Shadow light 0", "light 0", "mvr", "", view_count=64)]
    sheet = np.asarray(contact_sheet(passes))
    assert sheet.shape[1] <= SHEET_WIDTH_PX
    # Every one of the five pictures has its white bottom row.
    white_rows = (sheet == 255).sum(axis=1)
    assert sorted(white_rows[white_rows > 400]) == [960, 1440]


def test_one_pixel_and_many_passes():
    assert contact_sheet(passes_of(["VIR Shadow"], 1, 1)).size[0] > 0
    assert contact_sheet(passes_of([f"VIR Shadow {index}" for index in range(400)], 90, 160)).size[0] <= SHEET_WIDTH_PX


def test_missing_pillow_and_missing_passes_are_said(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match="no pass"):
        write_previews(tmp_path, "s", passes_of([]))
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(UsageError, match="pip install pillow"):
        write_previews(tmp_path, "s", passes_of(["VIR Shadow"]))
    assert os.listdir(tmp_path) == []
