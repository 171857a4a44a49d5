"""Materials read from nodes: numbers against what the nodes say, and what cannot be read by name."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.test_material_opacity import SQUARE, UVS, Nodes, image_of, square, with_uvs  # noqa: E402  (bpy decides)
from vir_addon.blender.materials import image_texels  # noqa: E402
from vir_addon.core.material import CornerValue, ImageSample, Layer, LayerKind  # noqa: E402
from vir_addon.core.material_program import evaluate_on_texels, sampled_images  # noqa: E402


@pytest.fixture
def look(take):
    return lambda **arguments: take(with_materials=True, **arguments)


def only_material(snapshot):
    (material,) = snapshot.materials
    return material


def value_of(expression):
    return pytest.approx(expression.value, abs=1e-6)


def test_principled_constants(add, look):
    nodes = Nodes("paint")
    node = nodes.principled()
    for name, value in {
        "Base Color": (0.8, 0.4, 0.2, 1.0),
        "Metallic": 0.25,
        "Roughness": 0.3,
        "IOR": 1.45,
        "Specular Tint": (0.5, 0.6, 0.7, 1.0),
        "Transmission Weight": 0.5,
        "Coat Weight": 0.75,
        "Coat Roughness": 0.1,
        "Coat IOR": 1.6,
        "Emission Color": (1.0, 0.5, 0.25, 1.0),
        "Emission Strength": 4.0,
    }.items():
        node.inputs[name].default_value = value
    square(add, nodes)
    snapshot = look()
    found = only_material(snapshot)
    assert found.name == "paint" and not found.is_fallback and not snapshot.left_out
    assert value_of(found.diffuse) == (0.3, 0.15, 0.075)
    assert value_of(found.dielectric_weight) == (0.75,) * 3 and value_of(found.metal_weight) == (0.25,) * 3
    assert value_of(found.metal) == (0.8, 0.4, 0.2) and value_of(found.specular_tint) == (0.5, 0.6, 0.7)
    assert value_of(found.ior) == (1.45,) * 3 and value_of(found.roughness) == (0.3,) * 3
    assert value_of(found.coat_weight) == (0.75,) * 3 and value_of(found.coat_ior) == (1.6,) * 3
    assert value_of(found.coat_roughness) == (0.1,) * 3 and value_of(found.emission) == (4.0, 2.0, 1.0)


def test_specular_level_scales_what_the_index_of_refraction_makes(add, look):
    nodes = Nodes()
    nodes.principled().inputs["Specular IOR Level"].default_value = 1.0
    square(add, nodes)
    root = np.sqrt(2.0) * 0.5 / 2.5
    assert ((1 + root) / (1 - root),) * 3 == value_of(only_material(look()).ior)


def test_nothing_is_read_unless_asked_for(add, take):
    square(add, Nodes())
    snapshot = take()
    assert snapshot.world is None and not snapshot.materials and snapshot.instances.material_set is None
    (mesh,) = snapshot.meshes
    assert not mesh.layers and mesh.material_slot is None


def test_images_with_mapping_and_their_uv_map(add, look):
    rgb = np.ones((2, 3, 4), np.float32)
    rgb[..., :3] = np.random.default_rng(1).integers(0, 256, (2, 3, 3)) / 255
    nodes = Nodes()
    texture = nodes.texture(image_of(rgb), extension="EXTEND", interpolation="Closest")
    uv_map, mapping = nodes("UVMap", uv_map="second"), nodes("Mapping")
    mapping.inputs["Location"].default_value = (0.25, 0.5, 0.0)
    mapping.inputs["Scale"].default_value = (2.0, 3.0, 1.0)
    nodes.link(uv_map.outputs[0], mapping.inputs["Vector"])
    nodes.link(mapping.outputs[0], texture.inputs["Vector"])
    nodes.link(texture.outputs["Color"], nodes.principled().inputs["Base Color"])
    shown = square(add, nodes)
    with_uvs(shown.data, "second", UVS * 0.5)
    snapshot = look()
    sample = only_material(snapshot).diffuse
    assert isinstance(sample, ImageSample) and sample.layer == Layer(LayerKind.UV, "second")
    np.testing.assert_array_equal(sample.image.texels, np.round(rgb[..., :3] * 255))
    assert sample.image.is_srgb and not sample.is_interpolated and sample.extension.value == "extend"
    np.testing.assert_allclose(sample.uv_rows, [[2, 0, 0.25], [0, 3, 0.5]], atol=1e-6)
    (mesh,) = snapshot.meshes
    assert set(mesh.layers) == {sample.layer}
    corners = np.take(UVS * 0.5, mesh.triangles, axis=0)
    np.testing.assert_allclose(mesh.layers[sample.layer], corners, atol=1e-6)


@pytest.mark.parametrize(("domain", "kind"), [("CORNER", "BYTE_COLOR"), ("POINT", "FLOAT_COLOR"), ("FACE", "FLOAT_COLOR")])
def test_color_attributes(add, look, domain, kind):
    nodes = Nodes()
    node = nodes("Attribute", attribute_name="tint")
    nodes.link(node.outputs["Color"], nodes.principled().inputs["Base Color"])
    vertices, faces = [*SQUARE[0], (2, 0.5, 0)], [(0, 1, 2, 3), (1, 4, 2)]
    shown = add.mesh("square", vertices, faces)
    shown.data.materials.append(nodes.material)
    attribute = shown.data.attributes.new("tint", kind, domain)
    colors = np.random.default_rng(3).integers(0, 256, (len(attribute.data), 4)) / 255
    attribute.data.foreach_set("color", colors.astype(np.float32).ravel())
    (mesh,) = look().meshes
    (values,) = mesh.layers.values()
    if domain == "POINT":
        expected = colors[mesh.triangles, :3]
    elif domain == "FACE":
        expected = np.repeat(colors[[0, 0, 1], None, :3], 3, axis=1)
    else:
        expected = colors[[[0, 1, 2], [0, 2, 3], [4, 5, 6]], :3]
    # bytes are sRGB-encoded
    np.testing.assert_allclose(values, expected, atol=0.03 if kind == "BYTE_COLOR" else 1e-6)


def test_slots_and_objects_own_materials(add, look):
    """One mesh with two slots; a second object puts another material into the first."""
    red, green, blue = Nodes("red"), Nodes("green"), Nodes("blue")
    for index, nodes in enumerate((red, green, blue)):
        color = [0.0, 0.0, 0.0, 1.0]
        color[index] = 1.0
        nodes.principled().inputs["Base Color"].default_value = color
    first = add.mesh("a", [*SQUARE[0], (2, 0, 0), (2, 1, 0)], [(0, 1, 2, 3), (1, 4, 5, 2)])
    first.data.materials.append(red.material)
    first.data.materials.append(green.material)
    first.data.polygons[1].material_index = 1
    second = add.object("b", first.data)
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = blue.material
    snapshot = look()
    (mesh,) = snapshot.meshes
    np.testing.assert_array_equal(mesh.material_slot, [0, 0, 1, 1])
    names = [[snapshot.materials[one].name for one in snapshot.material_sets[index]] for index in snapshot.instances.material_set]
    assert names == [["red", "green"], ["blue", "green"]]


def test_empty_slots_and_no_slots_are_blender_s_gray(add, look):
    add.cube("bare")
    shown = add.cube("empty slot")
    shown.data.materials.append(None)
    snapshot = look()
    assert len(snapshot.materials) == 1 and only_material(snapshot).diffuse.value == pytest.approx((0.8,) * 3)


def test_what_cannot_be_read_is_listed_and_the_rest_is_read(add, look):
    nodes = Nodes("marble")
    node = nodes.principled()
    nodes.material.diffuse_color = (0.1, 0.2, 0.3, 1.0)
    nodes.link(nodes("TexNoise").outputs["Color"], node.inputs["Base Color"])
    nodes.link(nodes("TexVoronoi").outputs["Distance"], node.inputs["Roughness"])
    nodes.link(nodes("Bump").outputs[0], node.inputs["Normal"])
    node.inputs["Metallic"].default_value = 0.5
    square(add, nodes)
    snapshot = look()
    found = only_material(snapshot)
    assert not found.is_fallback and value_of(found.diffuse) == (0.05, 0.1, 0.15) and value_of(found.metal_weight) == (0.5,) * 3
    assert {one.object_name for one in snapshot.left_out} == {"material marble"}
    assert {one.reason for one in snapshot.left_out} == {
        "is reflected in its viewport colour, because its Base Color depends on the node 'Noise Texture'",
        "is reflected with a plain Roughness, because that depends on the node 'Voronoi Texture'",
        "is reflected with plain normals, because they depend on the node 'Bump'",
    }


def test_shaders_that_cannot_be_read_have_the_viewport_s_colour(add, look):
    nodes = Nodes("hair")
    nodes.material.diffuse_color = (0.1, 0.2, 0.3, 1.0)
    nodes.link(nodes("BsdfHair").outputs[0], nodes.output.inputs["Surface"])
    square(add, nodes)
    snapshot = look()
    found = only_material(snapshot)
    assert found.is_fallback and value_of(found.diffuse) == (0.1, 0.2, 0.3)
    (left_out,) = snapshot.left_out
    assert left_out.object_name == "material hair" and "viewport colour" in left_out.reason and "Hair BSDF" in left_out.reason


def link_shaders(nodes, kind, first, second, factor=None):
    node = nodes(kind)
    offset = 1 if kind == "MixShader" else 0
    nodes.link(first.outputs[0], node.inputs[offset])
    nodes.link(second.outputs[0], node.inputs[offset + 1])
    if isinstance(factor, float):
        node.inputs[0].default_value = factor
    elif factor is not None:
        nodes.link(factor, node.inputs[0])
    nodes.link(node.outputs[0], nodes.output.inputs["Surface"])


def colored(nodes, kind, color, **inputs):
    node = nodes(kind)
    node.inputs["Color"].default_value = (*color, 1.0)
    for name, value in inputs.items():
        node.inputs[name].default_value = value
    return node


def test_mixed_shaders_mix_their_lobes(add, look):
    nodes = Nodes()
    glossy = colored(nodes, "BsdfGlossy", (0.9, 0.8, 0.7), Roughness=0.2)
    link_shaders(nodes, "MixShader", colored(nodes, "BsdfDiffuse", (0.4, 0.2, 0.0)), glossy, 0.25)
    square(add, nodes)
    found = only_material(look())
    assert value_of(found.diffuse) == (0.3, 0.15, 0.0) and value_of(found.metal_weight) == (0.25,) * 3
    assert value_of(found.metal) == (0.9, 0.8, 0.7) and value_of(found.roughness) == (0.2,) * 3
    assert not found.has_metal_fresnel and value_of(found.dielectric_weight) == (0.0,) * 3


def test_shaders_that_many_share_are_read_once(add, look):
    """2^30 ways through 30 nodes."""
    nodes = Nodes()
    last = colored(nodes, "BsdfDiffuse", (0.4, 0.2, 0.1))
    for _ in range(30):
        mix = nodes("MixShader")
        for socket in mix.inputs[1:]:
            nodes.link(last.outputs[0], socket)
        last = mix
    nodes.link(last.outputs[0], nodes.output.inputs["Surface"])
    square(add, nodes)
    assert value_of(only_material(look()).diffuse) == (0.4, 0.2, 0.1)


def test_added_emission(add, look):
    nodes = Nodes()
    link_shaders(
        nodes, "AddShader", colored(nodes, "BsdfDiffuse", (0.4, 0.2, 0.1)), colored(nodes, "Emission", (1.0, 0.5, 0.0), Strength=3.0)
    )
    square(add, nodes)
    found = only_material(look())
    assert value_of(found.diffuse) == (0.4, 0.2, 0.1) and value_of(found.emission) == (3.0, 1.5, 0.0)


def test_glossy_over_diffuse_by_fresnel_is_a_dielectric(add, look):
    nodes = Nodes()
    fresnel = nodes("Fresnel")
    fresnel.inputs["IOR"].default_value = 1.7
    glossy = colored(nodes, "BsdfGlossy", (1.0, 0.9, 0.8), Roughness=0.1)
    link_shaders(nodes, "MixShader", colored(nodes, "BsdfDiffuse", (0.4, 0.2, 0.0)), glossy, fresnel.outputs[0])
    square(add, nodes)
    found = only_material(look())
    assert value_of(found.diffuse) == (0.4, 0.2, 0.0) and value_of(found.dielectric_weight) == (1.0,) * 3
    assert value_of(found.ior) == (1.7,) * 3 and value_of(found.roughness) == (0.1,) * 3 and value_of(found.metal_weight) == (0.0,) * 3


def test_cut_outs_look_like_what_is_there(add, look):
    """A leaf: transparent mixed with diffuse by an image's alpha. Opacity is the mesh's, the material that of the leaf."""
    nodes = Nodes()
    texture = nodes.texture()
    transparent, diffuse = nodes("BsdfTransparent"), nodes("BsdfDiffuse")
    nodes.link(texture.outputs["Color"], diffuse.inputs["Color"])
    link_shaders(nodes, "MixShader", transparent, diffuse, texture.outputs["Alpha"])
    square(add, nodes)
    snapshot = look()
    (mesh,) = snapshot.meshes
    sample = only_material(snapshot).diffuse
    assert mesh.opacity_map is not None and isinstance(sample, ImageSample) and sample.divides_by_alpha
    np.testing.assert_allclose(mesh.layers[sample.layer].reshape(-1, 2), mesh.uvs, atol=1e-6)


def chain_value(nodes, output):
    """What a chain makes of a 1 x 1 image, as the material's diffuse colour."""
    node = nodes("BsdfDiffuse")
    nodes.link(output, node.inputs["Color"])
    nodes.link(node.outputs[0], nodes.output.inputs["Surface"])


