"""F12 and an animation through the compositor and File Output, in a window, on both devices; Blender's own drawing stays as it was."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
import numpy as np
from driver import FOLDER, SCENE, Steps, close_other_windows, render, run, screenshot, show_panel, view

SIZE = (240, 135)
KEY = "VIR Shadow Key"


def read_picture(path: Path) -> np.ndarray:
    """(height, width, 4) float32, the first row at the bottom"""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)


def read_pass(name: str = KEY) -> np.ndarray:
    image = bpy.data.images[name]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], -1)[..., 0]


def set_up() -> Steps:
    """The key light turns from frame to frame; its pass is the picture, and File Output gets it beside the combined one."""
    bpy.ops.wm.open_mainfile(filepath=str(SCENE), load_ui=False)
    yield 1.0
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    scene.render.engine = "BLENDER_WORKBENCH"
    view()["space_data"].region_3d.view_perspective = "CAMERA"
    view()["space_data"].overlay.show_overlays = False
    light = bpy.data.objects["Key"]
    light.keyframe_insert("location", frame=1)
    light.location.x += 3.0
    light.keyframe_insert("location", frame=3)
    scene.frame_start, scene.frame_end = 1, 3
    scene.frame_set(1)
    bpy.ops.script.execute_preset(filepath=bpy.utils.preset_find("Draft", "vir"), menu_idname="VIR_PT_presets")
    scene.vir.device = "MODERNGL"
    picture = scene.render.image_settings
    picture.file_format, picture.color_depth, picture.exr_codec = "OPEN_EXR", "32", "ZIP"
    bpy.ops.vir.render()
    bpy.ops.vir.add_to_compositor()
    tree = scene.compositing_node_group
    group = next(node for node in tree.nodes if node.type == "GROUP")
    target = next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput")
    tree.links.new(group.outputs[KEY], target.inputs["Image"])
    output = tree.nodes.new("CompositorNodeOutputFile")
    output.location = (target.location.x, target.location.y - 200)
    output.format.media_type = "MULTI_LAYER_IMAGE"
    output.directory, output.file_name = str(FOLDER / "file_output"), "passes_"
    for name in (KEY, "VIR Shadow"):
        output.file_output_items.new("RGBA", name)
        tree.links.new(group.outputs[name], output.inputs[name])
    yield 0.5


def expect() -> Steps:
    """What the button makes of every frame, for comparison; then F12 takes over."""
    scene = bpy.context.scene
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        bpy.ops.vir.render()
        np.save(FOLDER / f"expected_{frame:04d}.npy", read_pass())
        yield 0.1
    scene.frame_set(1)
    scene.vir.use_on_render = True
    for image in bpy.data.images:
        if image.get("vir_pass"):  # what is in the file must not pass for rendered
            image.pixels.foreach_set(np.zeros(len(image.pixels), np.float32))
            image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "frames.blend"))


def render_with_f12() -> Steps:
    scene = bpy.context.scene
    expected = np.load(FOLDER / "expected_0001.npy")
    for device in ("MODERNGL", "GPU"):
        scene.vir.device = device
        yield from render()
        difference = np.abs(read_pass() - expected)
        print(f"F12, {device}: mean difference {difference.mean():.5f}, largest {difference.max():.3f}")
        assert not difference.any() if device == "MODERNGL" else difference.mean() < 1e-3
        yield from screenshot(f"1_f12_{device.lower()}")
        yield from close_other_windows()
    scene.vir.device = "MODERNGL"


def render_animation() -> Steps:
    scene = bpy.context.scene
    scene.render.filepath = str(FOLDER / "window" / "frame_####")
    yield from render(ctrl=True)
    for frame in (1, 2, 3):
        expected = np.load(FOLDER / f"expected_{frame:04d}.npy")
        found = read_picture(FOLDER / "window" / f"frame_{frame:04d}.exr")[..., 0]
        assert np.array_equal(found, expected), f"frame {frame} differs by up to {np.abs(found - expected).max()}"
    written = sorted(path.name for path in (FOLDER / "file_output").iterdir())
    assert len(written) >= 3, written
    yield from close_other_windows()


def draws_as_before() -> Steps:
    """The viewport, pixel by pixel, before and after renders of ours: a context too many would show."""
    bpy.context.scene.vir.use_on_render = False
    bpy.context.preferences.system.viewport_aa = "OFF"  # otherwise redraws add samples, and the picture settles slowly
    view()["space_data"].show_region_ui = False
    yield 2.0
    yield from screenshot("2_before")
    before = read_picture(FOLDER / "2_before.png")
    for device in ("MODERNGL", "GPU"):
        bpy.context.scene.vir.device = device
        bpy.ops.vir.render()
        yield 0.5
        yield from screenshot(f"2_after_{device.lower()}")
        after = read_picture(FOLDER / f"2_after_{device.lower()}.png")
        region = view()["region"]
        shown = (slice(region.y, region.y + region.height), slice(region.x, region.x + region.width))
        assert np.array_equal(before[shown], after[shown]), f"{device}: the viewport has changed"


def steps() -> Steps:
    yield from set_up()
    yield from expect()
    yield from draws_as_before()
    bpy.context.scene.vir.use_on_render = True
    yield from render_with_f12()
    yield from render_animation()
    yield from show_panel()
    yield from screenshot("3_panel")


run(steps)
