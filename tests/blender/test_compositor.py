"""The node group: right values in a render, the artist's nodes and links untouched."""

import numpy as np
import OpenEXR
import pytest

bpy = pytest.importorskip("bpy")

# bpy decides whether this file runs
from vir_addon.blender.compositor import GROUP_NAME, WITH_REFLECTIONS, WITHOUT_REFLECTIONS, add_pass_nodes  # noqa: E402
from vir_addon.blender.images import write_images  # noqa: E402
from vir_addon.core import pass_set  # noqa: E402
from vir_addon.core.errors import SceneError  # noqa: E402
from vir_addon.core.exr import write_exr  # noqa: E402
from vir_addon.core.pass_set import PassSet, SetStatistics, unique_pass_names  # noqa: E402

SIZE_PX = 48
KEY, FILL, ALL = "VIR Shadow Key", "VIR Shadow Fill", "VIR Shadow"
REFLECTION, COLOR = pass_set.REFLECTION_PASS_NAME, pass_set.REFLECTION_COLOR_PASS_NAME


@pytest.fixture
def scene():
    """A cube lit from the side, rendered by Workbench into a linear 32-bit EXR."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, 0.0, 6.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_x = scene.render.resolution_y = SIZE_PX
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    return scene


def passes_of(*names: str) -> PassSet:
    random = np.random.default_rng(3)
    return PassSet({name: random.random((SIZE_PX, SIZE_PX), dtype=np.float32) for name in names}, SetStatistics())


def tree_of(scene):
    return scene.compositing_node_group if bpy.app.version >= (5, 0) else scene.node_tree


def picture_input(tree):
    """The socket whose colour becomes the render."""
    wanted = "NodeGroupOutput" if bpy.app.version >= (5, 0) else "CompositorNodeComposite"
    return next(node for node in tree.nodes if node.bl_idname == wanted).inputs["Image"]


def render(scene, path) -> np.ndarray:
    """(height, width, 3 or 4) float32, row 0 at the bottom"""
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        return np.array(channels.get("RGBA", channels.get("RGB")).pixels)[::-1]


def links_of(tree) -> set[tuple[str, str, str, str]]:
    return {(link.from_node.name, link.from_socket.name, link.to_node.name, link.to_socket.name) for link in tree.links}


def test_a_linked_output_renders_as_the_pass(scene, tmp_path):
    passes = passes_of(ALL, KEY)
    node = add_pass_nodes(scene, write_images(passes)).node
    tree = tree_of(scene)
    tree.links.new(node.outputs[KEY], picture_input(tree))
    picture = render(scene, tmp_path / "key.exr")
    for channel in range(3):
        np.testing.assert_array_equal(picture[..., channel], passes.images[KEY])


def test_pictures_written_later_reach_the_same_output(scene, tmp_path):
    node = add_pass_nodes(scene, write_images(passes_of(KEY))).node
    tree = tree_of(scene)
    tree.links.new(node.outputs[KEY], picture_input(tree))
    render(scene, tmp_path / "first.exr")
    later = PassSet({KEY: np.full((SIZE_PX, SIZE_PX), 0.25, np.float32)}, SetStatistics())
    write_images(later, pack=False)
    assert (render(scene, tmp_path / "second.exr")[..., :3] == 0.25).all()


def test_a_scene_without_compositor_renders_as_before(scene, tmp_path):
    before = render(scene, tmp_path / "before.exr")
    assert before[..., :3].std() > 0.01, "the cube is not in the picture"
    add_pass_nodes(scene, write_images(passes_of(ALL, KEY)))
    np.testing.assert_array_equal(render(scene, tmp_path / "after.exr"), before)


def test_an_artists_tree_is_left_as_it_is(scene):
    add_pass_nodes(scene, {})  # makes a compositor
    tree = tree_of(scene)
    tree.nodes.remove(tree.nodes[GROUP_NAME])
    blur = tree.nodes.new("CompositorNodeBlur")
    blur.location = (900.0, -700.0)
    tree.links.new(blur.outputs["Image"], picture_input(tree))
    before = {node.name: tuple(node.location) for node in tree.nodes}, links_of(tree)
    node = add_pass_nodes(scene, write_images(passes_of(ALL, KEY))).node
    assert ({other.name: tuple(other.location) for other in tree.nodes if other != node}, links_of(tree)) == before
    assert node.location.y < -700.0


def test_twice_is_once(scene):
    images = write_images(passes_of(ALL, KEY))
    first = add_pass_nodes(scene, images)
    assert first.added == [ALL, KEY]
    tree = tree_of(scene)
    tree.links.new(first.node.outputs[KEY], picture_input(tree))
    counts = len(tree.nodes), len(first.node.node_tree.nodes), len(bpy.data.node_groups), links_of(tree)
    second = add_pass_nodes(scene, images)
    assert second.node == first.node
    assert (second.added, second.removed, second.kept) == ([], [], [])
    assert (len(tree.nodes), len(first.node.node_tree.nodes), len(bpy.data.node_groups), links_of(tree)) == counts
    assert [socket.name for socket in second.node.outputs if socket.enabled] == [ALL, KEY]


def reflections_of(layer_name=None):
    random = np.random.default_rng(5)
    images = {name: random.random((SIZE_PX, SIZE_PX, 3), dtype=np.float32) for name in (REFLECTION, COLOR)}
    return images, write_images(PassSet(images, SetStatistics()), layer_name=layer_name)


@pytest.mark.parametrize("layer_name", [None, "Foreground"])
def test_a_picture_gets_its_reflections(scene, tmp_path, layer_name):
    without = render(scene, tmp_path / "without.exr")
    passes, images = reflections_of(layer_name)
    shown = images if layer_name is None else {**write_images(passes_of(ALL)), **images}
    node = add_pass_nodes(scene, shown).node
    tree = tree_of(scene)
    suffix = "" if layer_name is None else " (Foreground)"
    tree.links.new(node.outputs[WITH_REFLECTIONS + suffix], picture_input(tree))
    # nothing given is black
    product = passes[REFLECTION] * passes[COLOR]
    np.testing.assert_allclose(render(scene, tmp_path / "product.exr")[..., :3], product, atol=1e-6)
    layers = next(each for each in tree.nodes if each.bl_idname == "CompositorNodeRLayers")
    tree.links.new(layers.outputs["Image"], node.inputs[WITHOUT_REFLECTIONS + suffix])
    total = render(scene, tmp_path / "with.exr")
    np.testing.assert_allclose(total[..., :3], without[..., :3] + product, atol=1e-6)
    np.testing.assert_array_equal(total[..., 3:], without[..., 3:])
    counts = len(node.node_tree.nodes), len(node.node_tree.interface.items_tree), links_of(tree), links_of(node.node_tree)
    assert add_pass_nodes(scene, shown).added == []
    assert (len(node.node_tree.nodes), len(node.node_tree.interface.items_tree), links_of(tree), links_of(node.node_tree)) == counts


def test_a_sum_goes_with_its_reflections_unless_it_is_used(scene):
    _, images = reflections_of()
    node = add_pass_nodes(scene, images).node
    tree = tree_of(scene)
    assert [socket.name for socket in node.outputs] == [REFLECTION, COLOR, WITH_REFLECTIONS]
    used = tree.links.new(node.outputs[WITH_REFLECTIONS], picture_input(tree))
    kept = add_pass_nodes(scene, write_images(passes_of(KEY)))
    assert (set(kept.kept), kept.removed) == ({REFLECTION, COLOR}, [])
    assert WITH_REFLECTIONS in node.outputs and WITHOUT_REFLECTIONS in node.inputs
    tree.links.remove(used)
    gone = add_pass_nodes(scene, write_images(passes_of(KEY)))
    assert set(gone.removed) == {WITH_REFLECTIONS, REFLECTION, COLOR}
    assert [socket.name for socket in node.outputs] == [KEY] and len(node.inputs) == 0
    assert {other.bl_idname for other in node.node_tree.nodes} == {"CompositorNodeImage", "NodeGroupInput", "NodeGroupOutput"}
    assert add_pass_nodes(scene, {**images, **write_images(passes_of(KEY))}).added == [REFLECTION, COLOR, WITH_REFLECTIONS]


def test_a_pass_of_one_reflector_makes_no_sum(scene):
    random = np.random.default_rng(5)
    images = {f"{name} Ball": random.random((SIZE_PX, SIZE_PX, 3), dtype=np.float32) for name in (REFLECTION, COLOR)}
    result = add_pass_nodes(scene, write_images(PassSet(images, SetStatistics())))
    assert result.added == [f"{REFLECTION} Ball", f"{COLOR} Ball"]


def test_lights_come_and_go(scene):
    node = add_pass_nodes(scene, write_images(passes_of(ALL, KEY))).node
    tree = tree_of(scene)
    tree.links.new(node.outputs[KEY], picture_input(tree))
    result = add_pass_nodes(scene, write_images(passes_of(FILL)))
    assert (result.added, result.removed, result.kept) == ([FILL], [ALL], [KEY])
    assert [socket.name for socket in node.outputs] == [KEY, FILL]
    assert node.outputs[KEY].is_linked
    assert all(other.image is not None for other in node.node_tree.nodes if other.bl_idname == "CompositorNodeImage")


def test_what_an_artist_did_to_the_group_stays(scene):
    images = write_images(passes_of(KEY))
    node = add_pass_nodes(scene, images).node
    group = node.node_tree
    group.name = "My passes"
    output = next(other for other in group.nodes if other.bl_idname == "NodeGroupOutput")
    blur = group.nodes.new("CompositorNodeBlur")
    group.links.new(blur.outputs["Image"], output.inputs[KEY])
    before = links_of(group)
    assert add_pass_nodes(scene, images).node == node
    assert links_of(group) == before
    assert group.name == "My passes"


def test_a_node_tidied_into_a_group_is_found(scene):
    images = write_images(passes_of(KEY))
    add_pass_nodes(scene, images)
    tree = tree_of(scene)
    passes_group = tree.nodes[GROUP_NAME].node_tree
    outer = bpy.data.node_groups.new("Tidy", "CompositorNodeTree")
    outer.nodes.new("CompositorNodeGroup").node_tree = passes_group
    tree.nodes[GROUP_NAME].node_tree = outer
    count = len(tree.nodes)
    assert add_pass_nodes(scene, images).node.node_tree == passes_group
    assert len(tree.nodes) == count


def test_scenes_that_share_the_group_are_parted(scene):
    node = add_pass_nodes(scene, write_images(passes_of(ALL, KEY), scene_name=scene.name)).node
    other = bpy.data.scenes.new("Other")
    add_pass_nodes(other, {})
    own = next(candidate for candidate in tree_of(other).nodes if candidate.type == "GROUP")
    own.node_tree = node.node_tree
    target = tree_of(other).nodes.new("CompositorNodeBlur").inputs["Image"]
    tree_of(other).links.new(own.outputs[KEY], target)
    add_pass_nodes(other, write_images(passes_of(KEY, FILL), scene_name="Other"))
    assert {socket.name for socket in node.outputs} == {ALL, KEY} and {socket.name for socket in own.outputs} == {KEY, FILL}
    owners = {image.image["vir_scene"] for image in node.node_tree.nodes if image.bl_idname == "CompositorNodeImage"}
    assert owners == {scene.name} and target.links[0].from_socket.name == KEY
    count = len(bpy.data.node_groups)
    add_pass_nodes(other, write_images(passes_of(KEY), scene_name="Other"))
    assert len(bpy.data.node_groups) == count


def test_a_deleted_node_comes_back_with_the_same_group(scene):
    images = write_images(passes_of(KEY))
    add_pass_nodes(scene, images)
    tree = tree_of(scene)
    tree.nodes.remove(tree.nodes[GROUP_NAME])
    result = add_pass_nodes(scene, images)
    assert result.added == []
    assert sum(group.name.startswith(GROUP_NAME) for group in bpy.data.node_groups) == 1


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="only 4.5 can have nodes and not use them")
def test_a_compositor_that_is_switched_off_stays_off(scene):
    scene.use_nodes = True
    scene.use_nodes = False
    assert add_pass_nodes(scene, write_images(passes_of(KEY))).is_switched_off
    assert not scene.use_nodes


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="in 4.5 a scene owns its tree")
def test_a_linked_compositor_is_refused_in_words(scene, tmp_path):
    add_pass_nodes(scene, {})
    tree_of(scene).name = "Shared"
    library = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.node_groups = ["Shared"]
    bpy.context.scene.compositing_node_group = bpy.data.node_groups["Shared"]
    with pytest.raises(SceneError, match="'Shared' belongs to another"):
        add_pass_nodes(bpy.context.scene, {})


def test_written_exr_files_are_multilayer_images_to_blender(scene, tmp_path):
    long_name = unique_pass_names(["L" * 200])["L" * 200]
    passes = passes_of(ALL, "VIR Shadow Key_001", long_name)
    path = tmp_path / "passes.exr"
    write_exr(path, {"Layer.1": passes}, scene_name="Scene", frame=1)
    add_pass_nodes(scene, {})
    tree = tree_of(scene)
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(path))
    assert node.image.type == "MULTILAYER"
    assert node.layer == "Layer_1"
    assert {socket.name: socket.type for socket in node.outputs if socket.enabled} == dict.fromkeys(passes.images, "VALUE")
    for name, expected in passes.images.items():
        tree.links.new(node.outputs[name], picture_input(tree))
        np.testing.assert_array_equal(render(scene, tmp_path / "read.exr")[..., 0], expected)


@pytest.mark.parametrize("aspect", [(1.0, 1.0), (2.0, 1.0), (1.0, 1.75)])
def test_the_pixels_of_exr_files_are_as_wide_as_in_blenders_own(scene, tmp_path, aspect):
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    render(scene, tmp_path / "blender.exr")
    write_exr(tmp_path / "passes.exr", {"Layer": passes_of(ALL)}, scene_name="Scene", frame=1, pixel_aspect=aspect[0] / aspect[1])
    ratios = []
    for name in ("blender", "passes"):
        with OpenEXR.File(str(tmp_path / f"{name}.exr")) as file:
            ratios.append(file.header()["pixelAspectRatio"])
    assert ratios[0] == ratios[1]
