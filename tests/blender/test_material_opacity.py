"""Opacity maps read from materials: values against what the nodes say, uvs against Blender's own, and refusals by name."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.core.material import Extension  # noqa: E402  (bpy decides whether this file runs)

SQUARE = ([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
UVS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
ALPHA = np.array([[0, 51, 102, 153], [204, 255, 0, 255]], np.uint8)


def image_of(rgba, name="image", *, color_space="sRGB", **properties):
    height, width, _ = rgba.shape
    made = bpy.data.images.new(name, width, height, alpha=True)
    made.colorspace_settings.name = color_space
    for key, value in properties.items():
        setattr(made, key, value)
    made.pixels.foreach_set(np.asarray(rgba, np.float32).ravel())
    made.update()
    return made


def alpha_image(alpha=ALPHA, **properties):
    rgba = np.ones((*alpha.shape, 4), np.float32)
    rgba[..., 3] = alpha / 255
    return image_of(rgba, **properties)


class Nodes:
    """A material's tree, emptied but for its output; `nodes(kind, property=value)` adds a node."""

    def __init__(self, name="leaf"):
        self.material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0):
            self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.output = self("OutputMaterial")

    def __call__(self, kind, **properties):
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for key, value in properties.items():
            setattr(node, key, value)
        return node

    def link(self, output, socket):
        self.tree.links.new(output, socket)

    def principled(self, alpha=None):
        """alpha: an output socket or a number"""
        node = self("BsdfPrincipled")
        self.link(node.outputs[0], self.output.inputs["Surface"])
        if isinstance(alpha, float):
            node.inputs["Alpha"].default_value = alpha
        elif alpha is not None:
            self.link(alpha, node.inputs["Alpha"])
        return node

    def texture(self, image=None, **properties):
        return self("TexImage", image=image or alpha_image(), **properties)


def with_uvs(data, name="UVMap", uvs=UVS):
    data.uv_layers.new(name=name).uv.foreach_set("vector", np.asarray(uvs, np.float32).ravel())


def square(add, nodes, name="square", uvs=UVS, **properties):
    shown = add.mesh(name, *SQUARE, **properties)
    with_uvs(shown.data, uvs=uvs)
    shown.data.materials.append(nodes.material)
    return shown


def only_mesh(snapshot):
    (mesh,) = snapshot.meshes
    return mesh


def opacities(mesh):
    return mesh.opacity_map.opacity[mesh.opacity_map.texels]


def test_linked_alpha(add, take):
    nodes = Nodes()
    nodes.principled(nodes.texture().outputs["Alpha"])
    shown = square(add, nodes)
    mesh = only_mesh(take())
    np.testing.assert_array_equal(mesh.opacity_map.texels, ALPHA)
    np.testing.assert_allclose(opacities(mesh), ALPHA / 255, atol=1e-6)
    assert mesh.opacity_map.extension is Extension.REPEAT and mesh.opacity_map.is_interpolated
    # the square's own corners: u is x and v is y
    np.testing.assert_array_equal(mesh.uvs, mesh.positions_os[:, :2])
    assert mesh.triangle_count == 2 and not mesh.is_closed and shown.name == "square"


def test_nothing_is_read_where_materials_are_opaque(add, take):
    nodes = Nodes()
    nodes.principled()
    square(add, nodes)
    opaque_image = Nodes("importer's")
    opaque_image.principled(opaque_image.texture(alpha_image(np.full((2, 2), 255))).outputs["Alpha"])
    square(add, opaque_image, "second")
    add.cube("without a material")
    snapshot = take()
    assert len(snapshot.meshes) == 3 and not snapshot.left_out
    for mesh in snapshot.meshes:
        assert mesh.opacity_map is None and mesh.uvs is None


def mixed(nodes, factor, first, second):
    mix = nodes("MixShader")
    for index, shader in enumerate((first, second)):
        nodes.link(nodes(shader).outputs[0], mix.inputs[1 + index])
    nodes.link(factor, mix.inputs[0])
    nodes.link(mix.outputs[0], nodes.output.inputs["Surface"])


def linear(encoded):
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def math_node(nodes, operation, source, value):
    node = nodes("Math", operation=operation)
    nodes.link(source, node.inputs[0])
    node.inputs[1].default_value = value
    return node.outputs[0]


