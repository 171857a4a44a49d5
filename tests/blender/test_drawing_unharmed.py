"""Blender's own drawing of a viewport is the same picture, to the last bit, before and after a render of ours."""

import contextlib
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.job import frame_jobs, run  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.core.progressive import ProgressiveRender  # noqa: E402
from vir_addon.core.settings import Settings  # noqa: E402
from vir_addon.device.open import DEVICE_NAMES, open_device  # noqa: E402

SIZE = (160, 90)
SETTLED_S = 2.0
SETTINGS = Settings(view_count=8, map_resolution_px=128)


@pytest.fixture(scope="module")
def gpu():
    if bpy.app.version < (5, 2):
        pytest.skip("before 5.2 Blender has no GPU in background")
    open_device("gpu").close()
    import gpu

    return gpu


@pytest.fixture
def still_life(scene, add):
    scene.camera.location.z, scene.camera.rotation_euler.x = 3.0, 1.3
    add.mesh("Floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    add.cube("Cube", location=(0, 0, 1))
    add.light("Key", location=(1, -1, 5), data={"size": 1.0})
    return scene


def draw_viewport(gpu, scene, shading: str) -> np.ndarray:
    """(height, width, 4) uint8 of what Blender draws from the scene's camera."""
    screen = bpy.context.window_manager.windows[0].screen
    area = next(area for area in screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    area.spaces.active.shading.type = shading
    camera, depsgraph = scene.camera, bpy.context.evaluated_depsgraph_get()
    matrices = camera.matrix_world.inverted(), camera.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1])
    offscreen = gpu.types.GPUOffScreen(*SIZE)
    try:
        offscreen.draw_view3d(scene, bpy.context.view_layer, area.spaces.active, region, *matrices, do_color_management=True)
        with offscreen.bind():
            pixels = gpu.state.active_framebuffer_get().read_color(0, 0, *SIZE, 4, 0, "UBYTE")
        return np.array(pixels.to_list(), np.uint8)
    finally:
        offscreen.free()


def draw_settled_viewport(gpu, scene, shading: str) -> np.ndarray:
    """As above, once that has stayed the same for a while: Blender compiles shaders in the background and leaves out what needs them."""
    before, same_since_s = draw_viewport(gpu, scene, shading), time.monotonic()
    while time.monotonic() - same_since_s < SETTLED_S:
        before, last = draw_viewport(gpu, scene, shading), before
        if not np.array_equal(before, last):
            same_since_s = time.monotonic()
    return before


@pytest.mark.parametrize("shading", ["WIREFRAME", "SOLID"])
@pytest.mark.parametrize("device_name", DEVICE_NAMES)
def test_a_render_changes_no_pixel_of_blenders(gpu, still_life, shading, device_name):
    before = draw_settled_viewport(gpu, still_life, shading)
    assert before[..., :3].std() > 10
    (job,) = frame_jobs(still_life, 1, SETTINGS, (64, 36)).values()
    with contextlib.closing(open_device(device_name)) as device:
        run(job, device)
        np.testing.assert_array_equal(draw_viewport(gpu, still_life, shading), before)
        # slice by slice as in a viewport, with Blender's drawing between
        with ThreadPoolExecutor(1) as executor, contextlib.closing(ProgressiveRender(device, executor)) as progressive:
            progressive.show(job.snapshot, SETTINGS)
            slices = 0
            while not progressive.is_done:
                progressive.advance(0.005)
                slices += 1
                if slices % 8 == 0:
                    np.testing.assert_array_equal(draw_viewport(gpu, still_life, shading), before)
    np.testing.assert_array_equal(draw_viewport(gpu, still_life, shading), before)
