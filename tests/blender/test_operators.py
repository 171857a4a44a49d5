"""The buttons, pressed without a window: what they leave in the file, what they say when they cannot work."""

import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import bmesh  # noqa: E402  (bpy decides whether this file runs)

from vir_addon import blender  # noqa: E402
from vir_addon.blender import devices, frame_state, images, job, operators, panels, report_file  # noqa: E402
from vir_addon.blender.images import scene_images  # noqa: E402
from vir_addon.blender.object_names import named_object, write_names  # noqa: E402
from vir_addon.blender.properties import settings_of, stored_values  # noqa: E402
from vir_addon.blender.stepped_render import SteppedRender  # noqa: E402
from vir_addon.core.errors import DeviceError, SceneError  # noqa: E402
from vir_addon.core.plan import settings_for  # noqa: E402
from vir_addon.core.reflections.reflectors import Reflector  # noqa: E402
from vir_addon.device.moderngl_device import ModernglComputeKernel  # noqa: E402


@pytest.fixture
def room(scene, add):
    """A cube on a floor under two lights; a third casts no shadow. Eight views, small maps: quick."""
    blender.register()
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 27, 100
    add.cube(location=(0.0, 0.0, 1.0))
    add.mesh("Floor", [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [(0, 1, 2, 3)])
    scene.camera.location, scene.camera.rotation_euler = (0.0, -10.0, 4.0), (1.2, 0.0, 0.0)
    add.light("Key", data={"size": 1.0, "energy": 500.0}, location=(2.0, -2.0, 5.0))
    add.light("Lamp", "POINT", data={"shadow_soft_size": 0.2}, location=(-2.0, -1.0, 3.0))
    add.light("Fill", data={"use_shadow": False}, location=(0.0, -4.0, 4.0))
    scene.vir.view_count, scene.vir.map_resolution_px, scene.vir.device = 8, 64, "MODERNGL"
    yield scene
    blender.unregister()


def pixels_of(image) -> np.ndarray:
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels


def full_copy_of(scene):
    window = bpy.context.window
    shown, window.scene = window.scene, scene
    bpy.ops.scene.new(type="FULL_COPY")
    copy, window.scene = window.scene, shown
    return copy


def refuse(operator, words):
    with pytest.raises(RuntimeError, match=words):
        operator()


def test_render_leaves_the_same_passes_as_the_one_room_of_all_front_ends(room):
    assert bpy.ops.vir.render() == {"FINISHED"}
    device = devices.get_device("moderngl")
    settings = settings_for(device, settings_of(room))
    (wanted,) = (job.run(one, device) for one in job.frame_jobs(room, room.frame_current, settings).values())
    images = scene_images(room.name)
    assert set(images) == set(wanted.images) == {"VIR Shadow", "VIR Shadow Key", "VIR Shadow Lamp", "VIR Shadow Fill"}
    for name, pixels in wanted.images.items():
        assert images[name].packed_file is not None
        np.testing.assert_array_equal(pixels_of(images[name]).reshape(*pixels.shape, -1)[..., 0], pixels)
    assert images["VIR Shadow Key"].pixels[:] != images["VIR Shadow Lamp"].pixels[:]


def test_the_panel_can_say_what_the_plan_decided(room):
    assert bpy.ops.vir.plan() == {"FINISHED"}
    state = frame_state.state_of(room)
    assert "casts no shadow" in frame_state.decision_text(state, "Fill")
    assert frame_state.decision_text(state, "Key").startswith("8 views, ~")
    assert "error" not in frame_state.forecast_text(room)
    assert not bpy.data.images
    bpy.ops.vir.render()
    texts = [frame_state.decision_text(state, "Key", letters) for letters in (100, 23, 5)]
    assert [len(text) <= 23 for text in texts] == [False, True, True] and all("0." in text for text in texts)
    assert texts[0].startswith("8 views, ") and ", error 0." in texts[0] and texts[2].startswith("8, ") and ", ±0." in texts[2]
    fast = frame_state.forecast_text(room)
    room.vir.quality = 1.0
    exact = frame_state.forecast_text(room)
    assert "error about 0." in fast and "error about 0." in exact
    assert float(exact.rpartition(" ")[2]) < float(fast.rpartition(" ")[2])
    made, room.vir.view_count = frame_state.decision_text(state, "Key"), 16
    bpy.ops.vir.plan()
    assert frame_state.made_text(state.made("Key")) == made, "what was rendered is told as it was, whatever is planned since"
    planned = frame_state.decision_text(state, "Key")
    assert planned.startswith("16 views, ~") and 0.0 < float(planned.rpartition(" error ~")[2]) < float(made.rpartition(" ")[2])


def test_long_names_of_lights_have_the_room_that_is_left():
    short, long, longest = (panels.name_share(name, "1 view, ~3.1 s", 40.0) for name in ("Key", "Bulb over the door", "x" * 60))
    assert short == panels.NAME_SHARE < long < longest < 1.0
    assert 40.0 * (1.0 - longest) >= len("1 view, ~3.1 s")
    assert panels.name_share("x" * 60, "64 views, 0.8 s, error 0.006", 30.0) == panels.NAME_SHARE


def test_what_was_moved_and_not_keyed_stays(room):
    cube, key = bpy.data.objects["Cube"], bpy.data.lights["Key"]
    cube['vir "test"'] = 1.0
    cube.keyframe_insert("location", frame=1)
    cube.keyframe_insert('["vir \\"test\\""]', frame=1)
    key.keyframe_insert("energy", frame=1)
    room.frame_set(1, subframe=0.25)
    cube.location.x, cube['vir "test"'], key.energy = 3.0, 2.0, 7.0
    bpy.context.view_layer.update()
    assert bpy.ops.vir.plan() == {"FINISHED"}
    assert (cube.location.x, cube['vir "test"'], key.energy) == (3.0, 2.0, 7.0)
    assert (room.frame_current, room.frame_subframe) == (1, 0.25)


def test_a_second_render_fills_the_same_images_and_the_group_follows(room):
    bpy.ops.vir.render()
    first = scene_images(room.name)
    assert bpy.ops.vir.add_to_compositor() == {"FINISHED"}
    tree = room.compositing_node_group if bpy.app.version >= (5, 0) else room.node_tree
    (node,) = (node for node in tree.nodes if node.type == "GROUP")
    assert {socket.name for socket in node.outputs} == set(first)
    bpy.data.lights.remove(bpy.data.lights["Lamp"])
    bpy.ops.object.light_add(type="SPOT", location=(0.0, 0.0, 6.0))
    bpy.context.object.name = "Spot"
    bpy.ops.vir.render()
    assert scene_images(room.name)["VIR Shadow Key"] == first["VIR Shadow Key"]
    names = {socket.name for socket in node.outputs}
    assert "VIR Shadow Spot" in names and "VIR Shadow Lamp" not in names


def test_view_layers_and_scenes_keep_their_passes_apart(room, add):
    room.view_layers.new("Foreground")
    bpy.ops.vir.render()
    assert {"VIR Shadow Key", "VIR Shadow Key (Foreground)"} <= set(scene_images(room.name))
    before = pixels_of(scene_images(room.name)["VIR Shadow Key"])
    other = bpy.data.scenes.new("Other")
    for item in (room.camera, *(item for item in room.objects if item.name != "Cube")):
        if item.name not in other.objects:
            other.collection.objects.link(item)
    other.camera, other.vir.view_count, other.vir.map_resolution_px = room.camera, 8, 64
    other.render.resolution_x, other.render.resolution_y = 48, 27
    with bpy.context.temp_override(scene=other):
        assert bpy.ops.vir.render() == {"FINISHED"}
    own = scene_images("Other")["VIR Shadow Key"]
    assert own != scene_images(room.name)["VIR Shadow Key"]
    np.testing.assert_array_equal(pixels_of(scene_images(room.name)["VIR Shadow Key"]), before)
    other.name = "Renamed"
    with bpy.context.temp_override(scene=other):
        bpy.ops.vir.render()
    assert scene_images("Renamed")["VIR Shadow Key"] == own


@pytest.mark.parametrize("change", ["hide", "rename", "delete"])
def test_a_light_that_is_not_rendered_any_more_has_a_white_pass_and_is_named(room, change):
    bpy.ops.vir.render()
    bpy.ops.vir.add_to_compositor()
    tree = room.compositing_node_group if bpy.app.version >= (5, 0) else room.node_tree
    (node,) = (node for node in tree.nodes if node.type == "GROUP")
    tree.links.new(node.outputs["VIR Shadow Lamp"], tree.nodes.new("CompositorNodeBlur").inputs["Image"])
    image = scene_images(room.name)["VIR Shadow Lamp"]
    assert pixels_of(image).min() < 0.5
    room.render.resolution_x = 64
    lamp = bpy.data.objects["Lamp"]
    if change == "hide":
        lamp.hide_render = True
    elif change == "rename":
        lamp.name = "Moon"
    else:
        bpy.data.lights.remove(lamp.data)
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert tuple(image.size) == (64, 27) and (pixels_of(image) == 1.0).all() and not image.is_dirty
    note = "VIR Shadow Lamp is not rendered in this frame: the pass is white"
    assert note in frame_state.state_of(room).notes
    assert node.outputs["VIR Shadow Lamp"].is_linked and pixels_of(scene_images(room.name)["VIR Shadow Key"]).min() < 0.5
    if change == "hide":
        lamp.hide_render = False
        bpy.ops.vir.render()
        assert pixels_of(image).min() < 0.5 and note not in frame_state.state_of(room).notes


def test_filling_what_was_not_rendered_leaves_others_images_alone(room):
    """Of another scene, of a view layer that is switched off, and what an artist keeps."""
    front = room.view_layers.new("Foreground")
    bpy.ops.vir.render()
    own = scene_images(room.name)["VIR Shadow Lamp"]
    kept = [own.copy(), scene_images(room.name)["VIR Shadow Lamp (Foreground)"]]
    with bpy.context.temp_override(scene=full_copy_of(room)):
        bpy.ops.vir.render()
    kept += [image for image in bpy.data.images if image.get("vir_scene") == "Scene.001"]
    kept.append(bpy.data.images.new("VIR Shadow Sun", 4, 4, float_buffer=True))
    before = [pixels_of(image) for image in kept]
    front.use = False
    bpy.data.objects["Lamp"].hide_render = True
    bpy.ops.vir.render()
    assert (pixels_of(own) == 1.0).all()
    for image, pixels in zip(kept, before, strict=True):
        np.testing.assert_array_equal(pixels_of(image), pixels)
    assert len(kept) > 6 and not any("Lamp" in note for note in frame_state.state_of(room).notes), "nothing uses it"


def test_what_was_not_rendered_is_in_the_report(room):
    bpy.ops.vir.render()
    bpy.ops.vir.add_to_compositor()
    tree = room.compositing_node_group if bpy.app.version >= (5, 0) else room.node_tree
    (node,) = (node for node in tree.nodes if node.type == "GROUP")
    tree.links.new(node.outputs["VIR Shadow Lamp"], tree.nodes.new("CompositorNodeBlur").inputs["Image"])
    bpy.data.objects["Lamp"].hide_render = True
    bpy.ops.vir.render()
    note = "VIR Shadow Lamp is not rendered in this frame: the pass is white"
    assert report_file.write_report(room).read_text().count(note) == 1
    bpy.data.objects["Lamp"].hide_render = False
    bpy.ops.vir.plan()
    assert note not in frame_state.state_of(room).notes
    assert note in report_file.write_report(room).read_text(), "it tells of the passes that are there"
    bpy.ops.vir.render()
    assert note not in report_file.write_report(room).read_text()


def test_passes_of_a_view_layer_that_is_gone_or_first_now_are_white(room):
    front = room.view_layers.new("Foreground")
    bpy.ops.vir.render()
    of_front = scene_images(room.name)["VIR Shadow Key (Foreground)"]
    bpy.data.textures.new("user", "IMAGE").image = of_front
    note = "VIR Shadow Key (Foreground) is not rendered in this frame: the pass is white"

    def is_told_white():
        assert (pixels_of(of_front) == 1.0).all() == (note in frame_state.state_of(room).notes)
        return note in frame_state.state_of(room).notes

    front.name = "Front"
    bpy.ops.vir.render()
    assert is_told_white() and pixels_of(scene_images(room.name)["VIR Shadow Key (Front)"]).min() < 0.5
    front.name = "Foreground"
    bpy.ops.vir.render()
    assert not is_told_white()
    room.view_layers["ViewLayer"].use = False
    bpy.ops.vir.render()
    assert is_told_white() and pixels_of(scene_images(room.name)["VIR Shadow Key"]).min() < 0.5
    room.view_layers["ViewLayer"].use = True
    bpy.ops.vir.render()
    assert not is_told_white()
    room.view_layers.remove(front)
    bpy.ops.vir.render()
    assert is_told_white()


def test_passes_of_a_scene_that_is_gone_stay(room):
    other = full_copy_of(room)
    with bpy.context.temp_override(scene=other):
        next(item for item in other.objects if item.name.startswith("Lamp")).name = "Moon"
        bpy.ops.vir.render()
    kept = scene_images(other.name)["VIR Shadow Moon"]
    before = pixels_of(kept)
    bpy.ops.vir.render()
    bpy.data.scenes.remove(other)
    bpy.ops.vir.render()
    np.testing.assert_array_equal(pixels_of(kept), before)


def test_what_is_not_rendered_any_more_is_filled_in_a_renamed_scene_too(room):
    bpy.ops.vir.render()
    own = scene_images(room.name)["VIR Shadow Lamp"]
    room.name = "Renamed"
    bpy.data.objects["Lamp"].hide_render = True
    bpy.ops.vir.render()
    assert (pixels_of(own) == 1.0).all()


def append(path, **wanted):
    """What is named so, by the kinds of the file's contents: images=["VIR Shadow"]"""
    with bpy.data.libraries.load(str(path), link=False) as (source, target):
        for kind, names in wanted.items():
            assert set(names) <= set(getattr(source, kind))
            setattr(target, kind, names)
    return [item for kind in wanted for item in getattr(target, kind)]


@pytest.mark.parametrize("is_first", [False, True])
def test_pictures_that_are_appended_are_not_taken_for_this_scenes(room, tmp_path, is_first):
    """From another version of the file: scenes, lights and images have the same names there."""
    path = tmp_path / "other.blend"
    bpy.ops.vir.render()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    if is_first:  # render of this scene: nothing says yet which images are its own
        del room[images.IMAGES_PROPERTY]
        for image in list(bpy.data.images):
            bpy.data.images.remove(image)
    bpy.data.lights.remove(bpy.data.lights["Lamp"])
    appended = append(path, images=["VIR Shadow Lamp", "VIR Shadow Key", "VIR Shadow"])
    before = [pixels_of(image) for image in appended]
    room.render.resolution_x = 64
    for _ in range(2):
        bpy.ops.vir.render()
    own = scene_images(room.name)
    assert not {*own.values()} & {*appended} and pixels_of(own["VIR Shadow Key"]).min() < 0.5
    assert ("VIR Shadow Lamp" in own) != is_first
    for image, pixels in zip(appended, before, strict=True):
        np.testing.assert_array_equal(pixels_of(image), pixels)


def test_an_appended_scene_brings_its_passes_and_leaves_this_ones_alone(room, tmp_path):
    path = tmp_path / "other.blend"
    bpy.ops.vir.render()
    bpy.ops.vir.add_to_compositor()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    own = scene_images(room.name)
    before = {name: pixels_of(image) for name, image in own.items()}
    room.vir.view_count = 16
    (other,) = append(path, scenes=["Scene"])
    assert other.name != "Scene" and (other.vir.view_count, other.vir.device) == (8, "MODERNGL")
    brought = scene_images(other.name)
    assert set(brought) == set(own) and not {*brought.values()} & {*own.values()} and scene_images(room.name) == own
    other.render.resolution_x = 64
    next(item for item in other.objects if item.name.startswith("Lamp")).hide_render = True
    with bpy.context.temp_override(scene=other):
        assert bpy.ops.vir.render() == {"FINISHED"}
    images_now = scene_images(other.name)
    assert (pixels_of(brought["VIR Shadow Lamp"]) == 1.0).all() and tuple(brought["VIR Shadow Lamp"].size) == (64, 27)
    assert set(brought.values()) <= set(images_now.values())
    for name, pixels in before.items():
        np.testing.assert_array_equal(pixels_of(own[name]), pixels)


def test_a_renamed_scene_takes_nothing_of_one_that_is_gone(room):
    other = full_copy_of(room)
    with bpy.context.temp_override(scene=other):
        next(item for item in other.objects if item.name.startswith("Lamp")).name = "Moon"
        bpy.ops.vir.render()
    name, kept = other.name, scene_images(other.name)
    before = {name: pixels_of(image) for name, image in kept.items()}
    bpy.data.scenes.remove(other)
    bpy.ops.vir.render()
    own = scene_images(room.name)
    room.name = name
    room.render.resolution_x = 64
    bpy.ops.vir.render()
    assert scene_images(room.name) == own
    for name, pixels in before.items():
        np.testing.assert_array_equal(pixels_of(kept[name]), pixels)


def test_a_copy_of_a_scene_gets_images_of_its_own(room):
    """It points at the same as the scene that it was copied from."""
    bpy.ops.vir.render()
    own = scene_images(room.name)
    other = full_copy_of(room)
    assert not scene_images(other.name) and not any(images.is_used(image) for image in own.values())
    with bpy.context.temp_override(scene=other):
        bpy.ops.vir.render()
    room.name = "Renamed"
    bpy.ops.vir.render()
    assert scene_images(room.name) == own and not {*own.values()} & {*scene_images(other.name).values()}


def test_images_of_files_that_do_not_tell_their_scene_are_known_by_its_name(room):
    bpy.ops.vir.render()
    before = scene_images(room.name)
    del room[images.IMAGES_PROPERTY]
    for image in before.values():
        del image[images.RECORDED_PROPERTY]
    bpy.data.objects["Lamp"].hide_render = True
    bpy.ops.vir.render()
    assert scene_images(room.name) == before and (pixels_of(before["VIR Shadow Lamp"]) == 1.0).all()
    assert all(image[images.RECORDED_PROPERTY] for image in before.values())


def test_a_layer_without_lights_is_white_where_others_have_them(room):
    lights = bpy.data.collections.new("Lights")
    room.collection.children.link(lights)
    for item in [item for item in room.objects if item.type == "LIGHT"]:
        room.collection.objects.unlink(item)
        lights.objects.link(item)
    dark = room.view_layers.new("Dark")
    dark.layer_collection.children["Lights"].exclude = True
    assert bpy.ops.vir.render() == {"FINISHED"}
    images = scene_images(room.name)
    assert pixels_of(images["VIR Shadow Key"]).min() < 0.5 and (pixels_of(images["VIR Shadow (Dark)"]) == 1.0).all()
    assert "no light is rendered in this frame and view layer: shadows are white" in frame_state.state_of(room).notes
    dark.layer_collection.children["Lights"].exclude = False
    for light in lights.objects:
        light.hide_render = True
    refuse(bpy.ops.vir.render, "no light that is rendered")


@pytest.mark.parametrize("beyond_px", [4000, -1])
def test_a_picture_larger_than_textures_is_refused_in_a_sentence_before_any_work(room, monkeypatch, beyond_px):
    width_px = devices.get_device("moderngl").max_texture_size_px + beyond_px
    monkeypatch.setattr("vir_addon.blender.stepped_render.render_in_steps", None)
    room.render.resolution_x = width_px
    for operator in (bpy.ops.vir.plan, bpy.ops.vir.render):
        refuse(operator, f"the picture is {width_px} x 27 px.*lower resolution")
        assert "lower resolution" in frame_state.state_of(room).problem and frame_state.state_of(room).running is None
    monkeypatch.undo()
    room.render.resolution_x = 48
    assert bpy.ops.vir.render() == {"FINISHED"} and not frame_state.state_of(room).problem


def test_the_report_is_one_whole_page(room):
    bpy.ops.vir.render()
    assert bpy.ops.vir.open_report() == {"FINISHED"}
    from vir_addon.blender.report_file import write_report

    page = write_report(room).read_text(encoding="utf-8")
    for words in ("VIR Shadow Key", "casts no shadow", "resolve", "data:image/png;base64,"):
        assert words in page
    assert "http" not in page, "the page must not need the network"


def test_a_report_that_cannot_be_written_is_said(room, monkeypatch):
    bpy.ops.vir.render()
    blocked = Path(bpy.app.tempdir, "vir_blocked")
    blocked.write_text("a file where a folder has to be")
    monkeypatch.setattr(report_file, "file_name_part", lambda _: "blocked/page")
    refuse(bpy.ops.vir.open_report, "cannot write .*vir_blocked")
    blocked.unlink()
    assert frame_state.state_of(room).statistics and scene_images(room.name)
    bpy.ops.vir.render()
    assert not frame_state.state_of(room).problem


def test_vertices_that_are_being_edited_cast_shadows(room):
    bpy.ops.vir.render()
    before = pixels_of(bpy.data.images["VIR Shadow"])
    cube = bpy.data.objects["Cube"]
    bpy.context.view_layer.objects.active = cube
    bpy.ops.object.mode_set(mode="EDIT")
    edited = bmesh.from_edit_mesh(cube.data)
    for vertex in edited.verts:
        vertex.co.z += 1.0
    bmesh.update_edit_mesh(cube.data)
    bpy.ops.vir.render()
    assert cube.mode == "EDIT"
    assert np.abs(pixels_of(bpy.data.images["VIR Shadow"]) - before).max() > 0.1
    bpy.ops.object.mode_set(mode="OBJECT")


def test_a_light_deleted_while_it_renders_changes_nothing(room):
    jobs = operators.plan_frame(room)
    render = SteppedRender(jobs, "moderngl")
    bpy.data.objects.remove(bpy.data.objects["Key"])
    wait_for(render)
    assert render.error is None
    assert "VIR Shadow Key" in operators.finish_render(room, render, 1.0)


def wait_for(render, seconds=60.0):
    end = time.monotonic() + seconds
    while not render.step():
        assert time.monotonic() < end, "the render does not end"
        time.sleep(0.005)


@pytest.mark.parametrize("device", ["moderngl", "gpu"])
def test_cancelling_keeps_what_was_there_and_frees_the_device(room, device):
    if device == "gpu" and bpy.app.version < (5, 2):
        pytest.skip("Blender's module works in background from 5.2 on")
    room.vir.device = device.upper()
    bpy.ops.vir.render()
    before = {name: pixels_of(image) for name, image in scene_images(room.name).items()}
    room.vir.view_count = 512
    render = SteppedRender(operators.plan_frame(room), device)
    while render.state.views_done == 0:
        assert not render.step()
        time.sleep(0.001)
    render.cancel()
    render.join()
    assert render.is_done and not render.layers and render.error is None
    assert all((pixels_of(image) == before[name]).all() for name, image in scene_images(room.name).items())
    room.vir.view_count = 8
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert all((pixels_of(image) == before[name]).all() for name, image in scene_images(room.name).items())


@pytest.mark.parametrize("reflects", [False, True])
def test_blenders_own_graphics_are_left_within_batches_too(room, monkeypatch, reflects):
    """Nothing else happens in the window meanwhile, not even Esc."""
    if bpy.app.version < (5, 2):
        pytest.skip("Blender's module works in background from 5.2 on")
    room.vir.device, room.vir.use_reflections = "GPU", reflects
    if reflects:
        bpy.data.objects["Cube"].vir.reflector = "ALWAYS"
    bpy.ops.vir.render()
    before = {name: pixels_of(image) for name, image in scene_images(room.name).items()}
    monkeypatch.setattr("vir_addon.blender.stepped_render.STEP_S", 0.0)
    jobs = operators.plan_frame(room)
    whole = SteppedRender(jobs, "gpu")
    step_count = 1
    while not whole.step():
        step_count += 1
    batch_count = jobs["ViewLayer"].plan.batch_count
    assert step_count > 4 * batch_count and whole.error is None
    operators.finish_render(room, whole, 1.0)
    for name, image in scene_images(room.name).items():
        np.testing.assert_array_equal(pixels_of(image), before[name])
    for stop in range(1, step_count, max(1, step_count // 9)):
        render = SteppedRender(jobs, "gpu")
        for _ in range(stop):
            assert not render.step()
        render.cancel()
        assert render.is_done and not render.layers and render.error is None
    assert bpy.ops.vir.render() == {"FINISHED"}
    for name, image in scene_images(room.name).items():
        np.testing.assert_array_equal(pixels_of(image), before[name])


def test_switching_the_extension_off_ends_what_runs(room):
    room.vir.view_count = 4096
    frame_state.state_of(room).running = render = SteppedRender(operators.plan_frame(room), "moderngl")
    blender.unregister()
    assert render.is_done and not render.layers
    blender.register()


def test_switching_the_extension_off_ends_what_runs_in_a_window(room, monkeypatch):
    """Blender forgets running operators of classes that go: nobody would take the timer and the status bar's text back."""
    manager = SimpleNamespace(event_timer_remove=Mock(), progress_end=Mock(), windows=[])
    context = SimpleNamespace(window_manager=manager, workspace=SimpleNamespace(status_text_set=Mock()))
    monkeypatch.setattr(operators, "bpy", SimpleNamespace(context=context))
    render = SteppedRender(operators.plan_frame(room), "moderngl")
    running = SimpleNamespace(_render=render, _timer="timer")
    running.cancel = partial(operators.VIR_OT_render.cancel, running)
    running._end = partial(operators.VIR_OT_render._end, running)
    operators._modal.append(running)
    blender.unregister()
    assert render.is_cancelled and not operators._modal
    manager.event_timer_remove.assert_called_once_with("timer")
    manager.progress_end.assert_called_once_with()
    context.workspace.status_text_set.assert_called_once_with(None)
    blender.register()


def test_a_cancelled_render_has_ended_before_its_device_is_closed(room):
    room.vir.view_count = 4096
    render = SteppedRender(operators.plan_frame(room), "moderngl")
    render.cancel()  # as Escape does, without waiting
    blender.unregister()
    assert render.is_done and render.error is None
    blender.register()


def test_opening_another_file_ends_what_runs(room):
    room.vir.view_count = 4096
    frame_state.state_of(room).running = render = SteppedRender(operators.plan_frame(room), "moderngl")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert render.is_done and frame_state.state_of(bpy.context.scene).running is None


def test_an_interrupted_render_does_not_go_on(room, monkeypatch):
    def interrupt(render):
        made.append(render)
        raise KeyboardInterrupt

    made = []
    room.vir.view_count = 4096
    monkeypatch.setattr(SteppedRender, "step", interrupt)
    with pytest.raises((RuntimeError, KeyboardInterrupt)):
        bpy.ops.vir.render()
    made[0].join()
    assert made[0].is_cancelled and not made[0].layers


def test_an_error_of_the_device_arrives_and_the_next_render_works(room, monkeypatch):
    from vir_addon.core.render import Renderer

    def lost(*_):
        raise DeviceError("the device is lost")

    before = devices.get_device("moderngl")
    with monkeypatch.context() as broken:
        broken.setattr(Renderer, "render_batch", lost)
        refuse(bpy.ops.vir.render, "the device is lost")
        assert frame_state.state_of(room).problem == "the device is lost"
        assert devices.get_device("moderngl") is not before
    assert not scene_images(room.name) and frame_state.state_of(room).running is None
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert not frame_state.state_of(room).problem


def test_no_camera(room):
    room.camera = None
    refuse(bpy.ops.vir.render, "camera")
    assert "no camera" in operators.reason_against_rendering(bpy.context)
    with pytest.raises(SceneError, match="camera"):
        operators.plan_frame(room)


def test_no_light(room):
    for item in [item for item in room.objects if item.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    refuse(bpy.ops.vir.render, "poll|light")
    assert "no light" in operators.reason_against_rendering(bpy.context)


@pytest.mark.parametrize("left", ["nothing", "volume", "grease pencil"])
def test_no_surface(room, left):
    for item in [item for item in room.objects if item.type == "MESH"]:
        bpy.data.objects.remove(item)
    if left == "volume":
        room.collection.objects.link(bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke")))
    if left == "grease pencil":
        bpy.ops.object.grease_pencil_add(type="STROKE")
    refuse(bpy.ops.vir.render, "no surface that a shadow could fall on")
    assert "no surface" in frame_state.state_of(room).problem
    assert not scene_images(room.name)


def test_a_short_render_does_not_tell_how_long_others_take(room, monkeypatch):
    """What any render begins with is most of it: scaled by that, long ones would take many times as long as they do."""
    monkeypatch.setattr(frame_state, "_time_factors", {})
    monkeypatch.setattr(frame_state, "LEAST_TELLING_S", np.inf)
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert frame_state.time_factor() is None
    monkeypatch.setattr(frame_state, "LEAST_TELLING_S", 0.0)
    assert bpy.ops.vir.render() == {"FINISHED"}
    told = frame_state.time_factor()
    assert told > 0
    monkeypatch.setattr(frame_state, "LEAST_TELLING_S", np.inf)
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert frame_state.time_factor() == told


def test_a_render_of_nothing_does_not_tell_how_long_others_take(room, monkeypatch):
    """All that is in the picture, and in the way of light, is hidden: less is predicted than it takes to find that out."""
    monkeypatch.setattr(frame_state, "LEAST_TELLING_S", 0.0)
    assert bpy.ops.vir.render() == {"FINISHED"}
    before = frame_state.time_factor()
    assert before > 0
    for item in room.objects:
        item.hide_render = item.type == "MESH"
    bpy.ops.mesh.primitive_plane_add(location=(0.0, -100.0, 0.0))  # behind the camera
    assert bpy.ops.vir.render() == {"FINISHED"}
    assert not any(one.view_count for one in frame_state.state_of(room).statistics["ViewLayer"].passes)
    assert frame_state.time_factor() == before


def test_asking_for_nothing_is_said(room):
    room.vir.use_soft_shadows = room.vir.use_omni_shadows = False
    refuse(bpy.ops.vir.render, "effect")
    assert "effect" in frame_state.state_of(room).problem


def test_what_is_mended_is_said_no_more(room):
    """Not before another plan or render: by what it was refused for."""
    scene, state = room, frame_state.state_of(room)
    mends = {
        "effect": (lambda: setattr(scene.vir, "use_soft_shadows", False), lambda: setattr(scene.vir, "use_soft_shadows", True)),
        "panoramic": (lambda: setattr(scene.camera.data, "type", "PANO"), lambda: setattr(scene.camera.data, "type", "PERSP")),
        "too small": (
            lambda: setattr(scene.render, "resolution_percentage", 1),
            lambda: setattr(scene.render, "resolution_percentage", 100),
        ),
        "light": (lambda: hide_lights(True), lambda: hide_lights(False)),
    }

    def hide_lights(is_hidden):
        for item in scene.objects:
            item.hide_render = is_hidden if item.type == "LIGHT" else item.hide_render

    scene.vir.use_omni_shadows = False
    for text, (spoil, mend) in mends.items():
        spoil()
        refuse(bpy.ops.vir.render, text)
        scene.objects["Lamp"].select_set(True)
        scene.vir.active_light = "Lamp"
        assert [one for one in panels._problems(scene, state) if text in one], "nothing of it has changed"
        mend()
        assert panels._problems(scene, state) == []
    # what nobody can see the end of stays until something is rendered
    frame_state.note_problem(scene, RuntimeError("broken"), operators.mendable_by(scene))
    scene.render.resolution_percentage = 50
    assert "broken" in panels._problems(scene, state)[0]
    frame_state.note_problem(scene, DeviceError("lost"))
    assert panels._problems(scene, state) == ["lost"]
    bpy.ops.vir.plan()
    assert panels._problems(scene, state) == []


def test_nothing_to_add_and_nothing_to_report_yet(room):
    refuse(bpy.ops.vir.add_to_compositor, "poll|passes yet")
    refuse(bpy.ops.vir.open_report, "poll|rendered")


def test_undo_takes_the_passes_back(room):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.vir.render()
    bpy.ops.ed.undo_push(message="Render Passes")
    assert scene_images(room.name)
    bpy.ops.ed.undo()
    assert not scene_images(bpy.context.scene.name)
    bpy.ops.ed.redo()
    assert pixels_of(scene_images(bpy.context.scene.name)["VIR Shadow Key"]).min() < 0.5


def test_reflections_are_passes_in_colour(room):
    mirror = bpy.data.objects["Cube"]
    material = bpy.data.materials.new("Mirror")
    if bpy.app.version < (5, 0):  # later ones always have nodes, and warn
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.0
    shader.inputs["Base Color"].default_value = (1.0, 0.5, 0.2, 1.0)
    mirror.data.materials.append(material)
    room.vir.use_reflections = True
    assert bpy.ops.vir.render() == {"FINISHED"}
    runs, how = frame_state.state_of(room).reflectors["Cube"]
    assert runs and how
    images = scene_images(room.name)
    colour = pixels_of(images["VIR Reflection Color"]).reshape(27, 48, -1)[..., :3]
    assert {"VIR Reflection", "VIR Shadow Key"} <= set(images) and colour[..., 0].max() > 1.5 * colour[..., 2].max() > 0
    bpy.ops.vir.add_to_compositor()
    assert bpy.ops.vir.open_report() == {"FINISHED"}
    assert panels.reflector_names(room) == {"Cube"}
    room.vir.active_reflector_index = room.objects.find("Cube")
    assert room.vir.active_reflector == "Cube" and room.objects[room.vir.active_reflector_index] == mirror
    mirror.vir.reflector = "NEVER"
    bpy.ops.vir.plan()
    assert panels.reflector_names(room) == {"Cube"}, "it could not be taken back"
    assert not any(runs for runs, _ in frame_state.state_of(room).reflectors.values())
    room.vir.use_reflections = False
    bpy.ops.vir.render()
    assert not any(pixels_of(images[name]).reshape(-1, 4)[:, :3].any() for name in ("VIR Reflection", "VIR Reflection Color"))


def test_a_reflector_of_one_of_several_view_layers(room):
    state = frame_state.SceneState()
    drawn, unseen = (
        (Reflector("Mirror", np.zeros(1, np.int64), runs, reason),) for runs, reason in ((True, "reflects"), (False, "not in the picture"))
    )
    for order in ((drawn, unseen), (unseen, drawn)):
        state.reflectors = {}
        for lines in order:
            job = SimpleNamespace(
                plan=SimpleNamespace(passes=(), notes=(), reflections=SimpleNamespace(lines=lines)), snapshot=SimpleNamespace(left_out=())
            )
            frame_state._add_plan(state, room, "Layer", job)
        assert state.reflectors == {"Mirror": (True, "reflects")}


def test_reflections_alone_leave_shadows_out(room):
    room.vir.use_soft_shadows = room.vir.use_omni_shadows = False
    room.vir.use_reflections = True
    bpy.data.objects["Cube"].vir.reflector = "ALWAYS"
    bpy.ops.vir.render()
    assert set(scene_images(room.name)) == {"VIR Reflection", "VIR Reflection Color"}


def test_a_renamed_light_keeps_its_row_and_what_was_planned(room):
    """Files have names; a light that comes to bear another's old name has not been planned."""
    bpy.ops.vir.plan()
    key, state = bpy.data.objects["Key"], frame_state.state_of(room)
    room.vir.active_light_index = room.objects.find("Key")
    planned = frame_state.decision_text(state, state.name_of(key))
    assert "view" in planned
    key.name = "Main"
    assert state.name_of(key) == "Key" and frame_state.decision_text(state, state.name_of(key)) == planned
    assert room.objects[room.vir.active_light_index] == key
    other = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA"))
    room.collection.objects.link(other)
    assert other.name == "Key" and room.objects[room.vir.active_light_index] == key
    assert frame_state.decision_text(state, state.name_of(other)) == "not planned yet"
    bpy.ops.vir.plan()
    assert (state.name_of(key), state.name_of(other)) == ("Main", "Key")


@pytest.mark.parametrize("property_name", ["active_light", "active_reflector", "preview_light"])
def test_a_name_that_a_script_sets_means_the_object_that_has_it_then(room, property_name):
    """Not one that bore it when the property was set before."""
    first = bpy.data.objects["Key"]
    setattr(room.vir, property_name, "Key")
    assert named_object(room.vir, property_name) == first
    first.name = "Main"
    second = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA"))
    room.collection.objects.link(second)
    assert named_object(room.vir, property_name) == first
    setattr(room.vir, property_name, "Key")
    assert named_object(room.vir, property_name) == second
    setattr(room.vir, property_name, "Nobody")
    assert named_object(room.vir, property_name) is None


@pytest.mark.parametrize("property_name", ["active_light", "active_reflector", "preview_light"])
@pytest.mark.parametrize("has_namesake", [False, True])
def test_a_copy_of_a_scene_means_what_the_scene_means(room, property_name, has_namesake):
    key = bpy.data.objects["Key"]
    setattr(room.vir, property_name, "Key")
    key.name = "Main"
    if has_namesake:
        room.collection.objects.link(bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA")))
    copy = room.copy()
    assert named_object(copy.vir, property_name) == named_object(room.vir, property_name) == key
    # what is set in one of them is not meant in the other
    setattr(copy.vir, property_name, "Lamp")
    assert named_object(copy.vir, property_name).name == "Lamp" and named_object(room.vir, property_name) == key
    bpy.data.scenes.remove(copy)


@pytest.mark.parametrize("property_name", ["active_light", "active_reflector", "preview_light"])
@pytest.mark.parametrize("is_first_removed", [False, True])
def test_copies_of_scenes_that_mean_two_objects_by_one_name(room, property_name, is_first_removed):
    """Each means what the scene does that it was copied from, also once another scene is gone."""
    first, scenes = bpy.data.objects["Key"], [bpy.data.scenes.new(name) for name in ("Origin", "Other")]
    scenes[0].collection.objects.link(first)
    setattr(scenes[0].vir, property_name, "Key")
    first.name = "Main"
    second = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA"))
    for item in (first, second):
        scenes[1].collection.objects.link(item)
    setattr(scenes[1].vir, property_name, "Key")
    copies = [scene.copy() for scene in scenes]
    if is_first_removed:
        bpy.data.scenes.remove(scenes.pop(0))
    copies += [scene.copy() for scene in scenes]
    meant = [named_object(scene.vir, property_name) for scene in (*scenes, *copies)]
    assert meant == ([second, first, second, second] if is_first_removed else [first, second] * 3)
    # a name that comes without a call
    stored_values(copies[0].vir)[property_name] = "Lamp"
    copies[0].collection.objects.link(bpy.data.objects["Lamp"])
    assert named_object(copies[0].vir, property_name) == bpy.data.objects["Lamp"]
    for scene in (*scenes, *copies):
        bpy.data.scenes.remove(scene)


@pytest.mark.parametrize("property_name", ["active_light", "active_reflector", "preview_light"])
def test_a_full_copy_of_a_scene_means_the_copy_of_what_the_scene_means(room, property_name):
    """Whose name is another one; also where the object was renamed before, and where the scene is gone that was copied."""
    key = bpy.data.objects["Key"]
    setattr(room.vir, property_name, "Key")
    for name in ("Key", "Main"):
        key.name = name
        copy = full_copy_of(room)
        meant = named_object(copy.vir, property_name)
        assert copy is not room and meant.name == f"{name}.001" and meant.name in copy.objects
        # one that is copied within the scene is not meant, nor is any once what was meant is gone
        copy.collection.objects.link(meant.copy())
        assert named_object(copy.vir, property_name) == meant
        write_names([copy.vir], [property_name])
        assert getattr(copy.vir, property_name) == meant.name
        bpy.data.objects.remove(meant)
        assert named_object(copy.vir, property_name) is None
        bpy.data.scenes.remove(copy)
    assert named_object(room.vir, property_name) == key


def test_a_full_copy_means_the_same_once_another_property_or_copy_chooses_it_too(room):
    room.vir.active_light = "Key"
    copy = full_copy_of(room)
    linked = copy.copy()
    meant = bpy.data.objects["Key.001"]
    copy.vir.preview_light = "Key.001"
    assert [named_object(scene.vir, "active_light") for scene in (room, copy, linked)] == [bpy.data.objects["Key"], meant, meant]
    # and so does a full copy of it
    second = full_copy_of(copy)
    assert {named_object(second.vir, name).name for name in ("active_light", "preview_light")} == {"Key.002"}
    for scene in (copy, linked, second):
        bpy.data.scenes.remove(scene)


def test_a_full_copy_does_not_mean_a_duplicate_that_was_chosen_beside_its_original(room):
    """Which carries what the original was meant as, and comes before it here."""
    key, inner = bpy.data.objects["Key"], bpy.data.collections.new("Inner")
    room.collection.children.link(inner)
    inner.objects.link(key)
    room.collection.objects.unlink(key)
    room.vir.active_light = "Key"
    room.collection.objects.link(key.copy())
    room.vir.preview_light = "Key.001"
    copy = full_copy_of(room)
    key_of_copy, other_of_copy = (named_object(copy.vir, name) for name in ("active_light", "preview_light"))
    assert list(copy.objects).index(other_of_copy) < list(copy.objects).index(key_of_copy)
    assert key_of_copy.users_collection[0].name == "Inner.001"
    bpy.data.scenes.remove(copy)


def test_undo_brings_back_which_object_a_name_meant(room):
    room.vir.active_light = "Key"
    bpy.data.objects["Key"].name = "Main"
    bpy.data.objects["Fill"].name = "Key"
    bpy.ops.ed.undo_push(message="before")
    room.vir.active_light = "Lamp"
    bpy.ops.ed.undo_push(message="chosen")
    bpy.ops.ed.undo()
    undone = bpy.context.scene.vir
    assert undone.active_light == "Key" and named_object(undone, "active_light") == bpy.data.objects["Main"]


def test_figures_of_a_render_stay_with_lights_that_are_renamed_and_planned_again(room):
    """They are those of the pictures until another render; names may be swapped, and lights deleted."""
    bpy.ops.vir.render()
    key, lamp, state = bpy.data.objects["Key"], bpy.data.objects["Lamp"], frame_state.state_of(room)
    figures = [state.made(light.name).error_estimate for light in (key, lamp)]
    assert figures[0] != figures[1]

    def swap():
        names = key.name, lamp.name
        key.name = "Spare"
        lamp.name, key.name = names

    for _ in range(2):
        swap()
        assert [state.made(state.name_of(light)).error_estimate for light in (key, lamp)] == figures
        bpy.ops.vir.plan()
        assert [state.name_of(light) for light in (key, lamp)] == [key.name, lamp.name]
        assert [state.made(light.name).error_estimate for light in (key, lamp)] == figures
    # of one that is not planned, too
    key.hide_render = True
    bpy.ops.vir.plan()
    swap()
    bpy.ops.vir.plan()
    assert [state.made(light.name).error_estimate for light in (key, lamp)] == figures
    name = key.name
    bpy.data.objects.remove(key)
    lamp.name = name
    bpy.ops.vir.plan()
    assert state.made(name).error_estimate == figures[1]
    assert sum(len(layer.passes) for layer in state.statistics.values()) == 2  # with Fill


def test_a_lost_device_is_told_with_what_to_do_and_another_one_opened(room, monkeypatch):
    bpy.ops.vir.render()
    before = pixels_of(scene_images(room.name)["VIR Shadow Key"])
    bpy.data.objects["Cube"].location.x = 1.0
    device = devices.get_device("moderngl")

    def refuse(*_):
        raise RuntimeError("context lost")

    with monkeypatch.context() as patch:
        patch.setattr(ModernglComputeKernel, "_dispatch", refuse)
        with pytest.raises(RuntimeError, match=r"the graphics device failed or was lost \(context lost\): render again"):
            bpy.ops.vir.render()
    problem = frame_state.state_of(room).problem
    assert "restart Blender" in problem and "internal" not in problem
    np.testing.assert_array_equal(pixels_of(scene_images(room.name)["VIR Shadow Key"]), before)
    assert bpy.ops.vir.render() == {"FINISHED"} and devices.get_device("moderngl") is not device
    assert (pixels_of(scene_images(room.name)["VIR Shadow Key"]) != before).any() and not frame_state.state_of(room).problem


def test_a_mistake_of_ours_is_no_lost_device(room, monkeypatch):
    def mistaken(*_):
        raise RuntimeError("ours")

    monkeypatch.setattr("vir_addon.blender.stepped_render.check_device", mistaken)
    refuse(bpy.ops.vir.render, "internal error, see the console: RuntimeError: ours")
