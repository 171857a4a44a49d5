"""Passes and preview where Blender draws with Vulkan; without a driver for it Blender takes OpenGL, and says so here."""

import importlib
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
import gpu
import numpy as np
from driver import MODULE, Steps, run, screenshot, view, wait_until


def made_with(device: str) -> np.ndarray:
    bpy.context.scene.vir.device = device
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render()
    return np.array(bpy.data.images["VIR Shadow"].pixels[:])


def steps() -> Steps:
    print(f"{gpu.platform.backend_type_get()}, {gpu.platform.renderer_get()}", flush=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 0, -1))
    bpy.data.objects["Light"].data.shadow_soft_size = 0.5
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 90, 100
    scene.vir.view_count, scene.vir.map_resolution_px = 8, 128
    view()["space_data"].region_3d.view_perspective = "CAMERA"
    yield 1.0
    difference = np.abs(made_with("MODERNGL") - made_with("GPU"))
    print(f"both devices differ by {difference.mean():.1e}, at most {difference.max():.1e}", flush=True)
    assert difference.mean() < 1e-3

    running = importlib.import_module(f"{MODULE}.vir_addon.blender.preview.running")
    viewports = running._running.viewports
    scene.vir.use_preview, scene.vir.preview_display = True, "DIFFERENCE"
    yield 0.5
    yield from wait_until(lambda: viewports and not any(one.is_busy for one in viewports.values()), "the preview is done", 400)
    bpy.data.objects["Light"].location.y = -3.0
    yield 0.5
    yield from wait_until(lambda: not any(one.is_busy for one in viewports.values()), "the light has moved", 400)
    (shown,) = viewports.values()
    print(running.status_text(shown), flush=True)
    assert not shown.problem and shown.preview.picture is not None and shown.preview.reference is not None
    yield from screenshot("1_difference")
    scene.vir.use_preview = False
    yield from wait_until(lambda: not running._running.viewports, "off")


run(steps)
