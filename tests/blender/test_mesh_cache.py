"""A preview's snapshots: only what has changed is read again, and what they hold is what reading everything gives."""

import contextlib

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.test_material_opacity import Nodes, square  # noqa: E402  (bpy decides whether this file runs)
from tests.blender.test_material_surface import saved_image  # noqa: E402
from vir_addon.blender.extract import SceneReading, _material_readers, mesh_cache, snapshot  # noqa: E402
from vir_addon.blender.extract.mesh_cache import MeshCache  # noqa: E402
from vir_addon.blender.extract.scene_walk import SceneWalk  # noqa: E402
from vir_addon.blender.materials import image_cache  # noqa: E402
from vir_addon.blender.materials.image_cache import OutOfTimeError  # noqa: E402
from vir_addon.core.material_program import sampled_images  # noqa: E402
from vir_addon.core.scene import SceneSnapshot, has_same_meshes, has_same_picture  # noqa: E402


class Watched:
    """The scene's viewport depsgraph with a cache that hears of its updates, as a preview holds it."""

    def __init__(self) -> None:
        self.cache = MeshCache()

    def note(self, scene, depsgraph) -> None:
        self.cache.note_updates(depsgraph)

    def take(self, budget_s: float = float("inf"), *, with_materials: bool = False) -> SceneSnapshot:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        reading = SceneReading(cache=self.cache, with_materials=with_materials)
        steps, answer, self.slice_count = reading.steps(depsgraph), None, 1
        self.images_read = []
        with contextlib.suppress(StopIteration):
            while True:
                self.cache.begin(budget_s)
                host_work = steps.send(answer)
                self.images_read.append(self.cache.images.read_count)
                self.slice_count += host_work is None
                answer = host_work() if host_work is not None else None
        return reading.snapshot


@pytest.fixture
def watched(scene):
    made = Watched()
    bpy.app.handlers.depsgraph_update_post.append(made.note)
    bpy.app.handlers.frame_change_post.append(made.note)
    yield made
    bpy.app.handlers.depsgraph_update_post.remove(made.note)
    bpy.app.handlers.frame_change_post.remove(made.note)


@pytest.fixture
def garden(scene, add):
    """Objects with and without modifiers, duplicates, instances, a text, and a light."""
    floor = add.mesh("Floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    cube = add.cube("Cube", location=(0, 0, 1))
    add.object("Twin", cube.data, location=(3, 0, 1))
    soft = add.cube("Soft", location=(-3, 0, 1))
    soft.modifiers.new("Subdivision", "SUBSURF").levels = 2
    collection = bpy.data.collections.new("Leaves")
    add.cube("Leaf", collection, scale=(0.1, 0.1, 0.1))
    for index in range(3):
        add.instance_of(collection, f"Branch {index}", location=(index, 2, 1))
    text = bpy.data.curves.new("Text", "FONT")
    text.body = "VIR"
    add.object("Text", text)
    add.light("Key", location=(2, -2, 4))
    return {"floor": floor, "cube": cube, "soft": soft, "text": text, "leaf": collection.objects[0]}


def check_against_reading_everything(watched) -> SceneSnapshot:
    taken = watched.take()
    fresh = snapshot(bpy.context.evaluated_depsgraph_get())
    assert len(taken.meshes) == len(fresh.meshes)
    for cached, read in zip(taken.meshes, fresh.meshes, strict=True):
        np.testing.assert_array_equal(cached.positions_os, read.positions_os)
        np.testing.assert_array_equal(cached.triangles, read.triangles)
    np.testing.assert_array_equal(taken.instances.world_from_object, fresh.instances.world_from_object)
    np.testing.assert_array_equal(taken.instances.mesh_index, fresh.instances.mesh_index)
    return taken


def edit(key):
    def do(garden):
        data = garden[key].data
        data.vertices[0].co.x += 0.25
        data.update()

    return do


def set_location(garden):
    garden["cube"].location.z = 2.0


def set_levels(garden):
    garden["soft"].modifiers[0].levels = 1


def set_text(garden):
    garden["text"].body = "Shadows"


def add_modifier(garden):
    garden["cube"].modifiers.new("Solid", "SOLIDIFY").thickness = 0.3


def remove_and_add(garden):
    bpy.data.objects.remove(garden["soft"])
    data = bpy.data.meshes.new("New")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 2)], [], [(0, 1, 2)])
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("New", data))


def move_light(garden):
    bpy.data.objects["Key"].location.x = 0.0


