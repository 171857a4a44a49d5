"""All previews of all windows: Blender tells of redraws and changes, a timer gives each viewport its slices of time.

Whether there is a preview follows from the scene's switch alone, which is looked at whenever Blender draws a viewport; so it does not
matter who turns it, a button, undoing or opening a file. What lives here goes when the last viewport with a preview has gone.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...core.errors import SceneError, UsageError, VirError
from ...core.picture import Choice
from ...core.picture import Shown as ShownPasses
from ...core.settings import Settings
from ...device.failure import as_told
from .. import devices
from ..extract.mesh_cache import MeshCache, changes_only_lights
from ..extract.viewport_view import ViewportView, viewport_view
from ..frame_state import is_rendering
from ..object_names import named_object
from ..properties import settings_of
from ..render_depsgraph import is_evaluating
from .overlay import Display, Overlay, draw_text
from .viewport import ViewportPreview, is_same_view

WAIT_S = 0.01
"""for what happens on another thread"""
SOFTWARE_BUDGET_S = 0.3
IDLE_S = 0.5
"""between looks whether the viewports are still there"""

REDRAW_PAUSE = 3.0
"""times as long as a redraw took, until the next one is asked for"""
LONGEST_REDRAW_S = 0.3
"""Blender may have done something else meanwhile"""

HIDDEN_PAUSE = 10.0
"""times as long as asking what a viewport hides took, until it is asked again while somebody navigates"""

READING, PREPARING = "VIR: reading", "VIR: preparing"

LayerKey = tuple[int, str]
"""session_uid of a scene, name of a view layer"""


@dataclass
class _Hidden:
    """What a viewport was found to hide."""

    uids: frozenset[int]
    local: tuple[bool, bool]
    """local view, local collections"""
    view_matrix: np.ndarray
    """of the last redraw"""
    end_s: float


@dataclass
class Shown:
    """A viewport with a preview."""

    layer: LayerKey
    view: ViewportView
    preview: ViewportPreview | None = None
    """made when it is first given time"""
    problem: str = ""
    """in words for the viewport"""
    is_stuck: bool = False
    """until something changes"""
    stuck_settings: Settings | None = None
    is_outdated: bool = False
    """there is something that was not drawn yet"""
    said: str = ""
    """what stands in the viewport, or will with the redraw that was asked for"""
    hidden: _Hidden | None = None

    @property
    def is_reading(self) -> bool:
        """What is drawn is of an earlier state of the scene."""
        return self.preview is None or self.preview.must_read or self.preview.is_reading

    @property
    def is_busy(self) -> bool:
        return not self.is_stuck and (self.preview is None or not self.preview.is_done)

    @property
    def is_waiting(self) -> bool:
        return self.preview is not None and self.preview.is_waiting


@dataclass
class _Running:
    caches: dict[LayerKey, MeshCache] = field(default_factory=dict)
    viewports: dict[int, Shown] = field(default_factory=dict)
    """address of a region -> what it shows"""
    overlay: Overlay | None = None
    executor: ThreadPoolExecutor | None = None
    turn: int = 0
    """of the viewports, one is served a tick"""
    told: str = ""
    """what went wrong last in a viewport that shows nothing yet"""
    redraw_s: float = 0.0
    """that Blender took until it came again, after a redraw had been asked for"""
    asked_s: float = 0.0
    """when the last one was, as `time.perf_counter` counts"""
    tick_end_s: float = 0.0
    is_redraw_timed: bool = False
    """a redraw was asked for in the last tick, and the next one was to come right after it"""
    is_in_tick: bool = False
    is_woken: bool = False


_running = _Running()
_draw_handles: list[Any] = []


def register() -> None:
    # in background no viewport is ever drawn
    if not bpy.app.background:
        _draw_handles.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    stop()
    while _draw_handles:
        bpy.types.SpaceView3D.draw_handler_remove(_draw_handles.pop(), "WINDOW")


def stop() -> None:
    """End all previews and free what they hold, on the device and of Blender's."""
    for address in list(_running.viewports):
        _forget(address)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for handlers, function in _HANDLERS:
        if function in handlers:
            handlers.remove(function)
    if _running.executor is not None:
        _running.executor.shutdown(wait=False, cancel_futures=True)
    _running.executor = _running.overlay = None
    _running.redraw_s = _running.asked_s = 0.0
    _running.is_redraw_timed = False


def _start() -> None:
    """Once there is a viewport with a preview."""
    if _running.executor is None:
        _running.executor = ThreadPoolExecutor(1, thread_name_prefix="vir-preview")
    for handlers, function in _HANDLERS:
        if function not in handlers:
            handlers.append(function)


