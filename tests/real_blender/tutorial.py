"""The first five minutes of docs/manual.md, from Blender's own startup file to shadows in another colour."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
import numpy as np
from driver import FOLDER, MODULE, Steps, click_button, render, run, screenshot, show_panel, view, wait_until

TINT = (0.25, 0.45, 1.0, 1.0)


def is_busy() -> bool:
    window = bpy.context.window_manager.windows[0]
    return bpy.app.is_job_running("RENDER") or any(operator.bl_idname == "VIR_OT_render" for operator in window.modal_operators)


def build() -> Steps:
    """A floor under the default cube, and a light with a size."""
    with bpy.context.temp_override(**view()):
        bpy.ops.mesh.primitive_plane_add(size=12.0, location=(0.0, 0.0, -1.0))
        bpy.ops.object.select_all(action="DESELECT")
    bpy.data.lights["Light"].shadow_soft_size = 0.6
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 640, 360, 100
    scene.eevee.taa_render_samples = 16
    view()["space_data"].region_3d.view_perspective = "CAMERA"
    yield 0.5


def colour_shadows() -> Steps:
    """Mix: the factor is the light's pass; A, where it is dark, the render in blue; B, where it is lit, the render."""
    tree = bpy.context.scene.compositing_node_group
    layers = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers")
    group = next(node for node in tree.nodes if node.type == "GROUP")
    target = next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput")
    blue, mix = (tree.nodes.new("ShaderNodeMix") for _ in range(2))
    for node, x, y, label in ((blue, 380, -60, "Blue"), (mix, 620, -220, "By the shadow")):
        node.data_type, node.location, node.label = "RGBA", (x, y), label
    blue.blend_type, blue.inputs["Factor"].default_value = "MULTIPLY", 1.0
    inputs = [[socket for socket in node.inputs if socket.name in "AB" and socket.type == "RGBA"] for node in (blue, mix)]
    result = [next(socket for socket in node.outputs if socket.type == "RGBA") for node in (blue, mix)]
    tree.links.new(layers.outputs["Image"], inputs[0][0])
    inputs[0][1].default_value = TINT
    tree.links.new(group.outputs["VIR Shadow Light"], mix.inputs["Factor"])
    tree.links.new(result[0], inputs[1][0])
    tree.links.new(layers.outputs["Image"], inputs[1][1])
    tree.links.new(result[1], target.inputs["Image"])
    target.location.x = 900
    area = view()["area"]
    area.ui_type = "CompositorNodeTree"
    area.spaces.active.node_tree = tree
    area.spaces.active.show_region_ui = False
    yield 0.5
    with bpy.context.temp_override(**view("NODE_EDITOR")):
        bpy.ops.node.view_all()
    yield 1.0
    yield from screenshot("3_compositor")
    area.type = "VIEW_3D"
    yield 0.5


def steps() -> Steps:
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    if MODULE not in bpy.context.preferences.addons:  # factory settings switch extensions off
        bpy.ops.preferences.addon_enable(module=MODULE)
    yield 1.0
    yield from build()
    yield from show_panel()
    yield from click_button("vir.render")
    yield from wait_until(lambda: not is_busy(), "the render ends", 300)
    yield from screenshot("1_rendered")
    assert min(bpy.data.images["VIR Shadow Light"].pixels[:]) < 0.2
    yield from click_button("vir.add_to_compositor")
    area = view()["area"]
    area.type = "IMAGE_EDITOR"
    area.spaces.active.image = bpy.data.images["VIR Shadow Light"]
    yield 0.5
    yield from screenshot("2_pass")
    area.type = "VIEW_3D"
    yield 0.5
    yield from colour_shadows()
    bpy.context.scene.vir.use_on_render = True
    bpy.context.scene.render.filepath = str(FOLDER / "picture.png")
    yield from render()
    yield from screenshot("4_result")
    bpy.data.images["Render Result"].save_render(str(FOLDER / "picture.png"))
    picture = bpy.data.images.load(str(FOLDER / "picture.png"))
    pixels = np.array(picture.pixels[:]).reshape(-1, picture.channels)
    tree = bpy.context.scene.compositing_node_group
    output = next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput")
    layers = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers")
    tree.links.new(layers.outputs["Image"], output.inputs["Image"])
    bpy.context.scene.vir.use_on_render = False
    bpy.ops.render.render()
    bpy.data.images["Render Result"].save_render(str(FOLDER / "without.png"))
    assert (pixels[:, 2] > 1.3 * pixels[:, 0] + 0.02).mean() > 0.01, "no shadow is blue"


run(steps)
