"""Reflections of a room against Cycles in the same module."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from demo_scenes import mirror_room  # noqa: E402  (bpy decides whether this file runs)
from tests import cycles_reflections  # noqa: E402
from vir_addon.blender.job import frame_jobs, run  # noqa: E402
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME  # noqa: E402
from vir_addon.core.preview import encode_srgb  # noqa: E402
from vir_addon.core.settings import Effect, ReflectionLookUp, Settings  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402

RESOLUTION = (128, 72)


def displayed(image):
    return encode_srgb(image).astype(np.float64) / 255


def errors(scene, look_ups, device):
    """Display-referred RMSE on pixels that reflect, of every way of looking up, and of the reflection's colour."""
    images = {}
    for look_up in look_ups:
        settings = Settings(effects=(Effect.REFLECTION,), bounces=1, reflection_look_up=look_up, view_count=16)
        (job,) = frame_jobs(scene, 1, settings, RESOLUTION).values()
        images[look_up] = run(job, device).images
    reflection, color = cycles_reflections.render(scene, RESOLUTION, samples=64, bounces=1)
    truth = displayed(reflection * color)
    first = images[look_ups[0]][REFLECTION_COLOR_PASS_NAME]
    both = (color.max(axis=-1) > 0.05) & (first.max(axis=-1) > 0.05)
    assert both.mean() > 0.1
    found = {
        look_up: displayed(shown[REFLECTION_PASS_NAME] * shown[REFLECTION_COLOR_PASS_NAME])[both] - truth[both]
        for look_up, shown in images.items()
    }
    return {look_up: float(np.sqrt((error**2).mean())) for look_up, error in found.items()}, first[both], color[both]


@pytest.fixture(scope="module")
def device():
    opened = open_device("moderngl")
    yield opened
    opened.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "roughness", "limit"), [("sphere", 0.0, 0.06), ("column", 0.0, 0.06), ("flat", 0.0, 0.04), ("sphere", 0.2, 0.05)]
)
def test_a_mirror_in_a_room(device, shape, roughness, limit):
    """Marched through depth, at most half as far off as looked up by direction, where things are near; a flat mirror is right either way,
    and what is rough shows no places."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mirror_room.build(scene, roughness=roughness, shape=shape)
    is_near = shape != "flat" and roughness == 0
    look_ups = [ReflectionLookUp.MARCH, ReflectionLookUp.DIRECTION] if is_near else [ReflectionLookUp.MARCH]
    rmse, own_color, color = errors(scene, look_ups, device)
    print(shape, roughness, rmse)
    assert rmse[ReflectionLookUp.MARCH] < limit
    assert np.abs(np.median(own_color - color, axis=0)).max() < 0.01
    if is_near:
        assert rmse[ReflectionLookUp.MARCH] < 0.5 * rmse[ReflectionLookUp.DIRECTION]


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "limit"), [("sphere", 0.06), ("flat", 0.04)])
def test_highlights_on_what_a_mirror_shows(device, shape, limit):
    """What they amount to: from Cycles' picture without them the flat mirror's differs by 0.1."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mirror_room.build(bpy.context.scene, shape=shape, has_gloss=True)
    rmse, _, _ = errors(bpy.context.scene, [ReflectionLookUp.MARCH], device)
    print(shape, rmse)
    assert rmse[ReflectionLookUp.MARCH] < limit