def _wake() -> None:
    """Have the timer come at once."""
    if _running.is_in_tick:
        _running.is_woken = True
        return
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    bpy.app.timers.register(_tick, first_interval=0.0, persistent=True)


def _forget(address: int) -> None:
    shown = _running.viewports.pop(address, None)
    if shown is not None:
        _close(shown)
    used = {each.layer for each in _running.viewports.values()}
    _running.caches = {layer: cache for layer, cache in _running.caches.items() if layer in used}


def _close(shown: Shown) -> None:
    """Its preview. A device that was lost may not even release."""
    preview, shown.preview = shown.preview, None
    if preview is not None:
        try:
            preview.close()
        except Exception as error:
            traceback.print_exception(error)


# drawing


def _draw() -> None:
    """In every viewport after Blender's own drawing."""
    context = bpy.context
    try:
        _draw_region(context)
    except Exception as error:
        shown = _running.viewports.get(context.region.as_pointer())
        if shown is None:
            _running.told = _problem_text(error, _running.told)
            return
        before = shown.problem
        _give_up(shown, error)
        if shown.problem != before:
            context.region.tag_redraw()  # so that it is seen


def _draw_region(context: bpy.types.Context) -> None:
    scene, region, space = context.scene, context.region, context.space_data
    address = region.as_pointer()
    if not (scene.vir.use_preview and space.overlay.show_overlays):
        if address in _running.viewports:
            _forget(address)
            _wake()
        return
    view = _view_of(region, space, context.region_data, _hidden_uids(address, space, context.region_data, context.view_layer))
    if view is None:
        return
    shown = _look(address, (scene.session_uid, context.view_layer.name), view)
    preview = shown.preview
    if preview is not None:
        choice = _choice_of(scene)
        if choice != preview.render.choice:
            preview.render.choice, shown.is_stuck = choice, False
        if shown.is_busy:
            _wake()
        display = _display_of(scene)
        preview.compare(display is Display.DIFFERENCE)
    if preview is not None and preview.picture is not None and not shown.problem:
        if _running.overlay is None:
            _running.overlay = Overlay()
        _running.overlay.draw(preview.picture, display, preview.reference)
    shown.said = status_text(shown)
    draw_text(context, shown.said)


def _choice_of(scene: bpy.types.Scene) -> Choice:
    light = named_object(scene.vir, "preview_light")  # None where it was deleted
    return Choice(ShownPasses[scene.vir.preview_pass], None if light is None else light.name)


def _display_of(scene: bpy.types.Scene) -> Display:
    return Display[scene.vir.preview_display]


def _hidden_uids(address: int, space: Any, region_3d: Any, view_layer: Any) -> frozenset[int]:
    """session_uid of what local view or collections hide. While somebody navigates only now and then: it asks every object."""
    local = space.local_view is not None, space.use_local_collections
    if not any(local):
        return frozenset()
    shown, view_matrix = _running.viewports.get(address), np.array(region_3d.view_matrix)
    known, start_s = None if shown is None else shown.hidden, time.perf_counter()
    if known is not None and known.local == local and start_s < known.end_s and not np.array_equal(known.view_matrix, view_matrix):
        known.view_matrix = view_matrix
        return known.uids
    uids = frozenset(one.session_uid for one in view_layer.objects if not one.visible_in_viewport_get(space))
    if shown is not None:
        now_s = time.perf_counter()
        shown.hidden = _Hidden(uids, local, view_matrix, now_s + HIDDEN_PAUSE * (now_s - start_s))
    return uids


def _view_of(region: Any, space: Any, region_3d: Any, hidden_uids: frozenset[int]) -> ViewportView | None:
    matrices = np.array(region_3d.view_matrix), np.array(region_3d.window_matrix)
    return viewport_view(*matrices, region.width, region.height, hidden_uids)


def _look(address: int, layer: LayerKey, view: ViewportView) -> Shown:
    shown = _running.viewports.get(address)
    if shown is None or shown.layer != layer:
        _forget(address)
        _start()
        shown = _running.viewports[address] = Shown(layer, view)
        _wake()
    elif not is_same_view(view, shown.view):
        shown.view, shown.is_stuck = view, False
    if shown.preview is not None:
        shown.preview.look(shown.view)
    return shown


