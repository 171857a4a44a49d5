"""F12 and animations: every rendered frame's passes are in its compositor, with any engine, layer by layer."""

import os
import subprocess
import sys
import threading

import numpy as np
import OpenEXR
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.test_material_opacity import Nodes, with_uvs  # noqa: E402  (bpy decides whether this file runs)
from tests.blender.test_material_surface import saved_image  # noqa: E402
from vir_addon import blender  # noqa: E402
from vir_addon.blender import devices, frame_hook, frame_state  # noqa: E402
from vir_addon.blender.images import MISSING_COLOR, scene_images  # noqa: E402
from vir_addon.blender.materials import image_cache  # noqa: E402
from vir_addon.core.errors import DeviceError  # noqa: E402
from vir_addon.core.render import Renderer  # noqa: E402

WIDTH, HEIGHT = 48, 27
PASS = "VIR Shadow Key"


@pytest.fixture
def animated(scene, add, tmp_path):
    """A cube that moves over a floor in three frames; its passes go through the compositor into the render's file."""
    blender.register()
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.engine = "BLENDER_WORKBENCH"
    cube = add.cube(location=(-2.0, 0.0, 1.0))
    cube.keyframe_insert("location", frame=1)
    cube.location.x = 2.0
    cube.keyframe_insert("location", frame=3)
    add.mesh("Floor", [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [(0, 1, 2, 3)])
    scene.camera.location, scene.camera.rotation_euler = (0.0, -10.0, 4.0), (1.2, 0.0, 0.0)
    add.light("Key", data={"size": 1.0, "energy": 500.0}, location=(2.0, -2.0, 5.0))
    scene.vir.view_count, scene.vir.map_resolution_px, scene.vir.device = 8, 64, "MODERNGL"
    scene.frame_start, scene.frame_end, scene.frame_current = 1, 3, 1
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR", "32", "NONE"
    scene.render.filepath = str(tmp_path / "frame_")
    yield scene
    blender.unregister()


def compose(scene, pass_name=PASS):
    """The pass becomes the picture."""
    bpy.ops.vir.render()
    bpy.ops.vir.add_to_compositor()
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0) else scene.node_tree
    wanted = "NodeGroupOutput" if bpy.app.version >= (5, 0) else "CompositorNodeComposite"
    target = next(node for node in tree.nodes if node.bl_idname == wanted)
    group = next(node for node in tree.nodes if node.type == "GROUP")
    tree.links.new(group.outputs[pass_name], target.inputs["Image"])


def rendered(tmp_path, frame):
    """(height, width) float32, the last row on top"""
    channels = OpenEXR.File(str(tmp_path / f"frame_{frame:04d}.exr"), separate_channels=True).channels()
    return channels["R"].pixels[::-1]


def pixels_of(scene):
    """(height, width) of its pass"""
    pixels = np.empty(WIDTH * HEIGHT * 4, np.float32)
    scene_images(scene.name_full)[PASS].pixels.foreach_get(pixels)
    return pixels.reshape(HEIGHT, WIDTH, 4)[..., 0]


def by_button(scene, frame):
    scene.frame_set(frame)
    bpy.ops.vir.render()
    return pixels_of(scene)


def test_an_animation_has_each_frames_passes(animated, tmp_path):
    compose(animated)
    animated.vir.use_on_render = True
    assert animated.render.use_lock_interface and not frame_hook.reasons_against_frames(animated)
    bpy.ops.render.render(animation=True)
    frames = [rendered(tmp_path, frame) for frame in (1, 2, 3)]
    animated.vir.use_on_render = False
    for frame, pixels in enumerate(frames, 1):
        np.testing.assert_array_equal(pixels, by_button(animated, frame))
    assert np.abs(frames[0] - frames[2]).max() > 0.5


def test_a_frame_without_its_only_light_is_white(animated, tmp_path, capsys):
    key = bpy.data.objects["Key"]
    for frame in (1, 2, 3):
        key.hide_render = frame == 2
        key.keyframe_insert("hide_render", frame=frame)
    animated.frame_set(1)
    compose(animated)
    animated.vir.use_on_render = True
    bpy.ops.render.render(animation=True)
    first, second, third = (rendered(tmp_path, frame) for frame in (1, 2, 3))
    assert first.min() < 0.5 and (second == 1.0).all() and third.min() < 0.5
    assert f"VIR: frame 2, ViewLayer: {PASS} is not rendered in this frame: the pass is white" in capsys.readouterr().out
    key.animation_data_clear()
    key.hide_render = True
    bpy.ops.render.render()
    assert "no light that is rendered" in frame_state.state_of(animated).problem


