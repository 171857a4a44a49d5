"""The preview where artists arrange their windows: two viewports, a quad view, a sidebar on the other side, an area full screen, another
workspace; and what they change meanwhile: a light's name, a copied scene, undone edits."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
from driver import Steps, press, redraw, run, screenshot, show_panel, view, wait_until
from previewing import blender_side, finish, is_rendering, make_scene, shown


def set_up() -> Steps:
    make_scene()
    scene = bpy.context.scene
    yield from show_panel()
    scene.vir.use_preview, scene.vir.preview_display = True, "PASS"
    yield from finish("on")


def two_viewports() -> Steps:
    """Each shows its own view; one that is closed again takes its preview with it."""
    with bpy.context.temp_override(**view()):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    areas = [area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D"]
    assert len(areas) == 2
    with bpy.context.temp_override(area=areas[1], region=next(one for one in areas[1].regions if one.type == "WINDOW")):
        bpy.ops.view3d.view_axis(type="TOP")
    yield from finish("two viewports", 2)
    bpy.data.objects["Light"].location.x -= 2.0
    yield from finish("light moved", 2)
    assert len({one.preview.render.picture.size for one in shown()}) == 2
    yield from screenshot("1_two_viewports")
    areas[1].type = "OUTLINER"
    redraw()
    yield from finish("one is another editor", 1)
    areas[1].type = "VIEW_3D"
    redraw()
    yield from finish("and a viewport again", 2)
    with bpy.context.temp_override(area=areas[1]):
        bpy.ops.screen.area_close()
    yield from finish("closed", 1)


def quad_view() -> Steps:
    with bpy.context.temp_override(**view()):
        bpy.ops.screen.region_quadview()
    yield from finish("quad view", 4)
    bpy.data.objects["Cube"].location.z += 0.5
    yield from finish("object moved in quad view", 4)
    yield from screenshot("2_quad_view")
    with bpy.context.temp_override(**view()):
        bpy.ops.screen.region_quadview()
    yield from finish("out of quad view", 1)


def arrangements() -> Steps:
    """A sidebar on the other side, the area full screen and back, another workspace and back."""
    with bpy.context.temp_override(**view(region="UI")):
        bpy.ops.screen.region_flip()
    yield from finish("sidebar flipped")
    yield from screenshot("3_sidebar_left")
    with bpy.context.temp_override(**view(region="UI")):
        bpy.ops.screen.region_flip()
    for hides in (False, True):
        with bpy.context.temp_override(**view()):
            bpy.ops.screen.screen_full_area(use_hide_panels=hides)
        yield from finish(f"full screen {hides}")
        yield from screenshot(f"4_full_screen_{hides}")
        with bpy.context.temp_override(**view()):
            if hides:
                bpy.ops.screen.screen_full_area(use_hide_panels=True)
            else:
                bpy.ops.screen.back_to_previous()
        yield from finish("back from full screen")
    window, before = bpy.context.window_manager.windows[0], bpy.context.workspace
    window.workspace = bpy.data.workspaces["UV Editing"]
    yield from finish("another workspace")
    yield from screenshot("5_workspace")
    window.workspace = bpy.data.workspaces["Scripting"]
    yield from finish("a third workspace")
    window.workspace = before
    yield from finish("back")


def changes() -> Steps:
    scene = bpy.context.scene
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.plan()
    scene.vir.preview_light = "Light"
    yield from finish("of one light")
    bpy.data.objects["Light"].name = "Renamed"
    yield 0.5
    yield from wait_until(lambda: not any(one.is_busy for one in shown()), "renamed", 100)
    assert scene.vir.preview_light_now == "Renamed"
    print("renamed:", [blender_side("preview.running").status_text(one) for one in shown()], flush=True)
    yield from screenshot("6_renamed")
    scene.vir.preview_light = ""
    yield from finish("of all lights")
    # in the middle of it
    scene.vir.view_count = 512
    yield 0.5
    bpy.data.objects["Renamed"].name = "Light"
    yield 0.5
    with bpy.context.temp_override(**view()):
        bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.window_manager.windows[0].scene
    assert copy is not scene and copy.vir.use_preview
    copy.vir.view_count = 16
    yield from finish("a full copy of the scene")
    yield from screenshot("7_scene_copied")
    bpy.context.window_manager.windows[0].scene = scene
    bpy.data.scenes.remove(copy)
    scene.vir.view_count = 16
    yield from finish("the copy removed")


def undone() -> Steps:
    """Undo and redo while passes are rendered, and while the preview is on its way."""
    scene = bpy.context.scene
    bpy.ops.ed.undo_push(message="before")
    bpy.data.objects["Cube"].location.x = 2.0
    bpy.ops.ed.undo_push(message="moved")
    yield from finish("moved")
    scene.vir.view_count = 256
    bpy.ops.ed.undo_push(message="more views")
    with bpy.context.temp_override(**view()):
        bpy.ops.vir.render("INVOKE_DEFAULT")
    yield 1.0
    assert is_rendering()
    yield from press("Z", ctrl=True)
    assert bpy.context.scene.vir.view_count == 16
    yield from wait_until(lambda: not is_rendering(), "rendered", 400)
    bpy.ops.ed.undo()
    yield 0.3
    bpy.ops.ed.undo()
    bpy.context.scene.vir.view_count = 16
    redraw()
    yield from finish("undone")
    bpy.ops.ed.redo()
    bpy.context.scene.vir.view_count = 16
    yield from finish("redone")
    yield from screenshot("8_redone")


def steps() -> Steps:
    yield from set_up()
    yield from two_viewports()
    yield from quad_view()
    yield from arrangements()
    yield from changes()
    yield from undone()


run(steps)