def status_text(shown: Shown) -> str:
    """What a viewport says of its preview."""
    if shown.problem:
        return f"VIR: {shown.problem}"
    if shown.preview is None or shown.is_reading:
        is_old = shown.preview is not None and shown.preview.picture is not None
        what = (shown.preview.cache.large_name if shown.preview is not None else "") or "the scene"
        return f"{READING} {what}{', the picture is of before' if is_old else ''}"
    standing = shown.preview.render.standing
    if not standing.views_total:
        if shown.preview.is_done:
            return f"VIR: {_why_no_views(shown.preview)}"
        count = shown.preview.render.compiled_count
        return f"{PREPARING}, {count} shader{'s' * (count != 1)} compiled" if count else PREPARING
    if shown.preview.is_done and shown.preview.picture is None:
        return f"VIR: {_why_empty(shown.preview)}"
    error = f"error {standing.error_estimate:.3f}" if standing.error_estimate < 1 else "error unknown"
    size = shown.preview.level.pixel_size
    coarse = f", 1/{size} resolution" if size > 1 else ""
    return f"VIR: {standing.views_done} of {standing.views_total} views, {error}, {standing.busy_ms:.0f} ms{coarse}"


def _is_figureless(said: str) -> bool:
    return said.startswith((READING, PREPARING))


def _why_no_views(preview: ViewportPreview) -> str:
    snapshot = preview.render.snapshot
    if snapshot is None or len(snapshot.instances):
        return "no light has a pass to show"
    left_out = next((f"; {item.text}" for item in snapshot.left_out if not item.is_light), "")
    return f"no surface that is rendered{left_out}"


def _why_empty(preview: ViewportPreview) -> str:
    choice, render_plan = preview.render.choice, preview.render.plan
    without_light = "this light has no pass to show" if choice.light_name else "no light has a pass to show"
    if not choice.shown.has_shadows:
        return "nothing reflects"
    has_reflections = choice.shown.has_reflections and render_plan is not None and render_plan.reflections is not None
    return f"{without_light}, and nothing reflects" if has_reflections else without_light


# time


def _tick() -> float | None:
    """A slice for one viewport that has something to do. When to come again, None: never."""
    if _running.is_redraw_timed:
        _running.redraw_s = min(time.perf_counter() - _running.tick_end_s, LONGEST_REDRAW_S)
    _running.is_in_tick, _running.is_woken, _running.is_redraw_timed = True, False, False
    start_s = time.perf_counter()
    try:
        interval_s = _serve_next()
    finally:
        _running.is_in_tick, _running.tick_end_s = False, time.perf_counter()
    if not _running.viewports:
        stop()
        return None
    interval_s = 0.0 if _running.is_woken else interval_s
    _running.is_redraw_timed = _running.asked_s >= start_s and interval_s < IDLE_S
    return interval_s


def _serve_next() -> float:
    regions = _viewport_regions()
    for address in [address for address in _running.viewports if address not in regions]:
        _forget(address)
    if bpy.app.is_job_running("RENDER") or is_evaluating() or is_rendering():
        return IDLE_S
    addresses = list(_running.viewports)
    busy = [address for address in addresses if _running.viewports[address].is_busy]
    # the others are looked at as well, now and then: settings may have changed
    served = busy[_running.turn % len(busy) :][:1] if busy else addresses
    _running.turn += 1
    for address in served:
        if address in _running.viewports:
            _serve(address, _running.viewports[address], regions[address])
    _ask_for_redraws(regions)
    left = [shown for shown in _running.viewports.values() if shown.is_busy]
    if not left:
        return IDLE_S
    return WAIT_S if all(shown.is_waiting for shown in left) else 0.0


def _serve(address: int, shown: Shown, region: bpy.types.Region) -> None:
    scene, view_layer = _find_layer(shown.layer)
    if scene is None or view_layer is None or not scene.vir.use_preview:
        _forget(address)
        region.tag_redraw()
        return
    before = shown.problem
    try:
        has_changed = _advance(shown, scene, view_layer)
        shown.problem = "" if not shown.is_stuck else before
    except Exception as error:
        has_changed = False
        _give_up(shown, error)
    shown.is_outdated |= has_changed or shown.problem != before
    said, shown.said = shown.said, status_text(shown)
    # figures change with every slice, and are drawn with the picture that they belong to
    shown.is_outdated |= shown.said != said and (_is_figureless(said) or _is_figureless(shown.said))


def _ask_for_redraws(regions: dict[int, bpy.types.Region]) -> None:
    # where drawing takes long, most of the time would go into pictures that differ little
    is_due = time.perf_counter() - _running.asked_s > REDRAW_PAUSE * _running.redraw_s
    for address, shown in _running.viewports.items():
        if shown.is_outdated and (is_due or not shown.is_busy):
            regions[address].tag_redraw()
            shown.is_outdated, _running.asked_s = False, time.perf_counter()


def _give_up(shown: Shown, error: Exception) -> None:
    """Until something changes."""
    shown.problem = _problem_text(as_told(error), shown.problem)
    shown.is_stuck = True
    if shown.preview is None or isinstance(error, UsageError | SceneError) or shown.preview.must_read:
        return
    # not in reading: the device may be lost, and stays so
    devices.drop_device(shown.preview.render.device)
    _close(shown)


