"""The preview of a viewport without a window: follows the scene, reads only what has changed, ends where a render ends."""

import contextlib
import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.extract import scene_walk, snapshot  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.extract.light_linking import SceneLinking  # noqa: E402
from vir_addon.blender.extract.mesh_cache import MeshCache, changes_only_lights  # noqa: E402
from vir_addon.blender.extract.viewport_view import viewport_view  # noqa: E402
from vir_addon.blender.preview.viewport import LEVELS, ViewportPreview  # noqa: E402
from vir_addon.core.errors import SceneError, UsageError  # noqa: E402
from vir_addon.core.passes.accumulate import pass_image  # noqa: E402
from vir_addon.core.picture import Choice, Shown  # noqa: E402
from vir_addon.core.plan import plan, settings_for  # noqa: E402
from vir_addon.core.render import render  # noqa: E402
from vir_addon.core.settings import Effect, Method, Settings  # noqa: E402
from vir_addon.device.interface import TextureFormat  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402

SIZE = (64, 40)
SETTINGS = Settings(view_count=8, map_resolution_px=128)
FOREVER_S, NO_TIME_S = 600.0, 1e-9


@pytest.fixture(scope="module")
def device():
    if bpy.app.version < (5, 2):
        pytest.skip("before 5.2 Blender has no GPU in background")
    opened = open_device("gpu")
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def executor():
    with ThreadPoolExecutor(1) as made:
        yield made


def view_from(x: float = 0.0):
    """From 8 m before the origin and 4 m up, as a region would say it."""
    from mathutils import Vector

    eye = Vector((x, -8.0, 4.0))
    world_from_view = (-eye).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    world_from_view.translation = eye
    projection = np.diag([2.0, 2.0 * SIZE[0] / SIZE[1], -1.002, 0.0])
    projection[2, 3], projection[3, 2] = -0.2, -1.0
    return viewport_view(np.linalg.inv(np.array(world_from_view)), projection, *SIZE)