GIVEN = np.array([0.2, 0.5, 0.8])


def set_inputs(node, **values):
    for name, value in values.items():
        next(socket for socket in node.inputs if socket.identifier == name).default_value = value
    return node


CHAINS = {
    "mix multiply": (
        lambda nodes: set_inputs(nodes("Mix", data_type="RGBA", blend_type="MULTIPLY"), Factor_Float=0.5, B_Color=(0.5, 0.0, 1.0, 1.0)),
        "A_Color",
        GIVEN * (0.75, 0.5, 1.0),
    ),
    "mix overlay": (
        lambda nodes: set_inputs(nodes("Mix", data_type="RGBA", blend_type="OVERLAY"), Factor_Float=1.0, B_Color=(0.5, 0.3, 0.9, 1.0)),
        "A_Color",
        (0.2, 0.3, 1 - 2 * 0.2 * 0.1),
    ),
    "invert": (lambda nodes: set_inputs(nodes("Invert"), Fac=0.5), "Color", (0.5, 0.5, 0.5)),
    "gamma": (lambda nodes: set_inputs(nodes("Gamma"), Gamma=2.0), "Color", GIVEN**2),
    "bright and contrast": (lambda nodes: set_inputs(nodes("BrightContrast"), Bright=0.1, Contrast=0.5), "Color", GIVEN * 1.5 + 0.1 - 0.25),
    "hue": (lambda nodes: set_inputs(nodes("HueSaturation"), Hue=0.5 + 1 / 3), "Color", GIVEN[[2, 0, 1]]),
    "saturation": (lambda nodes: set_inputs(nodes("HueSaturation"), Saturation=0.0, Value=0.5), "Color", (0.4, 0.4, 0.4)),
    "to gray": (lambda nodes: nodes("RGBToBW"), "Color", (GIVEN @ (0.2126, 0.7152, 0.0722),) * 3),
}


