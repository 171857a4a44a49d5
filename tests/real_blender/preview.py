"""The preview over the 3D viewport: on and off, a light moved, the view turned, undone, four views; slices of time are printed."""

import importlib
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
import numpy as np
from driver import FOLDER, MODULE, Steps, press, run, screenshot, show_panel, view, wait_until
from slices import SliceWatch

running = importlib.import_module(f"{MODULE}.vir_addon.blender.preview.running")
watch = SliceWatch()


def build_scene() -> None:
    """Blender's cube on a floor, under two lights."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 0, -1))
    key = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA"))
    key.location, key.rotation_euler = (3, -3, 4), (0.8, 0, 0.8)
    scene.collection.objects.link(key)
    scene.vir.view_count = 16
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.ed.undo_push(message="scene")


def shown() -> list:
    return list(running._running.viewports.values())


def finish(what: str) -> Steps:
    """Until every viewport shows the whole picture of what it looks at."""
    watch.slices_ms.clear()
    yield 0.5
    yield from wait_until(lambda: shown() and not any(one.is_busy for one in shown()), what)
    for one in shown():
        print(f"{what}: {running.status_text(one)}")
        assert not one.problem and one.preview.picture is not None
    watch.tell(what)


def stopped() -> bool:
    return not shown() and not bpy.app.timers.is_registered(running._tick)


def viewport_pixels(name: str) -> np.ndarray:
    """Of a screenshot, the part that the 3D viewport covers."""
    picture = bpy.data.images.load(str(FOLDER / f"{name}.png"))
    width, height = picture.size
    pixels = np.empty(width * height * 4, np.float32)
    picture.pixels.foreach_get(pixels)
    bpy.data.images.remove(picture)
    region = view()["region"]
    return pixels.reshape(height, width, 4)[region.y : region.y + region.height, region.x : region.x + region.width]


def linear(encoded: np.ndarray) -> np.ndarray:
    """Light of a display's values."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def check_that_light_is_multiplied() -> None:
    """What is laid over is a factor of light, in Solid mode, whose display values are light."""
    preview = shown()[0].preview
    sums = preview.render.device.read(preview.picture.shadows)
    ratio = np.where(sums[..., 1] > 0, sums[..., 0] / np.maximum(sums[..., 1], 1e-9), 1 - sums[..., 2])
    before, after = (linear(viewport_pixels(name)[..., :3].mean(axis=-1)) for name in ("1_off", "2_on"))
    size = preview.level.pixel_size
    ratio = np.repeat(np.repeat(ratio, size, axis=0), size, axis=1)[: before.shape[0], : before.shape[1]]
    # away from edges, where a coarse picture is interpolated, and from what lies over the picture
    reach = 2 * size
    around = [np.roll(ratio, (dy, dx), (0, 1)) for dy in (-reach, reach) for dx in (-reach, reach)]
    chosen = (np.ptp([ratio, *around], axis=0) < 0.05) & (ratio < 0.8) & (before > 0.02)
    error = np.abs(after - before * ratio)[chosen]
    print(f"multiplied: {chosen.sum()} pixels, median error {np.median(error):.4f} of {np.median(before[chosen]):.3f}", flush=True)
    assert chosen.sum() > 1000 and np.median(error) < 0.01