def test_a_frame_larger_than_textures_is_told_in_a_sentence(animated, capsys):
    compose(animated)
    animated.vir.use_on_render = True
    # Blender's own engines have limits too
    device = devices.get_device("moderngl")
    device.max_texture_size_px, kept = WIDTH, device.max_texture_size_px
    try:
        bpy.ops.render.render()
    finally:
        device.max_texture_size_px = kept
    assert tuple(scene_images(animated.name)[PASS].pixels[:3]) == MISSING_COLOR
    told = f"the picture is {WIDTH} x {HEIGHT} px"
    assert frame_state.state_of(animated).problem.startswith(told) and f"VIR: frame 1, ViewLayer: {told}" in capsys.readouterr().out


@pytest.mark.parametrize("is_only_one_chosen", [False, True])
def test_frames_without_a_light_do_not_show_its_shadow_of_another(animated, add, tmp_path, capsys, is_only_one_chosen):
    lamp = add.light("Lamp", "POINT", data={"energy": 500.0}, location=(-2.0, -1.0, 6.0))
    lamp.data.vir.use_pass = not is_only_one_chosen
    key = bpy.data.objects["Key"]
    for frame in (1, 2, 3):
        key.hide_render = frame == 2
        key.keyframe_insert("hide_render", frame=frame)
    compose(animated)
    animated.vir.use_on_render = True
    bpy.ops.render.render(animation=True)
    first, second, third = (rendered(tmp_path, frame) for frame in (1, 2, 3))
    assert first.min() < 0.5 and (second == 1.0).all() and third.min() < 0.5
    text = f"{PASS} is not rendered in this frame: the pass is white"
    assert capsys.readouterr().out.count(f"VIR: frame 2, ViewLayer: {text}") == 1
    assert text not in frame_state.state_of(animated).notes


def test_reflections_of_each_frame(animated, tmp_path):
    material = bpy.data.materials.new("Mirror")
    if bpy.app.version < (5, 0):  # later ones always have nodes, and warn
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.1
    bpy.data.objects["Cube"].data.materials.append(material)
    animated.vir.use_reflections = True
    compose(animated, "VIR Reflection Color")
    animated.vir.use_on_render, animated.frame_end = True, 2
    bpy.ops.render.render(animation=True)
    frames = [rendered(tmp_path, frame) for frame in (1, 2)]
    animated.vir.use_on_render = False
    for frame, pixels in enumerate(frames, 1):
        by_button(animated, frame)
        image = scene_images(animated.name)["VIR Reflection Color"]
        np.testing.assert_array_equal(pixels, np.array(image.pixels[:], np.float32).reshape(HEIGHT, WIDTH, -1)[..., 0])
    assert frames[0].max() > 0.5 and np.abs(frames[0] - frames[1]).max() > 0.5


def test_images_are_read_once_in_an_animation(animated, tmp_path, monkeypatch):
    """Unless a handler of the artist's paints them."""
    image = saved_image(tmp_path, "leaf", np.full((4, 4, 4), 0.5, np.float32))
    nodes = Nodes("leaf")
    nodes.link(nodes.texture(image).outputs["Alpha"], nodes.principled().inputs["Alpha"])
    cube = bpy.data.objects["Cube"].data
    with_uvs(cube, uvs=np.zeros((24, 2)))
    cube.materials.append(nodes.material)
    read, take = [], image_cache.take_pixels
    monkeypatch.setattr(image_cache, "take_pixels", lambda image, **arguments: (read.append(image.name), take(image, **arguments))[1])
    compose(animated)
    animated.vir.use_on_render = True
    read.clear()
    bpy.ops.render.render(animation=True)
    assert len(read) == 1
    read.clear()
    paint = lambda *_: image.pixels.foreach_set(np.full(64, 0.5, np.float32))  # noqa: E731  a handler
    bpy.app.handlers.render_pre.insert(0, paint)
    bpy.ops.render.render(animation=True)
    bpy.app.handlers.render_pre.remove(paint)
    assert len(read) == 3 and not frame_hook._frame.images._read


