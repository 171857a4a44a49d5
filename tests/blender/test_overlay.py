"""What is laid over the viewport: light is multiplied and added as the display shows it."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.preview.overlay import Display, Overlay, covered_px  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.core.picture import Picture  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402

SIZE = (4, 2)
BEHIND = (0.4, 0.2, 0.1)


@pytest.fixture(scope="module")
def device():
    if bpy.app.version < (5, 2):
        pytest.skip("before 5.2 Blender has no GPU in background")
    opened = open_device("gpu")
    yield opened
    opened.close()


class Drawn(Picture):
    """Of a single colour."""

    def __init__(self, device, shadows=None, reflections=None) -> None:
        super().__init__(device, *SIZE)
        self.release()
        self.has_shadows, self.has_reflections = shadows is not None, reflections is not None
        self.shadows, self.reflections = (
            device.upload_texture(np.full((*SIZE[::-1], 4), texel or (0.0,) * 4, np.float32)) for texel in (shadows, reflections)
        )


def laid_over(device, picture, display, reference=None) -> np.ndarray:
    """(3,) of every pixel alike"""
    gpu = device.gpu
    offscreen = gpu.types.GPUOffScreen(*SIZE, format="RGBA32F")
    with contextlib.ExitStack() as stack:
        stack.callback(offscreen.free)
        with offscreen.bind():
            framebuffer = gpu.state.active_framebuffer_get()
            framebuffer.clear(color=(*BEHIND, 1.0))
            Overlay().draw(picture, display, reference)
            pixels = np.array(framebuffer.read_color(0, 0, *SIZE, 4, 0, "FLOAT").to_list())[..., :3]
    assert np.ptp(pixels, axis=(0, 1)).max() < 1e-6
    return pixels[0, 0]


SHADOW = (0.3, 1.2, 1.0, 0.0)
"""a quarter of the light arrives"""
MIRROR = (0.25, 0.1, 0.05, 0.5)
"""of half a pixel, multiplied with that"""
ADDED = (0.5, 0.4, 0.3, 0.0)


@pytest.mark.parametrize(
    ("shadows", "reflections", "blended", "alone"),
    [
        (SHADOW, None, np.multiply(BEHIND, 0.25), np.full(3, 0.25)),
        (None, MIRROR, np.multiply(BEHIND, 0.5) + MIRROR[:3], MIRROR[:3]),
        (None, ADDED, np.add(BEHIND, ADDED[:3]), ADDED[:3]),
        (SHADOW, ADDED, np.multiply(BEHIND, 0.25) + ADDED[:3], np.add(0.25, ADDED[:3])),
        ((0.0, 0.0, 0.0, 0.0), None, BEHIND, np.ones(3)),  # background
        ((0.0, 0.0, 1.0, 0.0), None, np.zeros(3), np.zeros(3)),  # turned away from the light
    ],
)
def test_what_it_makes_of_a_picture(device, shadows, reflections, blended, alone):
    picture = Drawn(device, shadows, reflections)
    np.testing.assert_allclose(laid_over(device, picture, Display.MULTIPLY), blended, atol=1e-6)
    np.testing.assert_allclose(laid_over(device, picture, Display.PASS), alone, atol=1e-6)
    np.testing.assert_allclose(laid_over(device, picture, Display.DIFFERENCE), BEHIND, atol=1e-6)


def test_the_difference_to_a_reference(device):
    dark, light = Drawn(device, (0.3, 1.0, 1.0, 0.0)), Drawn(device, (0.7, 1.0, 1.0, 0.0))
    red, _, blue = laid_over(device, light, Display.DIFFERENCE, dark) - BEHIND
    assert red > 0.2 > 0 > blue
    red, _, blue = laid_over(device, dark, Display.DIFFERENCE, light) - BEHIND
    assert blue > 0.2 > 0 > red
    np.testing.assert_allclose(laid_over(device, dark, Display.DIFFERENCE, dark), BEHIND, atol=1e-6)


def test_the_line_begins_beside_what_lies_over_it():
    """Regions as Blender 5.2 has them: a hidden one is a pixel wide; the last operator's panel stands beside the tools."""

    def region(kind, x, y, width, height):
        return SimpleNamespace(type=kind, x=x, y=y, width=width, height=height)

    viewport = region("WINDOW", 2, 95, 1311, 878)
    tools, operator = region("TOOLS", 2, 95, 58, 824), region("HUD", 65, 100, 168, 25)
    hidden, sidebar = region("HUD", 60, 95, 1, 1), region("UI", 1100, 95, 213, 824)
    for regions, reach_px in (
        ([], 0),
        ([viewport, tools, hidden, sidebar], 58),
        ([viewport, tools, operator, sidebar], 231),
        ([viewport, region("TOOLS", 1255, 95, 58, 824)], 0),  # flipped
    ):
        assert covered_px(viewport, regions, 35.0) == reach_px
    # the quarters of a view: the panel lies over the lower left one alone
    for x, y, reach_px in ((2, 95, 231), (660, 95, 0), (2, 540, 58), (660, 540, 0)):
        assert covered_px(region("WINDOW", x, y, 650, 430), [tools, operator], 35.0) == reach_px
