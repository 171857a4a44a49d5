"""Shadow passes against Cycles in the same Blender: every material white diffuse, one light, no bounces, shadowed over unshadowed."""

from __future__ import annotations

import numpy as np
import pytest

from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device

bpy = pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

from tests import cycles  # noqa: E402  (bpy decides whether this file runs)


def suzanne_on_a_floor(scene, levels: int):
    bpy.ops.mesh.primitive_monkey_add(location=(0, 0, 1.0), rotation=(-0.4, 0, 0.4))
    head = bpy.context.object
    head.modifiers.new("Subdivision", "SUBSURF").render_levels = levels
    for polygon in head.data.polygons:
        polygon.use_smooth = True
    bpy.ops.mesh.primitive_plane_add(size=20)
    area = bpy.data.lights.new("Key", "AREA")
    area.energy, area.size = 300.0, 1.0
    key = bpy.data.objects.new("Key", area)
    key.location, key.rotation_euler = (2.0, -2.0, 4.0), (0.6, 0.0, 0.785)
    scene.collection.objects.link(key)
    scene.camera.location, scene.camera.rotation_euler = (0.0, -6.0, 3.0), (1.2, 0.0, 0.0)


def shadow_pass(scene, method: Method, view_count: int):
    from vir_addon.blender.job import frame_jobs, run

    (job,) = frame_jobs(scene, scene.frame_current, Settings(method=method, view_count=view_count)).values()
    device = open_device("moderngl")
    try:
        passes = run(job, device)
    finally:
        device.close()
    return passes.images[shadow_pass_name("Key")], passes.statistics


def compare(scene, reference: cycles.CyclesReference, view_count: int):
    for method in (Method.MVR, Method.IVIR, Method.MICRO):
        image, statistics = shadow_pass(scene, method, view_count)
        errors = reference.errors(image)
        print(
            f"{method.value}: RMSE {errors['rmse']:.4f}, penumbra {errors['rmse_penumbra']:.4f}, reference's noise {reference.noise:.4f}, "
            f"{statistics.instanced_triangle_count} triangles"
        )
        yield method, errors["rmse"], errors["rmse_penumbra"]


def test_small_picture_agrees(scene):
    """A small picture of a coarser head with fewer samples: the reference's noise is allowed for."""
    suzanne_on_a_floor(scene, levels=4)
    cycles.prepare(scene, (240, 135))
    reference = cycles.CyclesReference(scene, 128)
    assert reference.noise < 0.03 and reference.penumbra.mean() > 0.05
    for method, overall, penumbra in compare(scene, reference, 128):
        assert np.sqrt(max(overall**2 - reference.noise**2, 0)) <= 0.015, method
        assert np.sqrt(max(penumbra**2 - reference.noise**2, 0)) <= 0.035, method


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_sheared_cameras_and_discs_agree(scene, kind):
    """Children of what is scaled unevenly, before a flat-shaded box: outlines are where they would be elsewhere without the shear."""
    suzanne_on_a_floor(scene, levels=0)
    bpy.data.objects.remove(bpy.data.objects["Suzanne"])
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=(0, 0, 1), rotation=(0.3, 0.4, 0.5))
    key, camera = bpy.data.objects["Key"], scene.camera
    key.data.shape, key.data.size, key.data.size_y = "ELLIPSE", 1.0, 0.5
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    parent.scale = (1.0, 1.3, 0.7)
    camera.parent = key.parent = parent
    key.location, key.rotation_euler = (2.0, -1.5, 6.0), (0.6, 0.0, 0.785)
    camera.location, camera.rotation_euler = (1.0, -4.0, 6.0), (0.9, 0.2, 0.3)
    camera.data.type, camera.data.ortho_scale = kind, 6.0
    cycles.prepare(scene, (160, 90))
    reference = cycles.CyclesReference(scene, 128)
    image, _ = shadow_pass(scene, Method.MVR, 128)
    assert reference.noise < 0.01 and reference.penumbra.mean() > 0.02
    errors = reference.errors(image)
    assert np.sqrt(max(errors["rmse"] ** 2 - reference.noise**2, 0)) <= 0.015
    assert errors["rmse_off_outlines"] <= 0.01


