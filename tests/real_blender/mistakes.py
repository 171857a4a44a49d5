"""What a new artist does wrong or at the wrong moment: no camera, no light, hidden and deleted lights, undo and F12 while passes are
rendered, a file that was never saved, nothing but a volume or grease pencil, a device that is lost. The panel says what to do, and
nothing is broken afterwards."""

import importlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
from driver import MODULE, Steps, close_other_windows, press, redraw, render, run, screenshot, show_panel, view, wait_until
from previewing import blender_side, finish, is_rendering, make_scene, passes, shown

ENOUGH_VIEWS, ENOUGH_PERCENT = 1024, 400
"""views, and of the picture's size: a render is still under way when something happens to it"""


def problem() -> str:
    return blender_side("frame_state").state_of(bpy.context.scene).problem


def render_passes() -> Steps:
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render("INVOKE_DEFAULT")
    yield from wait_until(lambda: not is_rendering(), "the passes are rendered", 400)
    yield 0.3


def begin_render(percent: int = ENOUGH_PERCENT) -> Steps:
    scene = bpy.context.scene
    scene.vir.view_count, scene.render.resolution_percentage = ENOUGH_VIEWS, percent
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render("INVOKE_DEFAULT")
    yield 1.0
    assert is_rendering(), "it ended before anything could happen to it"


def end_render() -> Steps:
    if is_rendering():
        yield from press("ESC")
    yield from wait_until(lambda: not is_rendering(), "the render ends", 60)
    scene = bpy.context.scene
    scene.vir.view_count, scene.render.resolution_percentage = 16, 100
    yield 0.3


def says(text: str) -> Steps:
    """The preview, in the viewport."""
    redraw()
    yield from wait_until(lambda: any(text in one.problem or text in one.said for one in shown()), text, 60)


def is_greyed_out(name: str) -> bool:
    with bpy.context.temp_override(**view()):
        return not getattr(bpy.ops.vir, name).poll()


def nothing_to_render() -> Steps:
    """Without a camera, without a light, with one that is hidden."""
    scene, light, camera = bpy.context.scene, bpy.data.objects["Light"], bpy.data.objects["Camera"]
    assert not bpy.data.filepath and all(map(is_greyed_out, ("open_report", "add_to_compositor", "cancel")))
    scene.camera = None
    yield from screenshot("1_no_camera")
    assert is_greyed_out("render")
    scene.camera = camera
    for hide in (partial(setattr, light, "hide_render"), light.hide_set, partial(setattr, light, "hide_viewport")):
        hide(True)
        yield from says("no light")
        hide(False)
        yield from finish("shown again")
    light.hide_render = True
    try:
        yield from render_passes()
    except RuntimeError as error:
        assert "no light" in str(error), error
    else:
        raise AssertionError("passes are rendered without a light")
    yield from screenshot("2_no_light")
    assert not passes() and "no light" in problem()
    light.hide_render = False
    yield from finish("a light again")
    scene.vir.use_soft_shadows = scene.vir.use_omni_shadows = False
    yield from says("switched off")
    yield from screenshot("3_all_switched_off")
    scene.vir.use_soft_shadows = scene.vir.use_omni_shadows = True
    bpy.data.objects["Cube"].hide_render = bpy.data.objects["Plane"].hide_render = True
    yield from says("no surface")
    yield from render_passes()
    yield from screenshot("4_nothing_to_see")
    bpy.data.objects["Cube"].hide_render = bpy.data.objects["Plane"].hide_render = False
    yield from finish("objects again")


def nothing_but(kind: str, add: Callable[[], object]) -> Steps:
    """A camera, a light and what passes leave out: said in the panel and by the preview."""
    bpy.ops.wm.read_homefile(use_factory_startup=False)
    yield 0.5
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    add()
    scene = bpy.context.scene
    scene.vir.view_count, scene.vir.use_preview = 16, True
    scene.render.resolution_x, scene.render.resolution_y = 480, 270
    scene.render.engine = "BLENDER_WORKBENCH"
    yield from show_panel()
    yield from says("no surface")
    try:
        yield from render_passes()
    except RuntimeError as error:
        print(f"{kind}: {error}", flush=True)
    assert "no surface" in problem() and "left out" in problem(), problem()
    yield from screenshot(f"9_{kind}")
    scene.vir.use_on_render = True
    yield from render()
    yield from close_other_windows()


def add_volume() -> None:
    volume = bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke"))
    bpy.context.scene.collection.objects.link(volume)


