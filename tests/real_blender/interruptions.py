"""What artists do in the middle of things: edit a mesh, render, disable the extension while the preview runs. A hundred lights."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bmesh
import bpy
from driver import FOLDER, MODULE, Steps, close_other_windows, press, redraw, render, run, screenshot, show_panel, view, wait_until
from previewing import blender_side, finish, is_rendering, make_scene, passes, shown

LIGHT_COUNT = 100


def set_up() -> Steps:
    make_scene()
    yield from press("NUMPAD_0")
    yield 1.0
    yield from show_panel()
    bpy.context.scene.vir.use_preview = True
    yield from finish("on")


def edit() -> Steps:
    """The preview follows vertices that are dragged in Edit Mode, and passes are made of what is there."""
    cube = bpy.data.objects["Cube"]
    bpy.context.view_layer.objects.active = cube
    with bpy.context.temp_override(**view()):
        bpy.ops.object.mode_set(mode="EDIT")
    yield from finish("Edit Mode")
    before = shown()[0].preview.render.snapshot
    edited = bmesh.from_edit_mesh(cube.data)
    for vertex in edited.verts:
        vertex.co.z += 0.8
    bmesh.update_edit_mesh(cube.data)
    yield from finish("vertices moved")
    after = shown()[0].preview.render.snapshot
    assert [mesh.positions_os.max() for mesh in before.meshes] != [mesh.positions_os.max() for mesh in after.meshes]
    yield from screenshot("1_edit_mode")
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render()
    assert passes() == ["VIR Shadow", "VIR Shadow Light"] and cube.mode == "EDIT"
    with bpy.context.temp_override(**view()):
        bpy.ops.object.mode_set(mode="OBJECT")
    yield from finish("Object Mode")


def render_while_previewing() -> Steps:
    """The preview waits for a render of passes and for F12, and goes on."""
    scene = bpy.context.scene
    bpy.data.objects["Cube"].location.x = 0.5
    yield 0.2
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render("INVOKE_DEFAULT")
    yield from wait_until(lambda: not is_rendering(), "the passes are rendered", 400)
    yield from finish("after Render Passes")
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.add_to_compositor()
    scene.vir.use_on_render = True
    for device in ("MODERNGL", "GPU"):
        scene.vir.device = device
        bpy.data.objects["Cube"].location.x += 0.2
        yield 0.2
        yield from render()
        assert not blender_side("frame_state").state_of(scene).problem
        yield from close_other_windows()
        yield from finish(f"after F12, {device}")
    scene.vir.use_on_render, scene.vir.device = False, "AUTO"


def disable_while_it_works() -> Steps:
    """A preview halfway and passes being rendered: both end, nothing is left, and both work when it is enabled again."""
    scene = bpy.context.scene
    scene.vir.view_count = 1024
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render("INVOKE_DEFAULT")
    yield 1.0
    assert is_rendering()
    bpy.ops.preferences.addon_disable(module=MODULE)
    yield 1.0
    assert not is_rendering() and not hasattr(scene, "vir")
    left = [thread.name for thread in __import__("threading").enumerate() if "vir" in thread.name]
    assert not left, left
    yield from screenshot("2_disabled")
    bpy.ops.preferences.addon_enable(module=MODULE)
    assert scene.vir.use_preview and scene.vir.view_count == 1024, "settings were lost"
    scene.vir.view_count = 16
    redraw()
    yield from finish("enabled again")


def many_lights() -> Steps:
    """Planned, listed and shown."""
    scene = bpy.context.scene
    scene.vir.use_preview = False
    for number in range(LIGHT_COUNT):
        light = bpy.data.objects.new(f"Bulb {number:03d}", bpy.data.lights.new(f"Bulb {number:03d}", "POINT"))
        light.location = (number % 10 - 5.0, number // 10 - 5.0, 3.0)
        light.data.energy = 5.0
        scene.collection.objects.link(light)
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.plan()
    yield from screenshot("3_many_lights")
    scene.vir.use_preview = True
    yield from finish("many lights")
    yield from screenshot("4_many_lights_previewed")


def steps() -> Steps:
    yield from set_up()
    yield from edit()
    yield from render_while_previewing()
    yield from disable_while_it_works()
    yield from many_lights()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "interruptions.blend"))


run(steps)