@pytest.mark.parametrize(
    ("change", "read_again"),
    [
        (move_light, 0),
        (set_location, 0),
        (edit("floor"), 1),
        (edit("cube"), 1),  # the twin shares it
        (edit("leaf"), 1),  # and so do the branches
        (edit("soft"), 1),
        (set_levels, 1),
        (set_text, 1),
        (add_modifier, 2),  # the twin does not have it
        (remove_and_add, 1),
    ],
    ids=lambda one: getattr(one, "__name__", str(one)),
)
def test_only_what_has_changed_is_read_again(watched, garden, change, read_again):
    before = check_against_reading_everything(watched)
    read_count = watched.cache.read_count
    assert read_count == len(before.meshes) == 5
    change(garden)
    after = check_against_reading_everything(watched)
    assert watched.cache.read_count - read_count <= read_again
    assert has_same_meshes(before, after) == (read_again == 0)
    again = watched.take()
    assert has_same_picture(after, again)
    assert watched.cache.read_count - read_count <= read_again


def test_nothing_changes_nothing_is_read(watched, garden):
    before = watched.take()
    read_count = watched.cache.read_count
    garden["cube"].select_set(True)
    bpy.context.scene.frame_set(5)
    after = watched.take()
    assert watched.cache.read_count == read_count
    assert has_same_picture(before, after)