def test_images_whose_file_changes_with_the_frame(animated, tmp_path):
    """By a handler, as flipbooks are made."""
    leaves = [saved_image(tmp_path, f"leaf {k}", np.full((4, 4, 4), alpha, np.float32)) for k, alpha in enumerate((1.0, 0.0, 1.0))]
    paths = [leaf.filepath for leaf in leaves]
    image = leaves[0]
    nodes = Nodes("leaf")
    nodes.link(nodes.texture(image).outputs["Alpha"], nodes.principled().inputs["Alpha"])
    cube = bpy.data.objects["Cube"].data
    with_uvs(cube, uvs=np.zeros((24, 2)))
    cube.materials.append(nodes.material)
    compose(animated)

    def swap(scene, *_):
        image.filepath = paths[scene.frame_current - 1]

    animated.vir.use_on_render = True
    bpy.app.handlers.frame_change_pre.append(swap)
    bpy.ops.render.render(animation=True)
    frames = [rendered(tmp_path, frame) for frame in (1, 2, 3)]
    animated.vir.use_on_render = False
    expected = [by_button(animated, frame) for frame in (1, 2, 3)]
    bpy.app.handlers.frame_change_pre.remove(swap)
    assert expected[1].min() > 0.9 > expected[0].min()
    for pixels, by_itself in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(pixels, by_itself)


def test_markers_that_change_the_camera(animated, tmp_path):
    """In the middle of an animation, and of a single render; the panel's button follows them too."""
    compose(animated)
    other = bpy.data.objects.new("Other", animated.camera.data)
    other.location, other.rotation_euler = (4.0, -7.0, 5.0), (1.0, 0.0, 0.5)
    animated.collection.objects.link(other)
    for frame, camera in ((1, animated.camera), (2, other), (3, bpy.data.objects["Camera"])):
        marker = animated.timeline_markers.new(camera.name, frame=frame)
        marker.camera = camera
    animated.vir.use_on_render = True
    bpy.ops.render.render(animation=True)
    frames = [rendered(tmp_path, frame) for frame in (1, 2, 3)]
    animated.vir.use_on_render = False
    for frame, pixels in enumerate(frames, 1):
        np.testing.assert_array_equal(pixels, by_button(animated, frame))
    # with one camera for all, the second would be another picture
    animated.timeline_markers.clear()
    animated.frame_set(2)
    animated.camera = bpy.data.objects["Camera"]
    assert np.abs(by_button(animated, 2) - frames[1]).max() > 0.5


def test_every_scene_has_its_own(animated, tmp_path):
    """Two scenes share objects; each frame's passes go into images of the scene that is rendered, with its own settings."""
    other = animated.copy()
    other.name = "Other"
    other.vir.use_on_render, other.vir.view_count = True, 12
    other.render.filepath = str(tmp_path / "other_")
    before = by_button(animated, 1)
    bpy.ops.render.render(scene="Other")
    assert PASS in scene_images("Other") and scene_images("Other")[PASS] != scene_images(animated.name)[PASS]
    (made,) = frame_state.state_of(other).statistics[other.view_layers[0].name].passes
    assert made.view_count == 12
    pixels = np.empty(WIDTH * HEIGHT * 4, np.float32)
    scene_images(animated.name)[PASS].pixels.foreach_get(pixels)
    np.testing.assert_array_equal(pixels.reshape(HEIGHT, WIDTH, 4)[..., 0], before)


def link_again(scene, path):
    """The scene as another file would have it, beside the one of its name"""
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with bpy.data.libraries.load(str(path), link=True) as (source, target):
        target.scenes = source.scenes
    (linked,) = target.scenes
    assert linked.name == scene.name and linked.library is not None
    return linked


def test_a_linked_scene_that_has_the_name_of_a_local_one_has_its_own_passes(animated, tmp_path):
    animated.vir.use_on_render = True
    linked = link_again(animated, tmp_path / "library.blend")
    before = by_button(animated, 3)
    with bpy.context.temp_override(scene=linked):
        bpy.ops.render.render()
        of_frame = pixels_of(linked)
        assert bpy.ops.vir.render() == {"FINISHED"}
    np.testing.assert_array_equal(pixels_of(linked), of_frame)
    np.testing.assert_array_equal(pixels_of(animated), before)
    assert np.abs(of_frame - before).max() > 0.5 and not frame_state.state_of(linked).problem


