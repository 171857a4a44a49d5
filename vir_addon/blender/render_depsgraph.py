"""Blender's own evaluation of a scene for rendering, without rendering it.

The dependency graph that `context.evaluated_depsgraph_get()` hands out is the viewport's: viewport levels of modifiers, objects hidden
in the viewport missing, objects hidden from renders present. Only a render engine is ever handed the other one. So a stand-in engine
is registered for the length of one call; its `render` runs the caller's function and draws nothing. Costs some milliseconds plus
Blender's evaluation of the scene, works in background.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import bpy

from ..core.errors import SceneError
from .unkeyed_edits import kept_unkeyed_edits

Result = TypeVar("Result")

ENGINE_ID = "VIR_EVALUATION"
_SLOT_NAME = "VIR (scene reading)"

_QUIET_SETTINGS: dict[str, Any] = {
    "engine": ENGINE_ID,
    "use_compositing": False,
    "use_sequencer": False,
    "use_freestyle": False,
    "use_multiview": False,  # would evaluate once per eye
    "use_persistent_data": False,  # would keep the stand-in engine's depsgraph alive after the call
}

# Handlers that mean "a render happens". Frame handlers stay: scripts that shape the scene hang there, a real render runs them too.
_RENDER_HANDLERS = (
    "render_init", "render_pre", "render_post", "render_write", "render_stats", "render_complete", "render_cancel",
    "composite_pre", "composite_post", "composite_cancel",
)  # fmt: skip

_real_engine_of_scene: dict[int, str] = {}


def is_evaluating() -> bool:
    """True while `with_render_depsgraph` runs: frame handlers of this add-on that act on renders must then do nothing."""
    return bool(_real_engine_of_scene)


def engine_of(scene: bpy.types.Scene) -> str:
    """The engine the user has chosen, also while the stand-in engine is in its place."""
    return _real_engine_of_scene.get(scene.session_uid, scene.render.engine)


def with_render_depsgraph(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, function: Callable[[bpy.types.Depsgraph], Result]
) -> Result:
    """`function(depsgraph)`, where the depsgraph is of mode RENDER and stands at the scene's current frame.

    The function must return plain data: the depsgraph and all it holds are freed afterwards, and `bpy.data` is not to be changed
    inside. Its exceptions arrive at the caller. Nothing is written to disk; settings, handlers and render results are left as they were
    (one empty render slot is added where there are results to protect).
    """
    if is_evaluating():
        raise RuntimeError("with_render_depsgraph was called from inside itself")
    if scene.camera is None:
        raise SceneError(f"The scene '{scene.name}' has no camera. Add one, or make one the active camera.")
    outcome = _Outcome(function)
    # after a render Blender evaluates the frame anew, and drops what was moved but not keyed
    with kept_unkeyed_edits(), _registered_engine(outcome), _quiet_render(scene, view_layer), _kept_render_result():
        try:
            # the operator's own `scene` argument finds scenes by name, and of a linked and a local one of one name always the local one
            with bpy.context.temp_override(scene=scene):
                bpy.ops.render.render(write_still=False)
        except RuntimeError as error:
            raise SceneError(f"Blender cannot render the scene '{scene.name}': {str(error).strip()}") from error
    return outcome.get(scene)


class _Outcome:
    """Carries a result or an exception out of the engine: Blender prints and drops what an engine raises."""

    def __init__(self, function: Callable[[bpy.types.Depsgraph], Any]) -> None:
        self._function = function
        self._has_run = False
        self._result: Any = None
        self._error: BaseException | None = None

    def run(self, depsgraph: bpy.types.Depsgraph) -> None:
        self._has_run = True
        try:
            self._result = self._function(depsgraph)
        except BaseException as error:  # also KeyboardInterrupt: it belongs to the caller
            self._error = error

    def get(self, scene: bpy.types.Scene) -> Any:
        if self._error is not None:
            raise self._error
        if not self._has_run:
            raise SceneError(f"Blender did not start a render of the scene '{scene.name}'. Is another render running?")
        return self._result


@contextlib.contextmanager
def _registered_engine(outcome: _Outcome) -> Iterator[None]:
    def render(self: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
        outcome.run(depsgraph)

    attributes = {"bl_idname": ENGINE_ID, "bl_label": "VIR evaluation", "bl_use_postprocess": False, "render": render}
    engine = type("VIR_evaluation_engine", (bpy.types.RenderEngine,), attributes)
    bpy.utils.register_class(engine)
    try:
        yield
    finally:
        bpy.utils.unregister_class(engine)


@contextlib.contextmanager
def _quiet_render(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Iterator[None]:
    """The stand-in engine chosen for one view layer, nothing run after it, no handler of renders called."""
    _real_engine_of_scene[scene.session_uid] = scene.render.engine
    try:
        with contextlib.ExitStack() as stack:
            for name in _RENDER_HANDLERS:
                if hasattr(bpy.app.handlers, name):
                    stack.enter_context(_emptied(getattr(bpy.app.handlers, name)))
            for name, value in _QUIET_SETTINGS.items():
                stack.enter_context(_set(scene.render, name, value))
            # The operator's own `layer` argument has no effect in background: it renders all layers in use.
            for layer in scene.view_layers:
                stack.enter_context(_set(layer, "use", layer == view_layer))
            if hasattr(view_layer, "use_grease_pencil"):  # would be drawn on the GPU, after the engine has run
                stack.enter_context(_set(view_layer, "use_grease_pencil", False))
            yield
    finally:
        del _real_engine_of_scene[scene.session_uid]


@contextlib.contextmanager
def _set(owner: Any, name: str, value: Any) -> Iterator[None]:
    kept = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, kept)


@contextlib.contextmanager
def _emptied(handlers: list[Any]) -> Iterator[None]:
    kept = list(handlers)
    handlers.clear()
    try:
        yield
    finally:
        handlers[:] = kept


@contextlib.contextmanager
def _kept_render_result() -> Iterator[None]:
    """Lets the call write its empty result into a render slot of its own, so that the user's renders stay in theirs.

    Blender refuses to remove the slot that was written last, so the slot stays in the list, to be used again. Where its adding is undone
    Blender (5.2.2, also without this extension) does not free the picture in it, and says so when it quits.
    """
    image = _find_render_result()
    if image is None:
        try:
            yield
        finally:
            made = _find_render_result()
            if made is not None:
                bpy.data.images.remove(made)
        return
    slots = image.render_slots
    active_index = slots.active_index
    own = next((index for index, slot in enumerate(slots) if slot.name == _SLOT_NAME), None)
    if own is None:
        slots.new(name=_SLOT_NAME)
        own = len(slots) - 1
    slots.active_index = own
    try:
        yield
    finally:
        slots.active_index = active_index


def _find_render_result() -> bpy.types.Image | None:
    return next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)