def chain(nodes, *operations):
    source = nodes.texture().outputs["Alpha"]
    for operation, value in operations:
        source = math_node(nodes, operation, source, value)
    nodes.principled(source)


def ramp(nodes):
    node = nodes("ValToRGB")
    node.color_ramp.elements[0].position, node.color_ramp.elements[1].position = 0.2, 0.6
    nodes.link(nodes.texture().outputs["Alpha"], node.inputs[0])
    nodes.principled(node.outputs["Color"])


def inverted(nodes):
    node = nodes("Invert")
    nodes.link(nodes.texture().outputs["Alpha"], node.inputs["Color"])
    nodes.principled(node.outputs[0])


def grouped(nodes):
    """The texture inside a group, its alpha through a reroute and out."""
    group = bpy.data.node_groups.new("group", "ShaderNodeTree")
    group.interface.new_socket("Alpha", in_out="OUTPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Scale", in_out="INPUT", socket_type="NodeSocketFloat")
    texture, times = group.nodes.new("ShaderNodeTexImage"), group.nodes.new("ShaderNodeMath")
    texture.image, times.operation = alpha_image(), "MULTIPLY"
    start, end, reroute = (group.nodes.new(kind) for kind in ("NodeGroupInput", "NodeGroupOutput", "NodeReroute"))
    # one after the other: a reroute's sockets take the type of what is linked to them
    group.links.new(texture.outputs["Alpha"], times.inputs[0])
    group.links.new(start.outputs["Scale"], times.inputs[1])
    group.links.new(times.outputs[0], reroute.inputs[0])
    group.links.new(reroute.outputs[0], end.inputs["Alpha"])
    node = nodes("Group", node_tree=group)
    node.inputs["Scale"].default_value = 0.5
    nodes.principled(node.outputs["Alpha"])


A = ALPHA / 255
CHAINS = {
    "greater than": (lambda nodes: chain(nodes, ("GREATER_THAN", 0.5)), A > 0.5),
    "less than": (lambda nodes: chain(nodes, ("LESS_THAN", 0.5)), A < 0.5),
    "round": (lambda nodes: chain(nodes, ("ROUND", 0.0)), A > 0.5),
    "scaled and moved": (lambda nodes: chain(nodes, ("MULTIPLY", 3.0), ("SUBTRACT", 0.5)), np.clip(3 * A - 0.5, 0, 1)),
    "power": (lambda nodes: chain(nodes, ("POWER", 2.0)), A**2),
    "inverted": (inverted, 1 - A),
    "ramp": (ramp, np.clip((A - 0.2) / 0.4, 0, 1)),
    "group": (grouped, A / 2),
    "mixed with what is transparent": (
        lambda nodes: mixed(nodes, nodes.texture().outputs["Alpha"], "BsdfTransparent", "BsdfDiffuse"),
        A,
    ),
    "mixed the other way around": (
        lambda nodes: mixed(nodes, nodes.texture().outputs["Alpha"], "BsdfDiffuse", "BsdfTransparent"),
        1 - A,
    ),
}


@pytest.mark.parametrize("name", CHAINS)
def test_chains(add, take, name):
    build, expected = CHAINS[name]
    nodes = Nodes()
    build(nodes)
    square(add, nodes)
    snapshot = take()
    assert not snapshot.left_out
    # a ramp's own table and 8 bits
    np.testing.assert_allclose(opacities(only_mesh(snapshot)), expected, atol=0.006)


COLORS = np.array([[(0.2, 0.2, 0.2), (0.8, 0.4, 0.1)], [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]])
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("color_space", ["sRGB", "Non-Color"])
def test_a_colour_counts_with_its_luminance(add, take, color_space):
    nodes = Nodes()
    rgba = np.concatenate([COLORS, np.ones((2, 2, 1))], axis=-1)
    nodes.principled(nodes.texture(image_of(rgba, color_space=color_space)).outputs["Color"])
    square(add, nodes)
    decoded = linear(COLORS) if color_space == "sRGB" else COLORS
    np.testing.assert_allclose(opacities(only_mesh(take())), decoded @ LUMINANCE, atol=0.006)


def test_one_channel_of_a_colour(add, take):
    nodes = Nodes()
    separate = nodes("SeparateColor")
    rgba = np.concatenate([COLORS, np.ones((2, 2, 1))], axis=-1)
    nodes.link(nodes.texture(image_of(rgba, color_space="Non-Color")).outputs["Color"], separate.inputs[0])
    nodes.principled(separate.outputs["Green"])
    square(add, nodes)
    np.testing.assert_allclose(opacities(only_mesh(take())), COLORS[..., 1], atol=0.003)


