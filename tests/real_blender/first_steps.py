"""From the zip to passes in the compositor, with real clicks: install, plan, preset, render, cancel, compose, undo."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
from driver import FOLDER, MODULE, SCENE, ZIP, Steps, click_button, drop_file, press, run, screenshot, show_panel, view, wait_until
from previewing import is_rendering, passes


def state() -> dict:
    handlers = {name: len(found) for name in dir(bpy.app.handlers) if isinstance(found := getattr(bpy.app.handlers, name), list)}
    return {
        "handlers": handlers,
        "classes": {name for name in dir(bpy.types) if "VIR" in name},
        "properties": {kind: "vir" in getattr(bpy.types, kind).bl_rna.properties for kind in ("Scene", "Light", "Object")},
        "threads": {thread.name for thread in __import__("threading").enumerate() if "vir" in thread.name},
    }


def begin_render(near: tuple[int, int] | None = None) -> Iterator[float]:
    """Press the button; returns where it was. A small render may be over before anybody looks, so beginnings are counted."""
    operator = importlib.import_module(f"{MODULE}.vir_addon.blender.operators").VIR_OT_render
    begin, begun = operator._begin, []
    operator._begin = lambda *given: (begun.append(1), begin(*given))[1]
    try:
        place = yield from click_button("vir.render", near)
        yield from wait_until(lambda: begun, "rendering begins", 60)
    finally:
        operator._begin = begin
    return place


def install() -> Steps:
    before = state()
    if not (yield from drop_file(ZIP)):
        # what Blender does with a zip that is dropped into its window
        with bpy.context.temp_override(**view()):
            bpy.ops.extensions.package_install_files("INVOKE_DEFAULT", url=str(ZIP))
    yield 1.0
    yield from screenshot("0_dropped")
    yield from press("RET")
    yield from wait_until(lambda: MODULE in bpy.context.preferences.addons, "the dropped zip is enabled", 60)
    yield 0.5
    for _ in range(2):
        bpy.ops.preferences.addon_disable(module=MODULE)
        assert state() == before, "something was left behind"
        bpy.ops.preferences.addon_enable(module=MODULE)
        assert MODULE in bpy.context.preferences.addons
        yield 0.3
    bpy.ops.wm.save_userpref()


def open_scene() -> Steps:
    bpy.ops.wm.open_mainfile(filepath=str(SCENE), load_ui=False)
    yield 1.0
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 480, 270, 100
    space = view()["space_data"]
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    scene.render.engine = "BLENDER_WORKBENCH"
    yield 0.5


def render_and_cancel() -> Steps:
    bpy.context.scene.vir.view_count = 1024
    place = yield from begin_render()
    yield 2.0
    yield from screenshot("3_rendering")
    assert is_rendering(), "it ended before it could be cancelled"
    yield from press("ESC")
    yield from wait_until(lambda: not is_rendering(), "Escape cancels", 20)
    assert not passes(), "cancelling left passes behind"
    yield from begin_render(place)
    yield 1.0
    yield from click_button("vir.cancel", place)
    yield from wait_until(lambda: not is_rendering(), "the button cancels", 20)
    assert not passes()


def render() -> Steps:
    yield from begin_render()
    yield from wait_until(lambda: not is_rendering(), "the render ends", 400)
    assert passes() == ["VIR Shadow", "VIR Shadow Key", "VIR Shadow Lamp", "VIR Shadow Window"], passes()


def undo() -> Steps:
    yield from press("Z", ctrl=True)
    yield 1.0
    assert not passes(), "undo left the passes"
    yield from press("Z", ctrl=True, shift=True)
    yield 1.0
    assert len(passes()) == 4, "redo did not bring them back"
    assert min(bpy.data.images["VIR Shadow Key"].pixels[:4000]) < 0.5


def compose() -> Steps:
    yield from click_button("vir.add_to_compositor")
    area = view()["area"]
    area.type = "IMAGE_EDITOR"
    area.spaces.active.image = bpy.data.images["VIR Shadow"]
    yield 0.5
    with bpy.context.temp_override(**view("IMAGE_EDITOR")):
        bpy.ops.image.view_all(fit_view=True)
    yield from screenshot("6_image")
    area.ui_type = "CompositorNodeTree"
    tree = getattr(bpy.context.scene, "compositing_node_group", None) or bpy.context.scene.node_tree
    area.spaces.active.node_tree = tree
    yield 0.5
    with bpy.context.temp_override(**view("NODE_EDITOR")):
        bpy.ops.node.view_all()
    yield 1.0
    yield from screenshot("7_compositor")
    area.type = "VIEW_3D"
    yield 0.5


def change_while_rendering() -> Steps:
    """A light is deleted and the file saved while it renders: the passes are those of the scene as it was."""
    yield from show_panel()
    bpy.context.scene.vir.view_count = 64
    yield from begin_render()
    assert is_rendering()
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "saved.blend"))
    yield from wait_until(lambda: not is_rendering(), "the render ends", 400)
    assert "VIR Shadow Lamp" in passes()
    yield from begin_render()
    assert is_rendering()
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "saved.blend"), load_ui=False)
    yield 1.0
    assert not is_rendering(), "a render of another file goes on"
    yield from show_panel()
    bpy.context.scene.camera = None
    yield from screenshot("8_no_camera")


def speak_german() -> Steps:
    preferences = bpy.context.preferences.view
    preferences.language = "de_DE"
    preferences.use_translate_interface = preferences.use_translate_tooltips = True
    look_up = bpy.app.translations.pgettext_iface
    assert look_up("Render Passes", "Operator") == "Pässe rendern" and look_up("Soft Shadows") == "Weiche Schatten"
    yield from screenshot("2_german")
    preferences.language = "en_US"
    yield 0.5


def steps() -> Steps:
    yield from install()
    yield from open_scene()
    yield from show_panel()
    yield from screenshot("1_panel")
    yield from click_button("vir.plan")
    yield from screenshot("2_plan")
    yield from speak_german()
    yield from render_and_cancel()
    preset = bpy.utils.preset_find("Draft", "vir")
    bpy.ops.script.execute_preset(filepath=preset, menu_idname="VIR_PT_presets")
    assert bpy.context.scene.vir.view_count == 16
    yield from render()
    scene = bpy.context.scene
    scene.vir.active_light_index = scene.objects.find("Key")
    yield from screenshot("4_rendered")
    yield from undo()
    yield from compose()
    yield from change_while_rendering()


run(steps)