def white_with_opacity(name: str, link_opacity):
    """White diffuse, mixed with transparency by what `link_opacity(tree, socket)` links to the factor."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    kinds = ("OutputMaterial", "MixShader", "BsdfTransparent", "BsdfDiffuse")
    output, mix, transparent, diffuse = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(transparent.outputs[0], mix.inputs[1])
    tree.links.new(diffuse.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    link_opacity(tree, mix.inputs[0])
    return material


def leaf_opacity(tree, socket):
    """A leaf with soft edges and a hole along its rib, turned and clipped, through a Mapping node and an inverted mask."""
    row, column = np.mgrid[:48, :64]
    outline = 1 - ((column - 31.5) / 30) ** 2 - ((row - 23.5) / (6 + 16 * np.sin(np.pi * column / 63))) ** 2
    leaf = np.clip(8 * outline, 0, 1) * ((np.abs(row - 23.5) > 1.2) | (column < 10))
    image = bpy.data.images.new("leaf", 64, 48, alpha=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.stack([1 - leaf] * 3 + [np.ones_like(leaf)], axis=-1).astype(np.float32).ravel())
    image.pack()
    kinds = ("TexCoord", "Mapping", "TexImage", "Invert")
    coordinates, mapping, texture, invert = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    mapping.inputs["Location"].default_value = (0.1, 0.02, 0)
    mapping.inputs["Rotation"].default_value = (0, 0, 0.1)
    texture.image, texture.extension = image, "EXTEND"
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], invert.inputs["Color"])
    tree.links.new(invert.outputs[0], socket)


def test_cut_outs_agree(scene):
    """Leaves on cards and a box of panes, seen and casting; here Cycles sees the materials themselves."""
    leaf = white_with_opacity("leaf", leaf_opacity)
    pane = white_with_opacity("pane", lambda _, socket: setattr(socket, "default_value", 0.3))
    cards = [((0, 0, 1.2), (0.3, 0.2, 0.4)), ((-1.2, 0.5, 0.8), (1.2, 0.2, 0.1)), ((1.3, -0.3, 0.6), (0.1, 0.5, 1.4))]
    suzanne_on_a_floor(scene, levels=0)
    bpy.data.objects.remove(bpy.data.objects["Suzanne"])
    for location, rotation in cards:
        bpy.ops.mesh.primitive_plane_add(size=1.6, location=location, rotation=rotation)
        bpy.context.object.data.materials.append(leaf)
    bpy.ops.mesh.primitive_cube_add(size=0.8, location=(1.7, 1.2, 0.8))
    bpy.context.object.data.materials.append(pane)
    cycles.prepare(scene, (160, 90))
    white = scene.view_layers[0].material_override
    scene.view_layers[0].material_override = None
    bpy.data.objects["Plane"].data.materials.append(white)
    reference = cycles.CyclesReference(scene, 128)
    box = np.zeros_like(reference.judged)  # and the floor behind it
    box[40:76, 112:150] = True
    image, statistics = shadow_pass(scene, Method.MICRO, 128)
    assert not statistics.left_out
    error = np.where(reference.off_outlines, image - reference.ratio, 0)
    print(f"RMSE {rms(error[~box]):.4f}; box: {rms(error[box]):.4f}, mean {error[box].mean():.4f}; reference's noise {reference.noise:.4f}")
    assert rms(error[~box]) <= 0.02
    # 16 eye samples of up to three layers a pixel, and one draw of which views several panes stop
    assert abs(error[box].mean()) <= 0.02 and rms(error[box]) <= 0.06


def rms(values):
    return float(np.sqrt((np.asarray(values, np.float64) ** 2).mean()))


LIGHTS = {
    "hard point": ("POINT", {"shadow_soft_size": 0.0}),
    "point with a soft falloff": ("POINT", {"shadow_soft_size": 0.4, "use_soft_falloff": True}),
    "sphere": ("POINT", {"shadow_soft_size": 0.4, "use_soft_falloff": False}),
    "spot": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_soft_falloff": True}),
    "spot of a sphere": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_soft_falloff": False}),
    "square spot, which is round": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_square": True}),
    "wide spot": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 2.9, "spot_blend": 0.3}),
    "sun": ("SUN", {"angle": 0.15}),
    "wide sun": ("SUN", {"angle": 0.8}),
}


UNSCALED = (1.0, 1.0, 1.0)
SCALED = (1.5, 0.7, 1.2)
"""concerns the cone alone, and must not concern the radius"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scale"), [*((name, UNSCALED) for name in LIGHTS), ("sphere", SCALED), ("spot", SCALED)])
def test_lights_of_all_kinds_agree(scene, name, scale):
    suzanne_on_a_floor(scene, levels=4)
    kind, data = LIGHTS[name]
    lamp = bpy.data.lights.new("Lamp", kind)
    lamp.energy = 3.0 if kind == "SUN" else 300.0
    for key, value in data.items():
        setattr(lamp, key, value)
    bpy.data.objects.remove(bpy.data.objects["Key"])
    key = bpy.data.objects.new("Key", lamp)
    scene.collection.objects.link(key)
    key.location, key.rotation_euler, key.scale = (2.0, -2.0, 4.0), (0.6, 0.0, 0.785), scale
    cycles.prepare(scene, (160, 90))
    reference = cycles.CyclesReference(scene, 512)
    assert reference.off_outlines.sum() > 0.8 * reference.judged.sum()
    for method in (Method.MVR, Method.IVIR, Method.MICRO):
        image, _ = shadow_pass(scene, method, 128)
        errors = reference.errors(image)
        print(f"{name} {method.value}: RMSE {errors['rmse_off_outlines']:.4f}, reference's noise {reference.noise:.4f}")
        assert errors["rmse_off_outlines"] <= 0.02, method


@pytest.mark.slow
def test_million_triangles_agree(scene):
    suzanne_on_a_floor(scene, levels=5)
    cycles.prepare(scene, (480, 270))
    reference = cycles.CyclesReference(scene, 1024)
    for method, overall, penumbra in compare(scene, reference, 128):
        assert overall <= 0.02, method
        assert penumbra <= 0.04, method
