"""What passes are for, before and after: shadows on a render that has none, reflections on one without. Composed with F12."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path += [str(Path(__file__).parent), str(Path(__file__).resolve().parent.parent.parent)]

import bpy
import numpy as np
from driver import FOLDER, SCENE, Steps, click_button, close_other_windows, render, run, screenshot, show_panel, view

from demo_scenes import mirror_room

SIZE = (480, 270)


def mix(tree, kind: str, first, second):
    """A Mix Color node of two sockets; its result."""
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type, node.inputs["Factor"].default_value = "RGBA", kind, 1.0
    inputs = [socket for socket in node.inputs if socket.name in "AB" and socket.type == "RGBA"]
    for source, target in zip((first, second), inputs, strict=True):
        tree.links.new(source, target)
    return next(socket for socket in node.outputs if socket.type == "RGBA")


def write_with_f12(pictures: dict, scene) -> Steps:
    """Name -> a socket of the compositor, all from one render, into FOLDER/NAME.png."""
    tree = scene.compositing_node_group
    output = tree.nodes.new("CompositorNodeOutputFile")
    output.format.media_type, output.format.file_format = "IMAGE", "PNG"
    output.directory, output.file_name = str(FOLDER), ""
    for name, socket in pictures.items():
        output.file_output_items.new("RGBA", name)
        tree.links.new(socket, output.inputs[name])
        (FOLDER / f"{name}.png").unlink(missing_ok=True)
    scene.vir.use_on_render = True
    yield from render()
    assert all((FOLDER / f"{name}.png").is_file() for name in pictures)
    yield from close_other_windows()


def read(name: str) -> np.ndarray:
    """(pixel_count, 3), as displayed"""
    image = bpy.data.images.load(str(FOLDER / f"{name}.png"))
    return np.array(image.pixels[:]).reshape(-1, image.channels)[:, :3]


def prepare(scene, engine: str, preset: str) -> None:
    scene.render.engine = engine
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    bpy.ops.script.execute_preset(filepath=bpy.utils.preset_find(preset, "vir"), menu_idname="VIR_PT_presets")
    space = view()["space_data"]
    space.region_3d.view_perspective = "CAMERA"


def compose(scene) -> Iterator[float]:
    """Render passes and press Add to Compositor; returns the compositor's tree, the render's outputs and the node of the passes."""
    bpy.ops.vir.render()
    yield from show_panel()
    yield from click_button("vir.add_to_compositor")
    tree = scene.compositing_node_group
    layers = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers")
    return tree, layers.outputs, next(node for node in tree.nodes if node.type == "GROUP")


def show_nodes(tree) -> Steps:
    area = view()["area"]
    area.ui_type = "CompositorNodeTree"
    area.spaces.active.node_tree = tree
    yield 0.5
    with bpy.context.temp_override(**view("NODE_EDITOR")):
        bpy.ops.node.view_all()
    yield from screenshot("2_node_with_reflections")
    area.type = "VIEW_3D"


def cast_shadows() -> Steps:
    """All lights' shadows on a render of Workbench, which knows none."""
    bpy.ops.wm.open_mainfile(filepath=str(SCENE), load_ui=False)
    yield 1.0
    scene = bpy.context.scene
    prepare(scene, "BLENDER_WORKBENCH", "Draft")
    scene.display.shading.color_type = "MATERIAL"
    scene.view_settings.view_transform = "Standard"
    scene.vir.view_count = 32
    tree, render, node = yield from compose(scene)
    shadowed = mix(tree, "MULTIPLY", render["Image"], node.outputs["VIR Shadow"])
    yield from write_with_f12({"shadows_without": render["Image"], "shadows_with": shadowed}, scene)
    without, with_shadows = read("shadows_without"), read("shadows_with")
    assert (with_shadows <= without + 0.01).all() and np.median((with_shadows / np.maximum(without, 0.01)).mean(axis=1)) < 0.95


def add_reflections() -> Steps:
    """A mirror ball on Cycles' diffuse light. Cycles' own picture of it is the judge."""
    bpy.ops.wm.read_homefile(use_factory_startup=False, use_empty=True)
    yield 1.0
    scene = bpy.context.scene
    mirror_room.build(scene, roughness=0.05)
    prepare(scene, "CYCLES", "Balanced")
    scene.view_settings.view_transform = "Standard"
    scene.cycles.samples, scene.cycles.use_denoising = 96, False
    layer = bpy.context.view_layer
    layer.use_pass_diffuse_direct = layer.use_pass_diffuse_indirect = layer.use_pass_diffuse_color = layer.use_pass_environment = True
    scene.vir.use_reflections = True
    tree, render, node = yield from compose(scene)
    yield from screenshot("1_reflectors")
    diffuse = mix(tree, "MULTIPLY", mix(tree, "ADD", render["Diffuse Direct"], render["Diffuse Indirect"]), render["Diffuse Color"])
    without = mix(tree, "ADD", diffuse, render["Environment"])
    tree.links.new(without, node.inputs["Without Reflections"])
    reflected = mix(tree, "MULTIPLY", node.outputs["VIR Reflection"], node.outputs["VIR Reflection Color"])
    names = {
        "reflection_without": without,
        "reflection_pass": node.outputs["VIR Reflection"],
        "reflection_with": node.outputs["With Reflections"],
        "reflection_by_hand": mix(tree, "ADD", without, reflected),
        "reflection_cycles": render["Image"],
    }
    yield from write_with_f12(names, scene)
    yield from show_nodes(tree)
    assert np.array_equal(read("reflection_with"), read("reflection_by_hand")), "the node adds something else"
    before, after, wanted = (read(f"reflection_{name}") for name in ("without", "with", "cycles"))
    is_mirror = before.max(axis=1) < 0.02
    # passes do not show lamps, nor light that walls throw on each other
    errors = [np.median(np.abs(one - wanted)[is_mirror]) for one in (before, after)]
    print(f"median difference from Cycles in the mirror: {errors[0]:.4f} without reflections, {errors[1]:.4f} with", flush=True)
    assert is_mirror.mean() > 0.2 and errors[1] < 0.25 * errors[0]


def steps() -> Steps:
    yield from cast_shadows()
    yield from add_reflections()


run(steps)