def test_animated_geometry_is_read_in_every_frame(watched, garden):
    """Shape keys."""
    cube = garden["cube"]
    cube.shape_key_add(name="Basis")
    key = cube.shape_key_add(name="Tall")
    key.data[0].co.z += 3.0
    for frame, value in ((1, 0.0), (11, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    for frame in (1, 4, 11, 4):
        bpy.context.scene.frame_set(frame)
        check_against_reading_everything(watched)


def test_a_material_that_becomes_transparent(watched, garden):
    material = bpy.data.materials.new("Glass")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    garden["cube"].data.materials.append(material)
    opaque = check_against_reading_everything(watched)
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Alpha"].default_value = 0.5
    taken = watched.take()
    assert [mesh.opacity_map is None for mesh in opaque.meshes].count(False) == 0
    assert [mesh.opacity_map is None for mesh in taken.meshes].count(False) == 1
    shader.inputs["Alpha"].default_value = 1.0
    assert all(mesh.opacity_map is None for mesh in watched.take().meshes)


def test_reading_goes_on_where_time_was_over(watched, garden):
    """With no time at all one mesh is read at a time."""
    taken = watched.take(0.0)
    assert watched.slice_count == watched.cache.read_count == len(taken.meshes) == 5
    watched.take(0.0)
    assert watched.slice_count == 1


def test_undoing_forgets(watched, garden):
    watched.take()
    watched.cache.forget()
    read_count = watched.cache.read_count
    check_against_reading_everything(watched)
    assert watched.cache.read_count == 2 * read_count


def test_viewports_that_wait_at_different_large_meshes_read_both(scene, add, monkeypatch):
    """They take turns: one does not show the mesh that the other comes to first."""
    monkeypatch.setattr(mesh_cache, "LARGE_MESH_CORNERS", 20)  # cubes have 24
    for name in ("First", "Second"):
        add.cube(name)
    depsgraph, cache = bpy.context.evaluated_depsgraph_get(), MeshCache()
    readers = _material_readers(depsgraph, cache, None)
    hidden_uids = (frozenset(), frozenset({bpy.data.objects["First"].session_uid}))
    walks, done = [SceneWalk(depsgraph, readers, uids, cache) for uids in hidden_uids], [False, False]
    for _ in range(4):
        for index, walk in enumerate(walks):
            cache.begin(10.0)
            done[index] = done[index] or walk.go_on(depsgraph)
    assert done == [True, True] and cache.read_count == len(scene.objects) - 1  # all but the camera


def test_a_viewport_whose_walks_end_leaves_others_what_they_were_told_of(monkeypatch):
    """As while an animation plays."""
    monkeypatch.setattr(mesh_cache, "LARGE_MESH_CORNERS", 20)
    cache = MeshCache()
    with pytest.raises(OutOfTimeError):
        cache.find("key", "Large", 24)
    cache.note_used(set())
    assert cache.find("key", "Large", 24) is None


@pytest.mark.parametrize("end", [MeshCache.forget, lambda cache: cache.note_used(set())], ids=["undone", "walk ended"])
def test_a_large_mesh_that_goes_before_it_is_read_is_not_named_any_more(monkeypatch, end):
    """Nor taken for told of, should another come in its place later."""
    monkeypatch.setattr(mesh_cache, "LARGE_MESH_CORNERS", 20)
    cache = MeshCache()
    with pytest.raises(OutOfTimeError):
        cache.find("key", "Gone", 24)
    assert cache.large_name == "Gone"
    end(cache)
    assert cache.large_name == ""
    end(cache)
    with pytest.raises(OutOfTimeError):
        cache.find("key", "Later", 24)


@pytest.fixture
def pictures(scene, add, tmp_path):
    """A leaf with an image for its colour and its opacity, and a sky that is an image times a strength."""
    nodes, rng = Nodes("leaf"), np.random.default_rng(1)
    images = {name: saved_image(tmp_path, name, rng.random((8, 8, 4), np.float32)) for name in ("leaf", "sky")}
    texture, shader = nodes.texture(images["leaf"]), nodes.principled()
    nodes.link(texture.outputs["Color"], shader.inputs["Base Color"])
    nodes.link(texture.outputs["Alpha"], shader.inputs["Alpha"])
    leaf = square(add, nodes)
    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    background = world.node_tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
    background.inputs["Strength"].default_value = 2.0
    sky = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    sky.image = images["sky"]
    world.node_tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    return {**images, "shader": shader, "background": background, "leaf object": leaf}


def look_of(taken: SceneSnapshot) -> list[np.ndarray]:
    """All that was read of images."""
    (image,) = sampled_images(taken.materials[0].diffuse)
    return [image.texels, taken.meshes[0].opacity_map.texels, taken.world.image.texels]


def write_and_reload(pictures):
    image = pictures["leaf"]
    content = bpy.data.images.load(image.filepath, check_existing=False)
    content.pixels.foreach_set(np.full(256, 0.75, np.float32))
    content.save()
    bpy.data.images.remove(content)
    image.reload()


def paint(pictures):
    """As a script does it, of which nothing tells."""
    pictures["leaf"].pixels.foreach_set(np.full(256, 0.25, np.float32))
    pictures["shader"].inputs["Roughness"].default_value = 0.9


def paint_sky(pictures):
    pictures["sky"].pixels.foreach_set(np.full(256, 0.25, np.float32))
    pictures["shader"].inputs["Roughness"].default_value = 0.9


def set_of(name, attribute, value):
    return lambda pictures: setattr(pictures[name], attribute, value)


def set_input(node, identifier, value):
    return lambda pictures: setattr(pictures[node].inputs[identifier], "default_value", value)


@pytest.mark.parametrize(
    ("change", "read_again", "is_seen"),
    [
        (set_input("shader", "Roughness", 0.1), 0, False),
        (set_input("background", "Strength", 3.0), 0, True),
        (lambda pictures: setattr(pictures["leaf object"].location, "x", 1.0), 0, False),
        (write_and_reload, 2, True),
        (paint, 2, True),
        (paint_sky, 1, True),
        (lambda pictures: setattr(pictures["sky"].colorspace_settings, "name", "Non-Color"), 1, True),
    ],
    ids=["roughness", "strength", "location", "reload", "paint", "paint the sky", "colour space"],
)
def test_images_are_read_again_when_they_have_changed(watched, pictures, change, read_again, is_seen):
    before = watched.take(with_materials=True)
    images = watched.cache.images
    assert images.read_count == 3
    change(pictures)
    after = watched.take(with_materials=True)
    fresh = snapshot(bpy.context.evaluated_depsgraph_get(), with_materials=True)
    for cached, read in zip(look_of(after), look_of(fresh), strict=True):
        np.testing.assert_array_equal(cached, read)
    assert images.read_count - 3 == read_again
    is_same = all(np.array_equal(one, other) for one, other in zip(look_of(before), look_of(after), strict=True))
    assert is_same == (not is_seen)
    assert (after.world is before.world) == (after.world.image.texels is before.world.image.texels)


@pytest.mark.skipif(bpy.app.version < (5, 2), reason="Cycles 4.5 reads alpha of files otherwise; VIR does as 5.2")
def test_packing_is_noticed(watched, pictures):
    """Renderers open premultiplied files by themselves, and take what is packed from Blender, which has divided it by its alpha."""
    for name in ("leaf", "sky"):
        pictures[name].alpha_mode = "PREMUL"
    before = watched.take(with_materials=True)
    for name in ("leaf", "sky"):
        pictures[name].pack()
    after = watched.take(with_materials=True)
    fresh = snapshot(bpy.context.evaluated_depsgraph_get(), with_materials=True)
    for cached, read in zip(look_of(after), look_of(fresh), strict=True):
        np.testing.assert_array_equal(cached, read)
    for image in (0, 2):
        assert not np.array_equal(look_of(before)[image], look_of(after)[image])


def test_small_images_do_not_interrupt_the_walk(watched, pictures, monkeypatch):
    watched.take(with_materials=True)
    assert watched.images_read[0] == 2  # the world's comes after the surfaces
    monkeypatch.setattr(image_cache, "SMALL_PX", 63)
    watched.cache = MeshCache()
    watched.take(with_materials=True)
    assert watched.images_read[:2] == [1, 2]


@pytest.mark.parametrize("small_px", [63, 64])
def test_one_image_is_read_where_time_is_over(watched, pictures, monkeypatch, small_px):
    """And made into texels elsewhere, where it is large."""
    monkeypatch.setattr(image_cache, "SMALL_PX", small_px)
    taken = watched.take(0.0, with_materials=True)
    assert np.diff(watched.images_read, prepend=0).max() == 1 and watched.cache.images.read_count == 3
    for cached, read in zip(look_of(taken), look_of(snapshot(bpy.context.evaluated_depsgraph_get(), with_materials=True)), strict=True):
        np.testing.assert_array_equal(cached, read)