def add_grease_pencil() -> None:
    bpy.ops.object.grease_pencil_add(type="STROKE")


class Lost:
    """A device whose driver has given up: whatever it is asked for fails."""

    def __init__(self, name: str) -> None:
        self.kernel = {"gpu": ("blender_gpu_device", "BlenderComputeKernel"), "moderngl": ("moderngl_device", "ModernglComputeKernel")}[
            name
        ]

    def __enter__(self) -> None:
        module = importlib.import_module(f"{MODULE}.vir_addon.device.{self.kernel[0]}")
        self.owner = getattr(module, self.kernel[1])
        self.dispatch = self.owner._dispatch
        self.owner._dispatch = lambda *_: self.refuse()

    def refuse(self) -> None:
        raise RuntimeError("context lost")

    def __exit__(self, *_: object) -> None:
        self.owner._dispatch = self.dispatch


def lose_devices() -> Steps:
    """While the preview runs, and while passes are rendered: both say so, the passes of before are there, and both work again."""
    bpy.ops.wm.read_homefile(use_factory_startup=False)
    yield 0.5
    make_scene()
    scene = bpy.context.scene
    yield from show_panel()
    scene.vir.use_preview = True
    yield from finish("on")
    yield from render_passes()
    before = {name: bpy.data.images[name].pixels[:] for name in passes()}
    with Lost("gpu"):
        bpy.data.objects["Cube"].location.x = 0.5
        yield from says("context lost")
        yield from screenshot("10_device_lost")
    bpy.data.objects["Cube"].location.x = 0.6
    redraw()
    yield from finish("another device")
    scene.vir.device = "MODERNGL"
    with Lost("moderngl"):
        try:
            yield from render_passes()
        except RuntimeError as error:
            print(f"lost: {error}", flush=True)
        assert "context lost" in problem(), problem()
        yield from screenshot("11_device_lost_in_render")
    assert {name: bpy.data.images[name].pixels[:] for name in passes()} == before
    yield from render_passes()
    assert not problem(), problem()
    assert {name: bpy.data.images[name].pixels[:] for name in passes()} != before


def at_the_wrong_moment() -> Steps:
    """While passes are rendered: undo, F12, another render, another scene, its camera and its light deleted."""
    scene = bpy.context.scene
    bpy.ops.ed.undo_push(message="before")
    bpy.data.objects["Cube"].location.x = 0.5
    bpy.ops.ed.undo_push(message="moved")
    yield from begin_render()
    yield from press("Z", ctrl=True)
    yield 1.0
    assert is_rendering(), "undo ends the render"
    assert bpy.data.objects["Cube"].location.x == 0.0, "undo does nothing"
    yield from screenshot("5_undo_while_it_renders")
    yield from end_render()
    scene = bpy.context.scene
    yield from begin_render()
    assert is_greyed_out("render") and is_greyed_out("plan")
    yield from render()
    assert not problem(), problem()
    yield from screenshot("6_f12_while_it_renders")
    yield from close_other_windows()
    yield from end_render()
    yield from begin_render()
    other = bpy.data.scenes.new("Other")
    bpy.context.window_manager.windows[0].scene = other
    yield 1.0
    assert is_rendering(), "it ends where another scene is looked at"
    bpy.context.window_manager.windows[0].scene = scene
    yield from end_render()
    bpy.data.scenes.remove(other)
    yield from begin_render()
    bpy.data.objects.remove(bpy.data.objects["Camera"])
    bpy.data.objects.remove(bpy.data.objects["Light"])
    yield 1.0
    assert not problem(), problem()
    yield from screenshot("7_deleted_while_it_renders")
    yield from end_render()
    bpy.ops.wm.read_homefile(use_factory_startup=False)
    yield 0.5
    yield from begin_render(percent=100)
    bpy.ops.wm.read_homefile(use_factory_startup=False)
    yield 1.0
    assert not is_rendering(), "a render of another file goes on"
    yield from show_panel()
    yield from screenshot("8_new_file")


def steps() -> Steps:
    make_scene()
    yield from press("NUMPAD_0")
    yield 1.0
    yield from show_panel()
    bpy.context.scene.vir.use_preview = True
    yield from finish("on")
    yield from nothing_to_render()
    yield from at_the_wrong_moment()
    yield from nothing_but("volume", add_volume)
    yield from nothing_but("grease_pencil", add_grease_pencil)
    yield from lose_devices()


run(steps)