def _problem_text(error: BaseException, told: str) -> str:
    """In words for the viewport. What nobody expected is printed too, unless it has been told before: it comes with every redraw."""
    if isinstance(error, VirError):
        return str(error)
    text = f"internal error, see the console: {type(error).__name__}: {error}"
    if text != told:
        traceback.print_exception(error)
    return text


def unavailable() -> str:
    """Why there cannot be a preview, in words for the artist; empty if there can."""
    return "The preview needs Blender 5.2" if bpy.app.version < (5, 2, 0) else ""


def _advance(shown: Shown, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bool:
    if reason := unavailable():  # a file of a newer Blender may have it switched on
        raise UsageError(reason)
    settings = settings_of(scene)
    if shown.is_stuck and settings == shown.stuck_settings:
        return False
    shown.stuck_settings = settings
    device = devices.get_device("gpu")
    if shown.preview is None:
        assert _running.executor is not None
        cache = _running.caches.setdefault(shown.layer, MeshCache())
        shown.preview = ViewportPreview(device, _running.executor, cache)
        shown.preview.look(shown.view)
    shown.preview.render.choice = _choice_of(scene)
    depsgraph = view_layer.depsgraph
    if depsgraph is None:
        return False
    if shown.preview.must_read or shown.preview.is_reading:
        # a script may have removed what the graph still shows; what this finds has been noted when it returns
        depsgraph.update()
    shown.is_stuck, shown.stuck_settings = False, settings
    has_changed = shown.preview.advance(depsgraph, settings, budget_s(scene, shown.preview))
    # not only when it is drawn: something may change before
    shown.preview.compare(_display_of(scene) is Display.DIFFERENCE)
    return has_changed


def budget_s(scene: bpy.types.Scene, preview: ViewportPreview) -> float:
    """What the artist has set, otherwise what suits the device."""
    if scene.vir.is_property_set("preview_slice_ms"):
        return float(scene.vir.preview_slice_ms) * 1e-3
    return SOFTWARE_BUDGET_S if preview.render.device.is_software else scene.vir.preview_slice_ms * 1e-3


def _viewport_regions() -> dict[int, bpy.types.Region]:
    """Address -> region, of all viewports there are now. Addresses of those that have gone must not be looked at."""
    windows = bpy.context.window_manager.windows
    areas = (area for window in windows for area in window.screen.areas if area.type == "VIEW_3D")
    return {region.as_pointer(): region for area in areas for region in area.regions if region.type == "WINDOW"}


def _find_layer(layer: LayerKey) -> tuple[bpy.types.Scene | None, bpy.types.ViewLayer | None]:
    scene = next((scene for scene in bpy.data.scenes if scene.session_uid == layer[0]), None)
    return scene, None if scene is None else scene.view_layers.get(layer[1])


# changes


def _note_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """After the evaluation of any scene's view layer. Renders evaluate their own, on their own thread."""
    if depsgraph is None or depsgraph.mode != "VIEWPORT":
        return
    layer = (scene.session_uid, depsgraph.view_layer.name)
    if layer in _running.caches:
        _running.caches[layer].note_updates(depsgraph)
    _note_change({layer}, only_lights=changes_only_lights(depsgraph))


def _note_change(layers: set[LayerKey], *, only_lights: bool = False) -> None:
    changed = [shown for shown in _running.viewports.values() if shown.layer in layers]
    for shown in changed:
        shown.is_stuck, shown.stuck_settings, shown.hidden = False, None, None
        if shown.preview is not None:
            shown.preview.note_change(only_lights=only_lights)
    if changed:
        _wake()


def _note_undo(*_: Any) -> None:
    """Everything in the file has been replaced."""
    for cache in _running.caches.values():
        cache.forget()
    _note_change({shown.layer for shown in _running.viewports.values()})


def _note_load(*_: Any) -> None:
    # the rest of `stop` is left to the timer: Blender is walking the list of handlers
    for address in list(_running.viewports):
        _forget(address)
    _wake()


for _function in (_note_update, _note_undo, _note_load):
    bpy.app.handlers.persistent(_function)

_HANDLERS: tuple[tuple[list[Any], Callable[..., None]], ...] = (
    (bpy.app.handlers.depsgraph_update_post, _note_update),
    (bpy.app.handlers.frame_change_post, _note_update),
    (bpy.app.handlers.undo_post, _note_undo),
    (bpy.app.handlers.redo_post, _note_undo),
    (bpy.app.handlers.load_pre, _note_load),
)
