"""Passes of every frame that Blender renders, in time for its compositor.

`frame_change_post` with the depsgraph of a render comes once for each view layer, before the engine, with modifiers and visibility of
renders; what is written into images then reaches the compositor's image nodes. In a window it comes on the render's own thread.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import bpy

from ..core.errors import DeviceError, SceneError, VirError
from ..core.pass_set import PassSet
from ..core.plan import plan, settings_for
from ..core.settings import Effect
from . import devices, frame_state
from .compositor import OTHERS_PASSES, compositor_tree, has_node, has_pass_nodes, shows_others_passes
from .extract import snapshot
from .images import fill_unmade, mark_missing, pack_unsaved, write_images
from .job import LayerJob, rendered_view_layers
from .materials.image_cache import ImageCache
from .properties import settings_of
from .render_depsgraph import is_evaluating
from .stepped_render import SteppedRender

WAIT_S = 0.002
"""between looks at a render on a thread of its own"""


@dataclass
class _Frame:
    is_rendered: bool = False
    """Blender is about it"""
    served: set[tuple[int, str]] = field(default_factory=set)
    """session_uid of a scene, name of a view layer"""
    images: ImageCache = field(default_factory=ImageCache)
    """of all frames of an animation"""


_frame = _Frame()


@bpy.app.handlers.persistent
def forget_images(*_: Any) -> None:
    """Blender's handler, before the first frame and after the last."""
    _frame.images = ImageCache()


@bpy.app.handlers.persistent
def begin_frame(*_: Any) -> None:
    """Blender's handler, before a frame is rendered. What evaluates scenes like a render, exports and baking, does not call it."""
    _frame.is_rendered = True
    _frame.served.clear()


@bpy.app.handlers.persistent
def end_frame(*_: Any) -> None:
    """Blender's handler, after a frame, whether it was rendered or cancelled."""
    _frame.is_rendered = False


@bpy.app.handlers.persistent
def render_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Blender's handler. What goes wrong is printed and shown in the panel, and the images turn magenta: Blender offers no way to stop
    a render from here, and the passes of another frame would pass for right."""
    if not _frame.is_rendered or depsgraph is None or depsgraph.mode != "RENDER" or is_evaluating():
        return
    if not depsgraph.scene_eval.vir.use_on_render:
        return
    layer = (scene.session_uid, depsgraph.view_layer.name)
    if layer in _frame.served:
        return  # motion blur: the engine looks at the shutter's times after the frame itself
    _frame.served.add(layer)
    try:
        render_layer(scene, depsgraph)
    except Exception as error:
        if not isinstance(error, VirError):
            traceback.print_exception(error)
        print(f"VIR: frame {scene.frame_current}, {depsgraph.view_layer.name}: {frame_state.note_problem(scene, error)}")
        with contextlib.suppress(DeviceError):
            _change_images(scene, partial(mark_missing, scene.name_full))


def render_layer(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Fill the images of the depsgraph's view layer. Raises VirError."""
    start = time.perf_counter()
    if shows_others_passes(scene):
        raise SceneError(OTHERS_PASSES)
    layer_name = depsgraph.view_layer.name
    evaluated = depsgraph.scene_eval  # the scene itself does not follow the settings' animation while Blender renders
    device_name = devices.device_name(evaluated.vir.device)
    settings = settings_for(devices.get_device(device_name), settings_of(evaluated))
    _frame.images.forget_changed()  # only now: handlers of frame changes may swap files, reload and paint
    taken = snapshot(depsgraph, with_materials=Effect.REFLECTION in settings.effects, images=_frame.images)
    made = LayerJob(taken, plan(taken, settings))
    step = partial(devices.on_main_thread, SteppedRender.step) if devices.is_bound_to_main_thread(device_name) else SteppedRender.step
    render = SteppedRender({layer_name: made}, device_name)
    try:
        while not step(render):
            time.sleep(WAIT_S if render.is_threaded else 0.0)
    finally:
        if not render.is_done:  # interrupted, or the main thread did not serve it
            devices.ask_main_thread(render.cancel)
    if render.is_cancelled:  # the extension is being disabled, or another file opened
        return
    if render.error is not None:
        raise render.error
    is_first = layer_name == rendered_view_layers(scene)[0].name
    unmade: dict[str, bpy.types.Image] = {}
    _change_images(scene, partial(_write_passes, scene, layer_name, is_first, render.layers[layer_name], unmade))
    frame_state.note_layer(scene, made, render.layers[layer_name], time.perf_counter() - start, is_first=is_first)
    for note in frame_state.note_unmade(scene, layer_name, unmade):
        print(f"VIR: frame {scene.frame_current}, {layer_name}: {note}")


def _write_passes(
    scene: bpy.types.Scene, layer_name: str, is_first: bool, passes: PassSet, unmade: dict[str, bpy.types.Image]
) -> dict[str, bpy.types.Image]:
    """Pass name -> image, of those that were made. unmade: gets what was filled for want of a pass"""
    made = write_images(passes, pack=False, scene_name=scene.name_full, layer_name=None if is_first else layer_name)
    unmade.update(fill_unmade(passes, scene, layer_name, is_first=is_first, pack=False))
    return made


def _change_images(scene: bpy.types.Scene, change: Callable[[], object]) -> None:
    """From whichever thread renders; where Blender goes on drawing meanwhile, between two redraws."""
    if scene.render.use_lock_interface:
        change()
    else:
        devices.on_main_thread(change)


def reasons_against_frames(scene: bpy.types.Scene) -> list[str]:
    """What would keep the passes out of a rendered frame, in words for the panel."""
    reasons = []
    if not bpy.app.background and not scene.render.use_lock_interface:
        reasons.append("Lock the interface: Blender may crash when images change while it draws them")
    tree = compositor_tree(scene)
    if tree is None or not scene.render.use_compositing:
        reasons.append("There is no compositor that would use the passes: they only go into images")
    elif not has_node(tree, "CompositorNodeRLayers"):
        reasons.append("The compositor has no Render Layers node, so Blender renders nothing, and the passes are left as they are")
    elif shows_others_passes(scene):
        reasons.append(OTHERS_PASSES)
    elif not has_pass_nodes(scene):
        reasons.append("The compositor does not have the passes yet: press Render Passes, then Add to Compositor")
    return reasons


def _handlers() -> tuple[tuple[list[Any], Callable[..., None]], ...]:
    on = bpy.app.handlers
    return (
        (on.save_pre, pack_unsaved),
        (on.render_pre, begin_frame),
        (on.frame_change_post, render_frame),
        *((handlers, end_frame) for handlers in (on.render_post, on.render_cancel, on.render_complete)),
        *((handlers, forget_images) for handlers in (on.render_init, on.render_cancel, on.render_complete)),
    )


def register() -> None:
    for handlers, function in _handlers():
        handlers.append(function)


def unregister() -> None:
    for handlers, function in reversed(_handlers()):
        handlers.remove(function)
    end_frame()
    forget_images()