@pytest.mark.parametrize("name", CHAINS)
def test_chains(add, look, name):
    make, identifier, expected = CHAINS[name]
    nodes = Nodes()
    image = image_of(np.full((1, 1, 4), [*GIVEN, 1.0], np.float32), color_space="Non-Color", use_generated_float=True)
    node = make(nodes)
    nodes.link(nodes.texture(image).outputs["Color"], next(socket for socket in node.inputs if socket.identifier == identifier))
    output = next(out for out in node.outputs if out.enabled)
    chain_value(nodes, output)
    square(add, nodes)
    snapshot = look()
    assert not snapshot.left_out
    expression = only_material(snapshot).diffuse
    (sampled,) = sampled_images(expression)
    np.testing.assert_allclose(evaluate_on_texels(expression, sampled)[0, 0], expected, atol=4e-3)


def test_node_loops_and_long_chains_are_refused_in_words(add, look):
    nodes = Nodes("loop")
    first, second = nodes("Gamma"), nodes("Gamma")
    nodes.link(first.outputs[0], second.inputs["Color"])
    nodes.link(second.outputs[0], first.inputs["Color"])
    chain_value(nodes, second.outputs[0])
    square(add, nodes, "first")
    long = Nodes("long")
    last = long("RGB").outputs[0]
    for _ in range(400):
        node = long("Gamma")
        long.link(last, node.inputs["Color"])
        last = node.outputs[0]
    chain_value(long, last)
    square(add, long, "second")
    reasons = {one.object_name: one.reason for one in look().left_out}
    assert "one behind the other" in reasons["material long"]
    assert "links that go in a circle" in reasons["material loop"]
    assert reasons.keys() == {"material long", "material loop"}