def show_reflections() -> Steps:
    """A mirror ball beside the cube: what it shows over the viewport, pass by pass, while a light moves."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=1.0, location=(-2.4, -0.6, 0.0))
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("Mirror")
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.05
    shader.inputs["Base Color"].default_value = 0.9, 0.7, 0.4, 1.0  # what reflects is not what is seen of it
    ball.data.materials.append(material)
    for name, color in (("Cube", (0.8, 0.1, 0.05, 1.0)), ("Plane", (0.3, 0.5, 0.2, 1.0))):
        paint = bpy.data.materials.new(name)
        paint.diffuse_color = color  # what Solid mode shows
        next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"].default_value = color
        materials = bpy.data.objects[name].data.materials
        materials.clear()
        materials.append(paint)
    bpy.ops.object.select_all(action="DESELECT")
    scene.view_settings.view_transform = "Standard"
    view()["space_data"].shading.color_type = "MATERIAL"
    bpy.data.objects["Key"].data.energy = 400.0
    scene.vir.use_reflections = True
    pictures = {}
    for shown_pass in ("ALL", "SHADOW", "REFLECTION", "REFLECTION_COLOR", "REFLECTED"):
        scene.vir.preview_pass = shown_pass
        scene.vir.preview_display = "MULTIPLY" if shown_pass == "ALL" else "PASS"
        yield from finish(f"pass {shown_pass}")
        yield from screenshot(f"8_{shown_pass.lower()}")
        pictures[shown_pass] = viewport_pixels(f"8_{shown_pass.lower()}")
    assert all(np.abs(pictures["REFLECTED"] - other).max() > 0.1 for name, other in pictures.items() if name != "REFLECTED")
    scene.vir.preview_pass, scene.vir.preview_display = "ALL", "MULTIPLY"
    yield from finish("all again")
    bpy.data.objects["Key"].location.x = 4.0
    yield from finish("light moved, with reflections")
    scene.vir.use_reflections = False
    scene.vir.preview_pass = "REFLECTION"
    yield from wait_until(lambda: any("switched off" in one.problem for one in shown()), "switched off")
    scene.vir.preview_pass = "ALL"
    yield from finish("without reflections")


def wait_halfway() -> Steps:
    """Until there is a picture that is not done."""

    def is_halfway() -> bool:
        standing = shown()[0].preview.render.standing
        return shown()[0].is_busy and 0 < standing.views_done < standing.views_total

    yield from wait_until(is_halfway, "halfway")


def disturb() -> Steps:
    """A file saved and a light deleted while the picture gets better; local view."""
    bpy.data.objects["Cube"].location.x = -0.5
    yield from wait_halfway()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "halfway.blend"))
    assert shown()[0].is_busy
    yield from finish("saved halfway")
    second = bpy.data.objects.new("Second", bpy.data.lights.new("Second", "POINT"))
    second.location = (0.0, -3.0, 3.0)
    bpy.context.scene.collection.objects.link(second)
    yield from finish("with another light")
    bpy.data.objects["Cube"].location.x = 0.0
    yield from wait_halfway()
    bpy.data.objects.remove(second)
    yield from finish("a light deleted halfway")
    with bpy.context.temp_override(**view()):
        bpy.data.objects["Cube"].select_set(True)
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
        bpy.ops.view3d.localview(frame_selected=False)
    yield from wait_until(lambda: shown()[0].view.hidden_uids, "local view hides something")
    yield from finish("local view")
    yield from screenshot("9_local_view")
    with bpy.context.temp_override(**view()):
        bpy.ops.view3d.localview(frame_selected=False)
        bpy.data.objects["Cube"].select_set(False)
    yield from wait_until(lambda: not shown()[0].view.hidden_uids, "local view ends")
    yield from finish("out of local view")


def steps() -> Steps:
    # with it, pixels change for as long as nothing does
    bpy.context.preferences.system.viewport_aa = "OFF"
    build_scene()
    scene, viewport = bpy.context.scene, view()
    watch.begin()
    yield from press("NUMPAD_0")  # through the camera
    yield 1.0
    yield from screenshot("1_off")
    with bpy.context.temp_override(**viewport):
        bpy.ops.vir.preview()
    yield from finish("on")
    yield from screenshot("2_on")
    assert np.abs(viewport_pixels("2_on") - viewport_pixels("1_off")).max() > 0.1
    check_that_light_is_multiplied()

    with bpy.context.temp_override(**viewport):
        bpy.ops.vir.preview()
    yield from wait_until(stopped, "off")
    yield from screenshot("3_off_again")
    np.testing.assert_array_equal(viewport_pixels("3_off_again"), viewport_pixels("1_off"), "Blender draws something else than before")

    scene.vir.preview_display, scene.vir.use_preview = "DIFFERENCE", True
    yield from finish("on again")
    bpy.data.objects["Key"].location.x = -3.0
    bpy.data.objects["Key"].rotation_euler = (0.8, 0, -0.8)
    yield from finish("light moved")
    yield from screenshot("4_difference")
    change = viewport_pixels("4_difference") - viewport_pixels("1_off")
    redder = change[..., 0] - change[..., 2]
    assert (redder > 0.1).mean() > 0.005 and (redder < -0.1).mean() > 0.005, "nothing is lighter and darker than before"

    scene.vir.preview_display = "MULTIPLY"
    yield from show_reflections()
    for key in ("NUMPAD_0", "NUMPAD_6"):  # out of the camera; to the right
        before = shown()[0].view
        yield from press(key)
        yield from wait_until(lambda before=before: shown()[0].view is not before, f"{key} turns the view")
        yield 1.0  # smoothly
        yield from finish(f"view turned by {key}")
    yield from show_panel()
    yield from finish("panel")
    yield from screenshot("5_view_turned")

    yield from disturb()
    bpy.ops.ed.undo_push(message="preview")
    bpy.data.objects["Cube"].location.x = 1.5
    bpy.ops.ed.undo_push(message="cube")
    yield from finish("object moved")
    with bpy.context.temp_override(**view()):
        bpy.ops.ed.undo()
    yield from finish("undone")
    assert bpy.data.objects["Cube"].location.x == 0.0

    with bpy.context.temp_override(**view()):
        bpy.ops.screen.region_quadview()
    yield 1.0
    yield from finish("four views")
    assert len(shown()) == 4
    yield from screenshot("6_four_views")
    with bpy.context.temp_override(**view()):
        bpy.ops.screen.region_quadview()
    yield 1.0
    yield from wait_until(lambda: len(shown()) == 1, "one view")

    bpy.data.objects.remove(bpy.data.objects["Key"])
    bpy.data.objects["Light"].hide_render = True
    yield from wait_until(lambda: any("no light" in one.problem for one in shown()), "no light")
    yield from screenshot("7_no_light")
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "preview.blend"))
    bpy.data.objects["Light"].hide_render = False
    yield from finish("after saving")

    bpy.context.window_manager.windows[0].scene = bpy.data.scenes.new("Other")
    yield from wait_until(stopped, "another scene")
    # undoing has replaced the one that this began with
    bpy.context.window_manager.windows[0].scene = bpy.data.scenes["Scene"]
    yield from finish("back")
    view()["area"].type = "TEXT_EDITOR"
    yield from wait_until(stopped, "no viewport")
    watch.tell_all()


run(steps)
