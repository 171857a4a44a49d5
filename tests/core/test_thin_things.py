"""Things that are thinner than what is looked at before views are fitted: no map was made for them, and yet they are lit."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import area_light, box, looking, point_light, rectangle, render_pass, render_passes, snapshot, sun_light
from vir_addon.core import light_work, reach
from vir_addon.core.scene import Camera, PixelFilter
from vir_addon.core.settings import Method

WIDTH, HEIGHT = 96, 54
MOST = 1 << 17
"""pixels that are looked at: all of them"""
LIGHTS = {
    "area": area_light(eye=(20, 5, 0), target=(0, 6, 0), size_m=(0.3, 0.3)),
    "point": point_light(eye=(20, 5, 0), radius_m=0.1),
    "sun": sun_light(eye=(20, 5, 0), target=(0, 6, 0), angle_rad=0.01),
}
SETTINGS = {"method": Method.MVR, "view_count": 16, "map_resolution_px": 256}


def thin_rod(width_px, offset_px, lights, meshes=()):
    """Upright before a wall in the shadow of a board that leaves the rod in the light; one of its edges towards the eye. meshes: that the
    camera does not see"""
    px = 8 / WIDTH
    half = width_px * px / np.sqrt(8)
    turn = np.array([[1, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
    rod = box("rod", (0, 0, 0), (half, half, 2.0))
    rod = dataclasses.replace(rod, positions_os=(rod.positions_os @ turn.T + (offset_px * px, 2, 0)).astype(np.float32))
    wall, board = rectangle("wall", (-4, 10, -2.25), (8, 0, 0), (0, 0, 4.5)), box("board", (12, 8, 0), (0.05, 2.2, 6))
    camera = Camera("Camera", True, looking((0, -20, 0), (0, 0, 0)), (-4, 4, -2.25, 2.25), 0.01, 500.0)
    is_seen = [True] * 3 + [False] * len(meshes)
    return snapshot([wall, board, rod, *meshes], lights, camera, WIDTH, HEIGHT, visible_to_camera=is_seen, pixel_filter=PixelFilter())


@pytest.mark.parametrize(
    ("width_px", "offset_px", "looked_at_px"),
    [(0.6, 0.5, MOST), (0.3, 0.25, MOST), (1.4, 2.0, 324), (2.0, 2.0, 324)],
)
@pytest.mark.parametrize("light", LIGHTS)
def test_what_is_not_looked_at_first_is_lit_before_the_dark(device, monkeypatch, light, width_px, offset_px, looked_at_px):
    """Views are fitted to some pixels of the first eye sample. Nothing tells of a rod between these; all of the wall is known, and dark."""
    scene = thin_rod(width_px, offset_px, [LIGHTS[light]])
    monkeypatch.setattr(reach, "MAX_RECEIVER_PIXELS", looked_at_px)
    image = render_pass(scene, device, **SETTINGS)

    def knowing_the_rod(*arguments):
        receivers = reach.select_receivers(*arguments)
        return dataclasses.replace(receivers, points_ws=np.concatenate([receivers.points_ws, scene.meshes[2].positions_os]))

    monkeypatch.setattr(light_work, "select_receivers", knowing_the_rod)
    known = render_pass(scene, device, **SETTINGS)
    assert known.max() > 0.5
    np.testing.assert_allclose(image, known, atol=0.03)


def test_lights_weigh_what_is_not_looked_at_first_in_all_lights_pass_as_well(device):
    """One reaches the rod, another, with a board before it that the camera does not see, nothing."""
    other = sun_light("B", eye=(0, -30, 0), target=(0, 0, 0), angle_rad=0.01)
    shade = rectangle("shade", (-6, -10, -4), (12, 0, 0), (0, 0, 8))
    scene = thin_rod(0.3, 0.25, [dataclasses.replace(LIGHTS["sun"], name="A"), other], [shade])
    passes = render_passes(scene, device, **SETTINGS)
    a, b, both = (passes[name] for name in ("VIR Shadow A", "VIR Shadow B", "VIR Shadow"))
    assert a.max() > 0.5 and b.max() == 0
    assert (both[a > 0.5] > 0.03).all()
