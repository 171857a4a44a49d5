"""The report: valid pictures, everything the statistics say, nothing that a name could break."""

import base64
import io
import re

import numpy as np
import pytest

from vir_addon.analysis.report_page import PICTURE_WIDTH_PX, encode_png, report_page
from vir_addon.core.pass_set import PassStatistics, SetStatistics

pillow = pytest.importorskip("PIL.Image")


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 1)])
def test_pictures_are_what_another_reader_sees(shape):
    pixels = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    np.testing.assert_array_equal(np.asarray(pillow.open(io.BytesIO(encode_png(pixels)))), pixels)


def page(**statistics) -> str:
    made = PassStatistics("VIR Shadow Key", "Key", "micro", "0.1 m rectangle", view_count=64, map_resolution_px=1024, error_estimate=0.0123)
    made.stage_ms["resolve"] = 1500.0
    skipped = PassStatistics("VIR Shadow Fill", "Fill <b>", "none", "skipped: casts no shadow", error_estimate=float("inf"))
    layers = {"ViewLayer": SetStatistics(passes=[made, skipped], **statistics)}
    lit_below = np.zeros((300, 2 * PICTURE_WIDTH_PX), np.float32)
    lit_below[:150] = 1.0
    return report_page("Scene & frame 1", layers, {"VIR Shadow Key": lit_below})


def test_it_says_what_the_statistics_say():
    text = page(notes=["motion blur is on"], left_out=["Smoke: a volume"])
    for words in ("64", "1024 px", "0.0123", "1.50", "skipped: casts no shadow", "motion blur is on", "Smoke: a volume"):
        assert words in text
    assert "inf" not in text


def test_names_are_text():
    assert "<b>" not in page() and "Fill &lt;b&gt;" in page() and "Scene &amp; frame 1" in page()


def test_pictures_stand_upright_and_fit():
    data = base64.b64decode(re.search(r"base64,([^\"]+)", page())[1])
    picture = np.asarray(pillow.open(io.BytesIO(data)))
    assert picture.shape == (150, PICTURE_WIDTH_PX)
    assert (picture[:75] == 0).all() and (picture[75:] == 255).all()
