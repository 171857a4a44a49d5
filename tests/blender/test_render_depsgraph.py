"""The stand-in engine: what it hands over, and that it leaves no trace."""

import warnings

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender import render_depsgraph  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.render_depsgraph import engine_of, is_evaluating, with_render_depsgraph  # noqa: E402
from vir_addon.core.errors import SceneError  # noqa: E402


@pytest.fixture
def evaluate(scene):
    return lambda function: with_render_depsgraph(scene, scene.view_layers[0], function)


def settings_of(scene) -> dict:
    """All settings of the scene that can be compared, render and Cycles included"""
    found = {}
    groups = {
        "scene": scene,
        "render": scene.render,
        "Cycles": scene.cycles,
        "image": scene.render.image_settings,
        **{layer.name: layer for layer in scene.view_layers},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of properties that will go in Blender 6
        for name, group in groups.items():
            for setting in group.bl_rna.properties:
                if setting.type in ("BOOLEAN", "INT", "FLOAT", "ENUM", "STRING"):
                    value = getattr(group, setting.identifier)
                    found[name, setting.identifier] = tuple(value) if getattr(setting, "is_array", False) else value
    return found


def handlers() -> dict[str, list]:
    by_name = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    return {name: list(functions) for name, functions in by_name.items() if isinstance(functions, list)}


def test_result_of_the_function_arrives(evaluate, scene):
    mode, layer, frame = evaluate(lambda depsgraph: (depsgraph.mode, depsgraph.view_layer.name, depsgraph.scene_eval.frame_current))
    assert (mode, layer, frame) == ("RENDER", "ViewLayer", scene.frame_current)


@pytest.mark.parametrize("error", [ZeroDivisionError("words"), SceneError("words"), KeyboardInterrupt()])
def test_exceptions_of_the_function_arrive_and_leave_no_trace(evaluate, scene, error):
    before = settings_of(scene)

    def fail(depsgraph):
        raise error

    with pytest.raises(type(error)) as caught:
        evaluate(fail)
    assert caught.value is error
    assert settings_of(scene) == before
    assert not is_evaluating()


def test_settings_handlers_engines_and_data_are_as_before(evaluate, scene, tmp_path):
    scene.render.engine = "CYCLES"
    render = scene.render
    render.use_persistent_data = render.use_motion_blur = render.use_border = render.use_crop_to_border = True
    render.border_max_x = 0.5
    render.filepath = str(tmp_path / "must not be written")
    bpy.app.handlers.render_complete.append(lambda *_: pytest.fail("a handler of renders was called"))
    bpy.app.handlers.render_init.append(lambda *_: pytest.fail("a handler of renders was called"))
    settings, kept_handlers = settings_of(scene), handlers()
    engines = {engine.__name__ for engine in bpy.types.RenderEngine.__subclasses__() if engine.is_registered}
    images = bpy.data.images.keys()
    assert evaluate(lambda depsgraph: (engine_of(depsgraph.scene), is_evaluating())) == ("CYCLES", True)
    assert settings_of(scene) == settings
    assert handlers() == kept_handlers
    assert {engine.__name__ for engine in bpy.types.RenderEngine.__subclasses__() if engine.is_registered} == engines
    assert bpy.data.images.keys() == images
    assert not list(tmp_path.iterdir())
    assert engine_of(scene) == "CYCLES"
    bpy.app.handlers.render_complete.clear()
    bpy.app.handlers.render_init.clear()


def test_last_render_stays(evaluate, scene, tmp_path):
    class RedEngine(bpy.types.RenderEngine):
        bl_idname = "VIR_RED"
        bl_label = "Red"

        def render(self, depsgraph):
            result = self.begin_result(0, 0, 8, 4)
            result.layers[0].passes["Combined"].rect.foreach_set(np.tile(np.float32([1, 0, 0, 1]), 32))
            self.end_result(result)

    def saved(name: str) -> bytes:
        path = tmp_path / name
        bpy.data.images["Render Result"].save_render(str(path))
        return path.read_bytes()

    scene.render.resolution_x, scene.render.resolution_y = 8, 4
    bpy.utils.register_class(RedEngine)
    scene.render.engine = "VIR_RED"
    bpy.ops.render.render()
    before = saved("before.png")
    slots = bpy.data.images["Render Result"].render_slots
    slot_count, slots.active_index = len(slots), 0
    for _ in range(3):
        evaluate(lambda depsgraph: None)
        assert saved("after.png") == before
        assert (len(slots), slots.active_index) == (slot_count + 1, 0)
    scene.render.engine = "CYCLES"
    bpy.utils.unregister_class(RedEngine)


def test_second_view_layer_on_its_own(scene, add):
    second = scene.view_layers.new("Second")
    second.use = False
    collection = bpy.data.collections.new("Only in the second")
    scene.collection.children.link(collection)
    add.cube("Cube", collection=collection)
    scene.view_layers[0].layer_collection.children[0].exclude = True
    seen = {
        layer.name: with_render_depsgraph(
            scene,
            layer,
            lambda depsgraph: (depsgraph.view_layer.name, sum(item.object.type == "MESH" for item in depsgraph.object_instances)),
        )
        for layer in scene.view_layers
    }
    assert seen == {"ViewLayer": ("ViewLayer", 0), "Second": ("Second", 1)}


def test_scene_that_is_not_the_current_one(scene):
    other = bpy.data.scenes.new("Other")
    other.camera = bpy.data.objects.new("Its camera", bpy.data.cameras.new("Its camera"))
    other.collection.objects.link(other.camera)
    engine = other.render.engine
    name = with_render_depsgraph(other, other.view_layers[0], lambda depsgraph: depsgraph.scene_eval.camera.name)
    assert name == "Its camera"
    assert bpy.context.scene == scene
    assert other.render.engine == engine


def test_a_linked_scene_that_has_the_name_of_a_local_one(scene, add, tmp_path):
    add.cube("Linked")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"), copy=True)
    bpy.data.objects["Linked"].name = "Local"
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (source, target):
        target.scenes = source.scenes
    (linked,) = target.scenes
    assert linked.name == scene.name

    def look(depsgraph):
        return depsgraph.scene.name_full, [item.name for item in depsgraph.objects if item.type == "MESH"]

    assert with_render_depsgraph(linked, linked.view_layers[0], look) == (linked.name_full, ["Linked"])
    assert with_render_depsgraph(scene, scene.view_layers[0], look) == (scene.name, ["Local"])


def test_border_without_pixels_is_explained(scene, evaluate):
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_max_x = 0.0
    with pytest.raises(SceneError, match="cannot render the scene 'Scene'"):
        evaluate(lambda depsgraph: None)
    assert scene.render.engine != render_depsgraph.ENGINE_ID


def test_calling_it_from_inside_itself_is_an_error(evaluate):
    with pytest.raises(RuntimeError, match="inside itself"):
        evaluate(lambda depsgraph: evaluate(lambda _: None))


def test_grease_pencil_needs_no_graphics_driver(evaluate, scene, capfd):
    bpy.ops.object.grease_pencil_add(type="MONKEY")
    kinds = evaluate(lambda depsgraph: [item.object.type for item in depsgraph.object_instances])
    assert "GREASEPENCIL" in kinds
    assert "EGL" not in capfd.readouterr().err