def test_links_between_sockets_that_do_not_fit_are_not_loops(add, look):
    """Such links are not valid either; what they lead to has its own value, as in Cycles."""
    nodes = Nodes("misfit")
    nodes.link(nodes("Emission").outputs[0], nodes.principled().inputs["Base Color"])
    square(add, nodes)
    assert not look().left_out


def test_missing_images_are_named(add, look):
    nodes = Nodes("poster")
    image = bpy.data.images.new("lost", 4, 4)
    image.source, image.filepath = "FILE", "//nowhere/lost.png"
    nodes.link(nodes.texture(image).outputs["Color"], nodes.principled().inputs["Base Color"])
    square(add, nodes)
    (left_out,) = look().left_out
    assert left_out.object_name == "material poster" and "'lost', which is missing" in left_out.reason


def test_large_images_are_used_smaller(add, look):
    nodes = Nodes()
    rgba = np.ones((8, 5000, 4), np.float32)
    rgba[:, ::2, 0] = 0.0
    nodes.link(nodes.texture(image_of(rgba, "wide")).outputs["Color"], nodes.principled().inputs["Base Color"])
    square(add, nodes)
    snapshot = look()
    texels = only_material(snapshot).diffuse.image.texels
    assert texels.shape == (3, 2048, 3)
    assert np.abs(texels[..., 0].mean() - 127.5) < 1.0
    assert any("'wide' is used at 2048 x 3 instead of 5000 x 8" in note for note in snapshot.notes)