def test_mapping_and_a_named_uv_map(add, take):
    nodes = Nodes()
    texture, mapping, uv_map = nodes.texture(extension="CLIP", interpolation="Closest"), nodes("Mapping"), nodes("UVMap", uv_map="second")
    nodes.link(uv_map.outputs[0], mapping.inputs["Vector"])
    nodes.link(mapping.outputs[0], texture.inputs["Vector"])
    mapping.inputs["Location"].default_value = (0.25, -0.5, 0.0)
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, np.pi / 2)
    mapping.inputs["Scale"].default_value = (2.0, 3.0, 1.0)
    nodes.principled(texture.outputs["Alpha"])
    shown = square(add, nodes)
    with_uvs(shown.data, "second", UVS[::-1])
    mesh = only_mesh(take())
    corner = np.array([UVS.tolist().index(list(place)) for place in mesh.positions_os[:, :2].astype(float)])
    u, v = UVS[::-1][corner].T
    # scaled, turned by a quarter, moved
    np.testing.assert_allclose(mesh.uvs, np.column_stack([-3 * v + 0.25, 2 * u - 0.5]), atol=1e-6)
    assert mesh.opacity_map.extension is Extension.CLIP and not mesh.opacity_map.is_interpolated


def test_a_texture_mapping_is_the_inverse_of_a_point_mapping(add, take):
    nodes = Nodes()
    coordinates, texture = nodes("TexCoord").outputs["UV"], nodes.texture()
    for kind in ("POINT", "TEXTURE"):
        mapping = nodes("Mapping", vector_type=kind)
        mapping.inputs["Location"].default_value = (0.25, -0.5, 0.0)
        mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.7)
        mapping.inputs["Scale"].default_value = (2.0, 3.0, 1.0)
        nodes.link(coordinates, mapping.inputs["Vector"])
        coordinates = mapping.outputs[0]
    nodes.link(coordinates, texture.inputs["Vector"])
    nodes.principled(texture.outputs["Alpha"])
    square(add, nodes)
    mesh = only_mesh(take())
    np.testing.assert_allclose(mesh.uvs, mesh.positions_os[:, :2], atol=1e-6)


def test_a_packed_image(add, take, tmp_path):
    made = alpha_image(name="packed")
    made.filepath_raw, made.file_format = str(tmp_path / "leaf.png"), "PNG"
    made.save()
    loaded = bpy.data.images.load(str(tmp_path / "leaf.png"))
    loaded.pack()
    (tmp_path / "leaf.png").unlink()
    nodes = Nodes()
    nodes.principled(nodes.texture(loaded).outputs["Alpha"])
    square(add, nodes)
    np.testing.assert_array_equal(only_mesh(take()).opacity_map.texels, ALPHA)


def test_large_images_are_shrunk_and_said(add, take, monkeypatch):
    from vir_addon.blender.materials import image_texels

    monkeypatch.setattr(image_texels, "MAX_SIDE_PX", 16)
    nodes = Nodes()
    alpha = np.repeat(np.repeat(ALPHA, 10, axis=0), 10, axis=1)  # 40 x 20
    nodes.principled(nodes.texture(alpha_image(alpha)).outputs["Alpha"])
    square(add, nodes)
    snapshot = take()
    texels = only_mesh(snapshot).opacity_map.texels
    assert texels.shape == (8, 16)
    assert abs(texels.mean() - ALPHA.mean()) < 1.0
    (note,) = snapshot.notes
    assert "'image'" in note and "40 x 20" in note and not snapshot.left_out


def missing_file(nodes):
    image = bpy.data.images.new("gone", 4, 4)
    image.source, image.filepath = "FILE", "//gone.png"
    nodes.principled(nodes.texture(image).outputs["Alpha"])


def no_image(nodes):
    nodes.principled(nodes("TexImage").outputs["Alpha"])


def procedural(nodes):
    nodes.principled(nodes("TexNoise").outputs[0])


def two_images(nodes):
    times = math_node(nodes, "MULTIPLY", nodes.texture().outputs["Alpha"], 1.0)
    nodes.link(nodes.texture(alpha_image(ALPHA[::-1])).outputs["Alpha"], times.node.inputs[1])
    nodes.principled(times)