@pytest.fixture
def still_life(scene, add):
    add.mesh("Floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    add.cube("Cube", location=(0, 0, 1))
    add.light("Key", location=(1, -1, 5), data={"size": 1.0})
    add.light("Fill", "POINT", location=(-2, -1, 4), data={"shadow_soft_size": 0.2})
    return scene


@pytest.fixture
def preview(device, executor, still_life):
    """Told of updates as the running preview is."""
    made = ViewportPreview(device, executor, MeshCache())
    made.level_index = 0

    def note(scene, depsgraph):
        made.cache.note_updates(depsgraph)
        made.note_change(only_lights=changes_only_lights(depsgraph))

    bpy.app.handlers.depsgraph_update_post.append(note)
    made.look(view_from())
    with contextlib.closing(made):
        yield made
    bpy.app.handlers.depsgraph_update_post.remove(note)


def finish(preview, settings=SETTINGS, budget_s=FOREVER_S) -> int:
    """Returns how many slices it took."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for slices in range(1, 2000):
        preview.advance(depsgraph, settings, budget_s)
        if preview.is_done:
            return slices
        if preview.render.is_waiting:
            time.sleep(1e-3)
    raise AssertionError("it does not end")


def shown(preview) -> np.ndarray:
    texels = preview.render.device.read(preview.picture.shadows).astype(np.float64)
    return pass_image(texels[..., 0], texels[..., 1], texels[..., 2])


def rendered(device, view, settings=SETTINGS) -> np.ndarray:
    """From nothing."""
    taken = snapshot(bpy.context.evaluated_depsgraph_get(), view=view)
    for progress in render(taken, plan(taken, settings_for(device, settings)), device):
        last = progress
    return last.passes["VIR Shadow"]


def check(preview, device, view, settings=SETTINGS) -> np.ndarray:
    image = shown(preview)
    np.testing.assert_allclose(image, rendered(device, view, settings), atol=1e-6)
    assert 0.02 < (image < 0.9).mean() < 0.98
    return image


def test_it_shows_what_a_render_of_the_view_shows(preview, device):
    finish(preview)
    check(preview, device, view_from())


def test_it_follows_light_object_and_view(preview, device):
    finish(preview)
    first = check(preview, device, view_from())
    bpy.data.objects["Key"].location.x = -3.0
    finish(preview)
    second = check(preview, device, view_from())
    bpy.data.objects["Cube"].location.x = 1.0
    finish(preview)
    third = check(preview, device, view_from())
    preview.look(view_from(3.0))
    finish(preview)
    fourth = check(preview, device, view_from(3.0))
    bpy.data.objects["Cube"].data.vertices[0].co.x = -4.0
    bpy.data.objects["Cube"].data.update()
    finish(preview)
    fifth = check(preview, device, view_from(3.0))
    for before, after in ((first, second), (second, third), (third, fourth), (fourth, fifth)):
        assert np.abs(before - after).max() > 0.1
    # floor and cube, and the cube when its own vertices moved
    assert preview.cache.read_count == 3


def test_nothing_of_another_view_is_shown(preview):
    finish(preview)
    assert preview.picture is not None
    preview.look(view_from(3.0))
    assert preview.picture is None and not preview.is_done
    finish(preview)
    assert preview.picture is not None


def test_the_last_picture_stays_until_there_is_another(preview):
    """While a light is dragged; flicker would be worse than a shadow that is a moment old."""
    finish(preview)
    before = shown(preview)
    bpy.data.objects["Key"].location.x = -3.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert not preview.advance(depsgraph, SETTINGS, NO_TIME_S)
    np.testing.assert_array_equal(shown(preview), before)


def test_what_changes_nothing_starts_nothing(preview):
    finish(preview)
    bpy.data.objects["Cube"].select_set(True)
    bpy.data.objects["Key"].location.x = bpy.data.objects["Key"].location.x
    bpy.context.view_layer.update()
    preview.look(view_from())
    assert finish(preview) <= 1
    assert preview.render.standing.views_done == 16


@pytest.fixture
def lawn(still_life, add):
    """400 blades of grass, made by one object."""
    blade = add.mesh("Blade", [(0, 0, 0), (0.05, 0, 0), (0, 0, 0.3)], [(0, 1, 2)])
    places = add.mesh("Places", [(0.2 * x - 2, 0.2 * y - 2, 0) for x in range(20) for y in range(20)], [])
    places.instance_type = "VERTS"
    blade.parent = places
    return places


def test_a_scene_that_takes_longer_to_walk_than_a_slice(preview, lawn, device):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    slices = 0
    while preview.must_read or preview.is_reading:
        preview.advance(depsgraph, SETTINGS, NO_TIME_S)
        slices += 1
    assert slices > 10
    finish(preview)
    check(preview, device, view_from())


@pytest.mark.parametrize("moved", ["Places", "Key", "Cube"])
def test_a_change_in_the_middle_of_a_walk(preview, lawn, device, moved):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for _ in range(6):
        preview.advance(depsgraph, SETTINGS, NO_TIME_S)
    assert preview.is_reading and not preview.is_done
    bpy.data.objects[moved].location.x += 1.0
    bpy.context.view_layer.update()
    assert not preview.is_reading and preview.must_read
    finish(preview)
    check(preview, device, view_from())


def test_surfaces_are_not_walked_again_for_lights(preview, lawn, device, add):
    def read() -> tuple:
        finish(preview)
        check(preview, device, view_from())
        return preview._surfaces

    key, fill = bpy.data.objects["Key"], bpy.data.objects["Fill"]
    before = read()
    key.location.x, key.data.size = -2.0, 2.0
    assert read() is before
    fill.data.energy = 500.0
    assert read() is before
    # what hangs on a light moves with it
    cube = bpy.data.objects["Cube"]
    cube.parent, cube.matrix_parent_inverse = key, key.matrix_world.inverted()
    parented = read()
    assert parented is not before
    key.location.x = -1.0
    assert read() is not parented
    before = read()
    fill.hide_render = True
    assert read() is not before


def test_linking_is_read_in_slices_and_again_for_lights_alone(preview, device, monkeypatch):
    for number in range(300):
        bpy.context.collection.objects.link(bpy.data.objects.new(f"Empty {number}", None))
    key = bpy.data.objects["Key"]
    linked = bpy.data.collections.new("Linked")
    linked.objects.link(bpy.data.objects["Floor"])
    asked, add = [], SceneLinking.add

    def counted(self, emitter):
        asked.append(emitter.name)
        add(self, emitter)

    monkeypatch.setattr(SceneLinking, "add", counted)
    # a slice takes as long again as finding its place did, which on a busy machine may be any number of items
    monkeypatch.setattr(scene_walk, "time", SimpleNamespace(perf_counter=itertools.count().__next__))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    most = 0
    while preview.must_read or preview.is_reading:
        asked_before = len(asked)
        preview.advance(depsgraph, SETTINGS, NO_TIME_S)
        most = max(most, len(asked) - asked_before)
    assert len(asked) > 300 and most == 64
    finish(preview)
    before = shown(preview)
    key.light_linking.blocker_collection = linked
    finish(preview)
    assert np.abs(shown(preview) - before).max() > 0.1
    surfaces = preview._surfaces
    del asked[:]
    bpy.data.objects["Fill"].location.x = -1.0
    finish(preview)
    assert preview._surfaces is surfaces and sorted(asked) == ["Fill", "Key"]
    np.testing.assert_allclose(shown(preview), rendered(device, view_from()), atol=1e-6)


def test_another_setting(preview, device):
    finish(preview)
    more = replace(SETTINGS, view_count=16)
    preview.advance(bpy.context.evaluated_depsgraph_get(), more, FOREVER_S)
    finish(preview, more)
    assert preview.render.standing.views_total == 32
    check(preview, device, view_from(), more)


def test_what_pixels_see_is_rasterized_into_little_memory_at_a_time(preview, device, monkeypatch):
    """Whatever the settings say, as clearing more of it would take longer than a slice may. More rasterizations show the same."""
    monkeypatch.setattr("vir_addon.blender.preview.viewport.VISIBILITY_TEXELS", 0)
    created, create = [], device.create_texture
    monkeypatch.setattr(device, "create_texture", lambda *arguments: created.append(arguments) or create(*arguments))
    finish(preview)
    seen = [(width, height) for width, height, texture_format in created if texture_format is TextureFormat.RG32UI]
    view = view_from()
    assert seen and all(width < 2 * view.width_px and height < 2 * view.height_px for width, height in seen)
    np.testing.assert_allclose(shown(preview), rendered(device, view, replace(SETTINGS, visibility_texel_count=0)), atol=1e-6)


def test_slices_without_any_time(preview, device):
    """One mesh, or one step, at a time."""
    preview.level_index = len(LEVELS) - 1
    slices = finish(preview, budget_s=NO_TIME_S)
    assert slices > 20
    coarse = replace(view_from(), width_px=8, height_px=5)
    np.testing.assert_allclose(shown(preview), rendered(device, coarse, replace(SETTINGS, batch_view_count=1)), atol=1e-6)


def test_steps_that_take_too_long_make_it_coarser_and_time_left_finer(preview):
    preview.level_index = 2
    finish(preview)
    assert preview.level_index == 0 and preview.render.picture.size[0] == SIZE[0]
    assert preview.render.standing.views_done == 16
    finish(preview, budget_s=NO_TIME_S)
    assert preview.level_index == len(LEVELS) - 1
    assert preview.picture.size[0] == SIZE[0] // 8


def test_a_step_that_is_slow_by_chance_does_not_make_it_coarse_for_ever(preview):
    def be_slow() -> None:
        preview.render.slowest_step_ms = 2e3 * FOREVER_S
        preview.advance(bpy.context.evaluated_depsgraph_get(), SETTINGS, FOREVER_S)
        assert preview.level_index == 1
        finish(preview)

    finish(preview)
    be_slow()
    assert preview.level_index == 0
    be_slow()
    assert preview.level_index == 1
    bpy.data.objects["Key"].location.x = -3.0
    finish(preview)
    assert preview.level_index == 1
    # it may have been this that took long
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    finish(preview)
    assert preview.level_index == 0


def test_a_reading_that_fails_is_not_taken_for_the_one_before(preview, device, monkeypatch):
    finish(preview)
    with monkeypatch.context() as patch:
        patch.setattr("vir_addon.blender.extract.place_light", lambda *_: 1 / 0)
        bpy.data.objects["Key"].location.x = -3.0
        with pytest.raises(ZeroDivisionError):
            finish(preview)
    preview.look(view_from(3.0))
    finish(preview)
    check(preview, device, view_from(3.0))


def test_a_reference_to_compare_with(preview):
    """Of a view that was finished, for as long as it is looked at."""

    def read(picture):
        return preview.render.device.read(picture.shadows)

    preview.compare(True)
    assert preview.reference is None
    finish(preview)
    preview.compare(True)
    first = read(preview.reference)
    np.testing.assert_array_equal(first, read(preview.picture))
    bpy.data.objects["Key"].location.x = -3.0
    finish(preview)
    preview.compare(True)
    np.testing.assert_array_equal(first, read(preview.reference))
    assert np.abs(first - read(preview.picture)).max() > 0.01
    preview.look(view_from(3.0))
    preview.compare(True)
    assert preview.reference is None
    finish(preview)
    preview.compare(True)
    np.testing.assert_array_equal(read(preview.reference), read(preview.picture))
    preview.compare(False)
    assert preview.reference is None


def test_a_light_that_is_deleted_halfway(preview, device):
    preview.render.choice = Choice(light_name="Fill")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for _ in range(8):
        preview.advance(depsgraph, SETTINGS, NO_TIME_S)
    bpy.data.objects.remove(bpy.data.objects["Fill"])
    finish(preview)
    assert preview.picture is None
    preview.render.choice = Choice()
    finish(preview)
    check(preview, device, view_from())


def test_what_cannot_be_shown(preview, device):
    finish(preview)
    lights = [bpy.data.objects["Key"], bpy.data.objects["Fill"]]
    for light in lights:
        light.hide_render = True
    with pytest.raises(SceneError, match="no light"):
        finish(preview)
    assert finish(preview) <= 1
    lights[0].hide_render = False
    finish(preview)
    check(preview, device, view_from())
    with pytest.raises(UsageError, match="vwss"):
        preview.advance(bpy.context.evaluated_depsgraph_get(), replace(SETTINGS, method=Method.VWSS), FOREVER_S)
        finish(preview, replace(SETTINGS, method=Method.VWSS))
    finish(preview)
    check(preview, device, view_from())


def test_a_scene_without_camera_and_an_empty_one(preview, device):
    bpy.context.scene.camera = None
    finish(preview)
    check(preview, device, view_from())
    for name in ("Floor", "Cube"):
        bpy.data.objects.remove(bpy.data.objects[name])
    finish(preview)
    assert preview.render.standing.views_total == 0


@pytest.fixture
def mirror(still_life):
    """The cube."""
    material = bpy.data.materials.new("Mirror")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.1
    bpy.data.objects["Cube"].data.materials.append(material)
    still_life.world = bpy.data.worlds.new("World")
    return shader


REFLECTING = replace(SETTINGS, effects=(Effect.SHADOW, Effect.REFLECTION), reflection_sample_count=4)


def rendered_passes(device, settings=REFLECTING) -> dict[str, np.ndarray]:
    """From nothing."""
    taken = snapshot(bpy.context.evaluated_depsgraph_get(), view=view_from(), with_materials=True)
    for progress in render(taken, plan(taken, settings_for(device, settings)), device):
        last = progress
    return last.passes


def check_reflections(preview, device, settings=REFLECTING) -> np.ndarray:
    """All that may be shown of them."""
    passes = rendered_passes(device, settings)
    reflection, color = passes["VIR Reflection"].astype(np.float64), passes["VIR Reflection Color"].astype(np.float64)
    assert color.max() > 0.5 and 0.01 < (color > 0).mean() < 0.9
    found = {}
    for choice in (Shown.REFLECTED, Shown.REFLECTION, Shown.REFLECTION_COLOR, Shown.ALL):
        preview.render.choice = Choice(choice)
        finish(preview, settings)
        assert preview.picture.has_reflections and preview.picture.has_shadows == (choice is Shown.ALL)
        found[choice] = device.read(preview.picture.reflections)
    added, share = found[Shown.REFLECTED], found[Shown.REFLECTION][..., 3]
    np.testing.assert_allclose(added[..., :3], reflection * color, atol=1e-5)
    np.testing.assert_array_equal(added, found[Shown.ALL])
    np.testing.assert_allclose(found[Shown.REFLECTION_COLOR][..., :3], color, atol=1e-6)
    np.testing.assert_allclose(found[Shown.REFLECTION][..., :3], reflection * share[..., None], atol=1e-5)
    assert share.min() == 0.0 and share.max() == 1.0 and (share[color.max(axis=-1) > 0] > 0).all()
    np.testing.assert_allclose(shown(preview), passes["VIR Shadow"], atol=1e-6)
    return added


def test_it_shows_reflections_and_follows_what_they_show(preview, mirror, device):
    finish(preview, REFLECTING)
    pictures = [check_reflections(preview, device)]

    def paint_floor() -> None:
        paint = bpy.data.materials.new("Paint")
        shader = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = 0.9, 0.1, 0.1, 1.0
        bpy.data.objects["Floor"].data.materials.append(paint)

    def turn_world_blue() -> None:
        background = bpy.context.scene.world.node_tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
        background.inputs["Color"].default_value = 0.2, 0.3, 0.9, 1.0

    changes = (
        lambda: setattr(bpy.data.objects["Key"].location, "x", -3.0),
        lambda: setattr(bpy.data.objects["Cube"].location, "x", 1.0),
        paint_floor,
        lambda: setattr(mirror.inputs["Base Color"], "default_value", (0.9, 0.5, 0.2, 1.0)),
        turn_world_blue,
    )
    for change in changes:
        change()
        finish(preview, REFLECTING)
        pictures.append(check_reflections(preview, device))
    assert all(np.abs(one - other).max() > 0.01 for one, other in itertools.pairwise(pictures))


def test_reflections_without_any_time(preview, mirror, device):
    preview.level_index = len(LEVELS) - 1
    assert finish(preview, REFLECTING, budget_s=NO_TIME_S) > 40
    assert preview.picture.has_reflections


def test_materials_and_images_of_reflections_stay_where_nothing_about_them_changes(preview, mirror):
    finish(preview, REFLECTING)

    def surfaces():
        return preview.render._renderer.surfaces

    before = surfaces()
    assert before is not None
    bpy.data.objects["Key"].data.energy = 7.0
    finish(preview, REFLECTING)
    preview.look(view_from(3.0))
    finish(preview, REFLECTING)
    bpy.data.objects["Cube"].location.x = 1.0
    finish(preview, REFLECTING)
    assert surfaces() is before
    mirror.inputs["Roughness"].default_value = 0.2
    finish(preview, REFLECTING)
    assert surfaces() is not before


def test_passes_that_are_switched_off(preview, mirror):
    preview.render.choice = Choice(Shown.REFLECTION)
    with pytest.raises(UsageError, match="reflections are switched off"):
        finish(preview)
    preview.render.choice = Choice(Shown.SHADOW)
    finish(preview, REFLECTING)
    assert preview.picture.has_shadows and not preview.picture.has_reflections
    assert preview.render.plan.reflections is None


def test_nothing_reflects(preview, still_life):
    preview.render.choice = Choice(Shown.REFLECTION)
    finish(preview, REFLECTING)
    assert preview.picture is None
