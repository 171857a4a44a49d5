"""A small scene with a preview, and what the installed extension is doing with it. Modules are asked for anew: they are others after the
extension was disabled and enabled."""

import importlib

import bpy
from driver import MODULE, Steps, wait_until


def blender_side(name: str):
    return importlib.import_module(f"{MODULE}.vir_addon.blender.{name}")


def is_rendering() -> bool:
    # Blender keeps a place for one whose class is gone until the window gets its next event
    running = filter(None, bpy.context.window_manager.windows[0].modal_operators)
    return any(operator.bl_idname == "VIR_OT_render" for operator in running)


def passes() -> list[str]:
    return sorted(image.name for image in bpy.data.images if image.get("vir_pass"))


def shown() -> list:
    return list(blender_side("preview.running")._running.viewports.values())


def finish(what: str, count: int = 1) -> Steps:
    """Until every viewport shows the whole picture of what it looks at. count: viewports that have a preview"""
    yield 0.5
    yield from wait_until(lambda: len(shown()) == count and not any(one.is_busy for one in shown()), what, 400)
    for one in shown():
        print(f"{what}: {blender_side('preview.running').status_text(one)}", flush=True)
        assert not one.problem and one.preview.picture is not None


def make_scene() -> None:
    """Blender's cube and light, softer, on a floor; few views and a small picture."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 0, -1))
    bpy.data.objects["Light"].data.shadow_soft_size = 0.5
    scene.vir.view_count, scene.vir.map_resolution_px = 16, 256
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 480, 270, 100
    scene.render.engine = "BLENDER_WORKBENCH"
    bpy.ops.object.select_all(action="DESELECT")