def object_coordinates(nodes):
    texture = nodes.texture()
    nodes.link(nodes("TexCoord").outputs["Object"], texture.inputs["Vector"])
    nodes.principled(texture.outputs["Alpha"])


def shadow_ray(nodes):
    mixed(nodes, nodes("LightPath").outputs["Is Shadow Ray"], "BsdfDiffuse", "BsdfTransparent")


REFUSED = {
    "a missing file": (missing_file, "gone"),
    "no image": (no_image, "no image"),
    "a procedural texture": (procedural, "Noise"),
    "two images": (two_images, "more than one texture"),
    "coordinates of the object": (object_coordinates, "Texture Coordinate"),
    "the kind of ray": (shadow_ray, "Light Path"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_opaque_and_named(add, take, name):
    build, word = REFUSED[name]
    nodes = Nodes("puzzling")
    build(nodes)
    square(add, nodes)
    snapshot = take()
    assert only_mesh(snapshot).opacity_map is None
    (left_out,) = snapshot.left_out
    assert left_out.object_name == "material puzzling" and "opaque" in left_out.reason and word in left_out.reason


def test_a_mesh_without_the_uv_map_is_opaque_and_named(add, take):
    nodes = Nodes()
    nodes.principled(nodes.texture().outputs["Alpha"])
    add.mesh("bare", *SQUARE).data.materials.append(nodes.material)
    snapshot = take()
    assert only_mesh(snapshot).opacity_map is None
    (left_out,) = snapshot.left_out
    assert left_out.object_name == "bare" and "UV map" in left_out.reason


def test_constants(add, take):
    """An opacity of 0.3 needs no uvs; of a material that is not there at all nothing remains."""
    for value, name in ((0.3, "pane"), (0.0, "nothing")):
        nodes = Nodes(name)
        nodes.principled(value)
        add.mesh(name, *SQUARE).data.materials.append(nodes.material)
    snapshot = take()
    assert snapshot.instances.object_names == ("pane",)
    np.testing.assert_allclose(opacities(only_mesh(snapshot)), 0.3)


def test_a_volume_has_no_surface(add, take):
    nodes = Nodes("fog")
    nodes.link(nodes("VolumePrincipled").outputs[0], nodes.output.inputs["Volume"])
    add.cube("domain").data.materials.append(nodes.material)
    add.cube("other")
    snapshot = take()
    assert snapshot.instances.object_names == ("other",)
    assert [one.object_name for one in snapshot.left_out] == ["material fog"]


def two_squares(add):
    return add.mesh("plant", [*SQUARE[0], *((x + 2, y, 0) for x, y, _ in SQUARE[0])], [(0, 1, 2, 3), (4, 5, 6, 7)])


def test_a_mesh_of_two_materials_is_taken_apart(add, take):
    leaf, stem = Nodes("leaf"), Nodes("stem")
    leaf.principled(leaf.texture().outputs["Alpha"])
    stem.principled()
    shown = two_squares(add)
    with_uvs(shown.data, uvs=np.tile(UVS, (2, 1)))
    for nodes in (stem, leaf):
        shown.data.materials.append(nodes.material)
    shown.data.polygons[1].material_index = 1
    snapshot = take()
    opaque, cut_out = sorted(snapshot.meshes, key=lambda mesh: mesh.opacity_map is not None)
    assert opaque.opacity_map is None and cut_out.opacity_map is not None
    assert opaque.positions_os[:, 0].max() == 1.0 and cut_out.positions_os[:, 0].min() == 2.0
    assert opaque.triangle_count == cut_out.triangle_count == 2
    assert snapshot.instances.object_names == ("plant",) and len(snapshot.instances) == 2
    assert len(set(snapshot.instances.stable_id.tolist())) == 1


def test_an_objects_own_material_counts(add, take):
    """Both objects share a mesh; one of them gives it another material."""
    leaf, plain = Nodes("leaf"), Nodes("plain")
    leaf.principled(leaf.texture().outputs["Alpha"])
    plain.principled()
    first = square(add, plain, "first")
    second = add.object("second", first.data)
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = leaf.material
    snapshot = take()
    maps = [snapshot.meshes[index].opacity_map is not None for index in snapshot.instances.mesh_index]
    assert maps == [False, True]


def test_without_transparent_shadows_it_is_seen_through_and_casts_as_a_whole(add, take):
    nodes = Nodes()
    nodes.principled(nodes.texture().outputs["Alpha"])
    nodes.material.use_transparent_shadow = False
    square(add, nodes)
    snapshot = take()
    roles = {
        (snapshot.meshes[mesh].opacity_map is not None, bool(visible), bool(casts))
        for mesh, visible, casts in zip(
            snapshot.instances.mesh_index, snapshot.instances.visible_to_camera, snapshot.instances.casts_shadow, strict=True
        )
    }
    assert roles == {(True, True, False), (False, False, True)}


def test_the_view_layers_override_replaces_all_materials(scene, add, take):
    nodes, white = Nodes(), Nodes("white")
    nodes.principled(nodes.texture().outputs["Alpha"])
    white.principled()
    square(add, nodes)
    scene.view_layers[0].material_override = white.material
    assert only_mesh(take()).opacity_map is None


def test_smooth_normals_and_dropped_triangles_keep_their_corners(add, take):
    nodes = Nodes()
    nodes.principled(nodes.texture().outputs["Alpha"])
    shown = two_squares(add)
    with_uvs(shown.data, uvs=np.tile(UVS, (2, 1)))
    shown.data.materials.append(nodes.material)
    shown.data.polygons.foreach_set("use_smooth", [True, True])
    shown.data.vertices[0].co = (np.inf, 0, 0)
    mesh = only_mesh(take())
    assert mesh.triangle_count == 2
    np.testing.assert_allclose(mesh.uvs, mesh.positions_os[:, :2] - [2, 0])
    np.testing.assert_allclose(mesh.point_normals_os, [(0, 0, 1)] * 6)


@pytest.mark.parametrize(("color_space", "share"), [("sRGB", 0.25), ("Non-Color", 0.5)])
def test_only_colours_are_multiplied_with_their_alpha(add, take, color_space, share):
    """Gray of 0.5 with an alpha of 0.5, whose colour alone is asked for: Cycles and EEVEE leave data as it is."""
    nodes = Nodes()
    texture = nodes.texture(image_of(np.full((2, 2, 4), 0.5), color_space=color_space, alpha_mode="STRAIGHT"))
    mixed(nodes, texture.outputs["Color"], "BsdfTransparent", "BsdfDiffuse")
    square(add, nodes)
    mesh = only_mesh(take())
    expected = linear(np.array(share)) if color_space == "sRGB" else share
    np.testing.assert_allclose(opacities(mesh), expected, atol=3e-3)


@pytest.mark.skipif(bpy.app.version < (5, 2), reason="Cycles 4.5 reads alpha of files otherwise; VIR does as 5.2")
@pytest.mark.parametrize("is_packed", [False, True])
def test_colours_of_premultiplied_files(add, take, tmp_path, is_packed):
    """A gray of 0.5, which is in the file. Blender divides it by the alpha of 0.6; Cycles takes that of packed files only."""
    path = tmp_path / "image.png"
    pytest.importorskip("PIL.Image").fromarray(np.full((2, 2, 4), (128, 128, 128, 153), np.uint8), "RGBA").save(path)
    image = bpy.data.images.load(str(path))
    image.alpha_mode = "PREMUL"
    if is_packed:
        image.pack()
    nodes = Nodes()
    mixed(nodes, nodes.texture(image).outputs["Color"], "BsdfTransparent", "BsdfDiffuse")
    square(add, nodes)
    expected = linear(np.array(128 / 153 if is_packed else 128 / 255))
    np.testing.assert_allclose(opacities(only_mesh(take())), expected, atol=4e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.5])
def test_colours_of_premultiplied_floats(add, take, tmp_path, alpha):
    """Gray as it is in the file, also where it covers nothing."""
    path = tmp_path / "image.exr"
    rgba = np.full((2, 2, 4), (0.4, 0.4, 0.4, alpha), np.float32)
    pytest.importorskip("OpenEXR").File({}, {"RGBA": rgba}).write(str(path))
    image = bpy.data.images.load(str(path))
    assert image.alpha_mode == "PREMUL"
    image.colorspace_settings.name = "Linear Rec.709"
    nodes = Nodes()
    mixed(nodes, nodes.texture(image).outputs["Color"], "BsdfTransparent", "BsdfDiffuse")
    square(add, nodes)
    np.testing.assert_allclose(opacities(only_mesh(take())), 0.4, atol=4e-3)