def test_passes_that_another_file_keeps_are_not_passed_for_those_of_the_frame(animated, tmp_path, capsys):
    compose(animated)
    animated.vir.use_on_render = True
    linked = link_again(animated, tmp_path / "library.blend")
    (reason,) = frame_hook.reasons_against_frames(linked)
    assert "belongs to another .blend file" in reason and not frame_hook.reasons_against_frames(animated)
    with bpy.context.temp_override(scene=linked):
        bpy.ops.render.render()
        assert frame_state.state_of(linked).problem == reason and reason in capsys.readouterr().out
        assert bpy.ops.vir.render() == {"FINISHED"}
    assert not frame_state.state_of(linked).problem and reason in frame_state.state_of(linked).notes


def test_animated_settings_are_those_of_the_frame(animated):
    animated.vir.use_on_render = True
    animated.vir.keyframe_insert("view_count", frame=1)
    animated.vir.view_count = 12
    animated.vir.keyframe_insert("view_count", frame=3)
    bpy.ops.render.render(animation=True)
    (made,) = (one for layer in frame_state.state_of(animated).statistics.values() for one in layer.passes)
    assert (frame_state.state_of(animated).frame, made.view_count) == (3, 12)


def test_saving_keeps_the_last_frame_that_was_made(animated, tmp_path):
    expected = by_button(animated, 1)
    animated.vir.use_on_render = True
    animated.frame_set(3)
    bpy.ops.render.render()
    last = np.array(scene_images(animated.name)[PASS].pixels[:])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    saved = np.array(scene_images(bpy.context.scene.name)[PASS].pixels[:])
    np.testing.assert_array_equal(saved, last)
    assert np.abs(saved.reshape(HEIGHT, WIDTH, 4)[..., 0] - expected).max() > 0.5


def test_images_change_on_the_main_thread_where_blender_goes_on_drawing(animated, monkeypatch):
    animated.vir.use_on_render = True
    asked = []
    monkeypatch.setattr(devices, "on_main_thread", lambda function: asked.append(function()))
    bpy.ops.render.render()
    assert not asked
    animated.render.use_lock_interface = False
    bpy.ops.render.render()
    assert len(asked) == 1 and PASS in asked[0]


def test_another_engine_too(animated, tmp_path):
    compose(animated)
    animated.render.engine = "CYCLES"
    animated.cycles.samples = 1
    animated.vir.use_on_render = True
    animated.frame_set(2)
    animated.render.filepath = str(tmp_path / "frame_0002.exr")
    bpy.ops.render.render(write_still=True)
    pixels = rendered(tmp_path, 2)
    animated.vir.use_on_render = False
    np.testing.assert_array_equal(pixels, by_button(animated, 2))


def test_switched_off_nothing_is_made(animated):
    bpy.ops.render.render()
    assert not scene_images(animated.name)


def test_every_view_layer_has_its_own(animated):
    layer = animated.view_layers.new("Without")
    hidden = bpy.data.collections.new("Hidden")
    animated.collection.children.link(hidden)
    cube = bpy.data.objects["Cube"]
    hidden.objects.link(cube)
    animated.collection.objects.unlink(cube)
    layer.layer_collection.children["Hidden"].exclude = True
    animated.vir.use_on_render = True
    bpy.ops.render.render()
    images = scene_images(animated.name)
    with_cube, without = (np.array(images[name].pixels[:]) for name in (PASS, f"{PASS} (Without)"))
    assert with_cube.min() < 0.5 and np.abs(with_cube - without).max() > 0.5
    state = frame_state.state_of(animated)
    assert set(state.statistics) == set(state.plans) == {animated.view_layers[0].name, "Without"}