def saved_image(tmp_path, name, pixels):
    made = image_of(pixels, name)
    made.filepath_raw, made.file_format = str(tmp_path / f"{name}.png"), "PNG"
    made.save()
    bpy.data.images.remove(made)
    return bpy.data.images.load(str(tmp_path / f"{name}.png"))


def test_images_too_large_for_memory_are_read_smaller_or_refused(add, look, tmp_path, monkeypatch):
    """With limits of a few pixels, so that a small image is too large."""
    monkeypatch.setattr(image_texels, "LARGEST_PX", 63)
    monkeypatch.setattr(image_texels, "MAX_SIDE_PX", 4)
    monkeypatch.setattr(image_texels, "_STRIP_PX", 32)
    pixels = np.ones((9, 8, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(1).integers(0, 256, (9, 8, 3)) / 255
    from_file, generated = Nodes("from a file"), Nodes("generated")
    for nodes, image in ((from_file, saved_image(tmp_path, "huge", pixels)), (generated, image_of(pixels, "painted"))):
        nodes.link(nodes.texture(image).outputs["Color"], nodes.principled().inputs["Base Color"])
        square(add, nodes, nodes.material.name)
    snapshot = look()
    refused = {one.object_name: one.reason for one in snapshot.left_out}
    if bpy.app.version >= (5, 2):
        read = next(material for material in snapshot.materials if material.name == "from a file").diffuse.image
        expected = 255 * pixels[:8, :, :3].reshape(4, 2, 4, 2, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(read.texels, expected, atol=0.51)
        assert refused.keys() == {"material generated"}
    assert "'painted', which is too large (8 x 9 pixels)" in refused["material generated"]


def test_normal_maps(add, look):
    nodes = Nodes()
    node = nodes.principled()
    normal = nodes("NormalMap", uv_map="UVMap")
    normal.inputs["Strength"].default_value = 0.7
    nodes.link(
        nodes.texture(image_of(np.full((2, 2, 4), 0.5, np.float32), color_space="Non-Color")).outputs["Color"], normal.inputs["Color"]
    )
    nodes.link(normal.outputs[0], node.inputs["Normal"])
    square(add, nodes)
    snapshot = look()
    found = only_material(snapshot).normal_map
    assert found.layer == Layer(LayerKind.UV, "UVMap") and value_of(found.strength) == (0.7,) * 3
    assert isinstance(found.color, ImageSample) and not found.color.image.is_srgb


def test_groups_share_what_they_read(add, look):
    tree = bpy.data.node_groups.new("Tint", "ShaderNodeTree")
    tree.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
    tree.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    entry, gamma, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("ShaderNodeGamma"), tree.nodes.new("NodeGroupOutput")
    gamma.inputs["Gamma"].default_value = 2.0
    tree.links.new(entry.outputs[0], gamma.inputs["Color"])
    tree.links.new(gamma.outputs[0], end.inputs[0])
    nodes = Nodes()
    shader = nodes.principled()
    for index, name in enumerate(("Base Color", "Emission Color")):
        group = nodes("Group", node_tree=tree)
        group.inputs[0].default_value = (0.5 + 0.25 * index,) * 3 + (1.0,)
        nodes.link(group.outputs[0], shader.inputs[name])
    shader.inputs["Emission Strength"].default_value = 1.0
    square(add, nodes)
    found = only_material(look())
    assert value_of(found.diffuse) == (0.25,) * 3 and value_of(found.emission) == (0.5625,) * 3


def test_vertex_color_of_what_is_rendered(add, look):
    nodes = Nodes()
    nodes.link(nodes("VertexColor").outputs["Color"], nodes.principled().inputs["Base Color"])
    shown = square(add, nodes)
    for name, value in (("first", 0.25), ("rendered", 0.75)):
        attribute = shown.data.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
        attribute.data.foreach_set("color", np.full(16, value, np.float32))
    shown.data.color_attributes.render_color_index = 1
    snapshot = look()
    (mesh,) = snapshot.meshes
    assert only_material(snapshot).diffuse == CornerValue(Layer(LayerKind.COLOR))
    np.testing.assert_allclose(mesh.layers[Layer(LayerKind.COLOR)], 0.75)


def test_marks_and_visibility_in_reflections(add, look):
    for name, mark in (("a", None), ("b", 0), ("c", 1)):
        shown = add.cube(name)
        if mark is not None:
            shown["vir_reflector"] = mark
        shown.visible_glossy = mark != 0
    instances = look().instances
    np.testing.assert_array_equal(instances.reflector_mark, [-1, 0, 1])
    np.testing.assert_array_equal(instances.visible_in_reflections, [True, False, True])


# the world


def world_nodes(scene):
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    return tree, next(node for node in tree.nodes if node.type == "BACKGROUND")


def test_worlds_of_one_color(scene, add, look):
    add.cube()
    assert look().world.radiance == (0.0, 0.0, 0.0)
    _, background = world_nodes(scene)
    background.inputs["Color"].default_value = (0.5, 0.25, 1.0, 1.0)
    background.inputs["Strength"].default_value = 2.0
    assert look().world.radiance == pytest.approx((1.0, 0.5, 2.0))


def test_worlds_of_an_image(scene, add, look):
    add.cube()
    tree, background = world_nodes(scene)
    sky = bpy.data.images.new("sky", 4, 2, float_buffer=True)
    sky.pixels.foreach_set(np.full((2, 4, 4), [4.0, 2.0, 1.0, 1.0], np.float32).ravel())
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = sky
    mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, np.pi / 2)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = 0.5
    snapshot = look()
    world = snapshot.world
    np.testing.assert_allclose(world.image.texels[0, 0] * np.array(world.radiance), (2.0, 1.0, 0.5), atol=1e-3)
    np.testing.assert_allclose(world.image_from_world, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)


def test_worlds_that_cannot_be_read_are_named(scene, add, look):
    add.cube()
    tree, background = world_nodes(scene)
    scene.world.color = (0.1, 0.2, 0.3)
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], background.inputs["Color"])
    snapshot = look()
    assert snapshot.world.is_fallback and snapshot.world.radiance == pytest.approx((0.1, 0.2, 0.3))
    (left_out,) = snapshot.left_out
    assert left_out.object_name == "world World" and "Sky Texture" in left_out.reason
