"""Points against rasterized triangles on a head of which much is grazed by the light."""

import numpy as np
import pytest

from tests.benchmarks.head_scene import MILLION_TRIANGLES_LEVEL, build_head_scene
from vir_addon.blender.job import frame_jobs, run
from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device


@pytest.mark.parametrize(
    ("level", "size_px"),
    [
        (3, (240, 135)),
        pytest.param(MILLION_TRIANGLES_LEVEL, (480, 270), marks=pytest.mark.slow),
    ],
)
def test_points_agree_with_multiview_rasterization(level, size_px):
    """Over all pixels, those too where a quotient of two tiny sums is what is left at the end of the head's light."""
    scene = build_head_scene(level)
    scene.render.resolution_x, scene.render.resolution_y = size_px
    scene.render.resolution_percentage = 100
    images = []
    for method in (Method.MVR, Method.IVIR):
        (job,) = frame_jobs(scene, 1, Settings(method=method, view_count=64)).values()
        device = open_device("moderngl")
        try:
            images.append(run(job, device).images[shadow_pass_name("Key")])
        finally:
            device.close()
    truth, points = images
    error = np.sqrt(np.mean((points - truth) ** 2))
    print(f"level {level}: RMSE {error:.5f}")
    assert ((truth > 0.02) & (truth < 0.98)).mean() > 0.1
    assert error <= 0.01