def test_motion_blur_leaves_the_passes_of_the_frame_itself(animated, tmp_path, monkeypatch):
    compose(animated)
    animated.render.engine, animated.cycles.samples = "CYCLES", 1
    animated.render.use_motion_blur, animated.vir.use_on_render = True, True
    animated.frame_set(2)
    animated.render.filepath = str(tmp_path / "frame_0002.exr")
    made = []
    render_layer = frame_hook.render_layer
    monkeypatch.setattr(frame_hook, "render_layer", lambda *given: (made.append(given[0].frame_current), render_layer(*given)))
    bpy.ops.render.render(write_still=True)
    pixels = rendered(tmp_path, 2)
    animated.vir.use_on_render = False
    assert made == [2]
    np.testing.assert_array_equal(pixels, by_button(animated, 2))


def test_a_frame_that_fails_is_seen(animated, monkeypatch, capsys):
    bpy.ops.vir.render()
    animated.vir.use_on_render = True

    def lost(*_):
        raise DeviceError("the device is lost")

    monkeypatch.setattr(Renderer, "render_batch", lost)
    bpy.ops.render.render()
    assert tuple(scene_images(animated.name)[PASS].pixels[:3]) == MISSING_COLOR
    assert frame_state.state_of(animated).problem == "the device is lost" and "the device is lost" in capsys.readouterr().out


def test_the_panel_says_what_keeps_the_passes_out(animated):
    assert any("no compositor" in reason for reason in frame_hook.reasons_against_frames(animated))
    compose(animated)
    assert not frame_hook.reasons_against_frames(animated)
    tree = animated.compositing_node_group if bpy.app.version >= (5, 0) else animated.node_tree
    tree.nodes.remove(next(node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"))
    assert any("Render Layers" in reason for reason in frame_hook.reasons_against_frames(animated))


def test_a_busy_main_thread_is_not_waited_for_without_end(monkeypatch):
    monkeypatch.setattr(devices, "MAIN_THREAD_WAIT_S", 0.05)
    errors = []

    def ask():
        try:
            devices.on_main_thread(lambda: None)
        except DeviceError as error:
            errors.append(str(error))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert errors and "OpenGL" in errors[0]


def test_threads_are_served_by_the_main_thread_until_blender_quits():
    devices.register()
    answers, quits = [], threading.Event()

    def ask():
        answers.append(devices.on_main_thread(threading.current_thread))
        quits.wait()
        with pytest.raises(DeviceError, match="OpenGL"):
            devices.on_main_thread(threading.current_thread)
        answers.append("refused")

    thread = threading.Thread(target=ask)
    thread.start()
    while not answers:
        devices._serve_calls()
    devices.refuse_calls()
    quits.set()
    thread.join()
    devices.unregister()
    assert answers == [threading.main_thread(), "refused"]


def test_what_is_cancelled_while_a_frame_is_made_is_no_error(animated, monkeypatch):
    animated.vir.use_on_render, animated.vir.view_count = True, 4096

    def step(render):
        frame_state.forget_all()
        return render.is_done

    monkeypatch.setattr(frame_hook.SteppedRender, "step", step)
    bpy.ops.render.render()
    assert not frame_state.state_of(animated).problem and not scene_images(animated.name)


COMMAND_LINE = """
import sys
import bpy
if "--gpu" in sys.argv:
    import gpu
    gpu.init()
from vir_addon import blender
blender.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.ops.render.render(write_still=True)
blender.unregister()  # as Blender does when it quits
"""


@pytest.mark.parametrize("with_gpu", [False, True], ids=["without gpu.init", "with gpu.init"])
def test_beside_blenders_own_graphics(animated, tmp_path, with_gpu):
    """What a farm runs, in a process of its own: Blender's context must neither be needed nor harmed."""
    if with_gpu and bpy.app.version < (5, 2):
        pytest.skip("gpu.init came with 5.2")
    compose(animated)
    expected = by_button(animated, 1)
    animated.vir.use_on_render = True
    animated.render.filepath = str(tmp_path / "frame_0001.exr")
    for image in scene_images(animated.name).values():
        image.pixels.foreach_set(np.zeros(len(image.pixels), np.float32))
        image.pack()
    path = tmp_path / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    result = subprocess.run(
        [sys.executable, "-c", COMMAND_LINE, str(path), *(["--gpu"] if with_gpu else [])],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": os.getcwd()},
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr
    np.testing.assert_array_equal(rendered(tmp_path, 1), expected)
