"""Both devices show the same in mirrors."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scenes import bumpy_sphere, floor, matte, mirror, perspective_camera, point_light, render_passes, snapshot
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.settings import Effect, ReflectionMethod


@pytest.mark.parametrize("method", [ReflectionMethod.MVR, ReflectionMethod.IVIR, ReflectionMethod.EPR])
def test_reflections_are_the_same_on_both_devices(both, method):
    """Rays, maps and materials: a mirror ball over a lit floor before the world's grey, and a ball of small triangles."""
    ball = bumpy_sphere("ball", (0, 0, 0.8), 0.7, 24, bump_share=0.0)
    camera = perspective_camera((0.5, -3.0, 1.6), (0, 0, 0.7), 64, 36, 0.6)
    fine = bumpy_sphere("fine", (0.2, -1.5, 0.3), 0.3, 60)
    materials = [matte((0.7, 0.5, 0.3)), mirror(), matte((0.2, 0.8, 0.4))]
    meshes = [floor(4.0), ball, fine]
    light = point_light(eye=(1, -1, 3), radius_m=0.0)
    scene = snapshot(meshes, [light], camera, 64, 36, materials=materials, world=World((0.2, 0.2, 0.2)))
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 4, "bounces": 1, "reflection_method": method}
    images = [render_passes(scene, device, **settings) for device in both]
    for name in (REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME):
        assert images[0][name].max() > 0.1
        differs = np.abs(images[0][name] - images[1][name]).max(axis=-1) > 1e-3 * images[0][name].max()
        # an edge that a ray meets, or passes by, in the last place of float32
        assert differs.mean() < 0.005
