"""The buttons. Each only delegates; long work runs in steps while Blender goes on answering."""

from __future__ import annotations

import time
import traceback
from typing import Any

import bpy

from ..core.errors import SceneError, UsageError, VirError
from ..core.plan import check_device, settings_for
from . import devices, frame_state, report_file
from .compositor import OTHERS_PASSES, add_pass_nodes, has_pass_nodes, shows_others_passes
from .frame_state import state_of
from .images import fill_unmade, layer_images, scene_images
from .job import LayerJob, frame_jobs
from .properties import settings_of
from .render_depsgraph import is_evaluating
from .stepped_render import SteppedRender

TICK_S = 0.05
"""between looks at a render that runs on a thread, or its batches on Blender's own"""


def plan_frame(scene: bpy.types.Scene) -> dict[str, LayerJob]:
    """Read the scene at its current frame and plan it; what is found stands in the panel. Raises VirError."""
    if scene.camera is None:
        raise SceneError(f"the scene {scene.name!r} has no camera; add one, or make one the active camera")
    device = devices.get_device(devices.device_name(scene.vir.device))
    jobs = frame_jobs(scene, None, settings_for(device, settings_of(scene)))
    frame_state.note_plan(scene, jobs)
    for job in jobs.values():
        check_device(job.plan, device)
    return jobs


def finish_render(scene: bpy.types.Scene, render: SteppedRender, seconds: float, *, pack: bool = True) -> dict[str, bpy.types.Image]:
    """Hand the passes over: images, the compositor's group where the scene has one, figures for the panel."""
    images = layer_images(render.layers, scene.name_full, pack=pack)
    is_others = shows_others_passes(scene)
    if has_pass_nodes(scene) and not is_others:
        add_pass_nodes(scene, images)
    frame_state.note_render(scene, render.jobs, render.layers, seconds)
    for index, (layer_name, passes) in enumerate(render.layers.items()):
        unmade = fill_unmade(passes, scene, layer_name, is_first=index == 0, pack=pack)
        frame_state.note_unmade(scene, layer_name, unmade)
    if is_others:
        frame_state.add_note(scene, next(iter(render.layers)), OTHERS_PASSES)
    return images


def reason_against_rendering(context: bpy.types.Context) -> str | None:
    """Why the scene cannot be rendered now, in words for a greyed-out button."""
    scene = context.scene
    if state_of(scene).running is not None:
        return "The passes are being rendered"
    if is_evaluating() or bpy.app.is_job_running("RENDER"):
        return "Blender is rendering"
    if scene.camera is None:
        return "The scene has no camera: add one, or make one the active camera"
    has_light = any(item.type == "LIGHT" or item.instance_collection is not None for item in scene.objects)
    if not has_light and not scene.vir.use_reflections:
        return "The scene has no light"
    return None


def mendable_by(scene: bpy.types.Scene) -> tuple[object, ...]:
    """What plans and renders were refused for, as far as it is cheap to look at: once any of it is another, so may be their answer."""
    camera, render = scene.camera, scene.render
    seen_by = () if camera is None else (camera.session_uid, camera.type, *(tuple(row) for row in camera.matrix_world))
    if camera is not None and camera.type == "CAMERA":
        lens = camera.data
        seen_by += (lens.session_uid, lens.type, lens.lens, lens.sensor_width, lens.sensor_height, lens.ortho_scale)
    border = (render.border_min_x, render.border_min_y, render.border_max_x, render.border_max_y) if render.use_border else ()
    size = render.resolution_x, render.resolution_y, render.resolution_percentage, render.use_crop_to_border
    objects = tuple((item.session_uid, item.hide_render) for item in scene.objects)
    try:
        settings: object = settings_of(scene)
    except UsageError as error:
        settings = str(error)
    return seen_by, size, border, objects, scene.vir.device, settings


def redraw_panels(context: bpy.types.Context) -> None:
    """Not the 3D view itself, which may take long."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in (("VIEW_3D", "UI"), ("PROPERTIES", "WINDOW")):
                    region.tag_redraw()


def redraw_images(context: bpy.types.Context) -> None:
    """Wherever passes may be seen, and the panels."""
    redraw_panels(context)
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("IMAGE_EDITOR", "NODE_EDITOR"):
                area.tag_redraw()


class _Reporting:
    """Errors as Blender shows them: the text of those that a user can mend, the traceback of others in the console."""

    def tell(self: Any, scene: bpy.types.Scene, error: BaseException) -> set[str]:
        if not isinstance(error, VirError):
            traceback.print_exception(error)
        self.report({"ERROR"}, f"VIR: {frame_state.note_problem(scene, error, mendable_by(scene))}")
        return {"CANCELLED"}


class VIR_OT_plan(_Reporting, bpy.types.Operator):
    """Look at the scene and say what would be rendered and why, without rendering it"""

    bl_idname = "vir.plan"
    bl_label = "Plan"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll(cls, reason_against_rendering(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            plan_frame(context.scene)
        except Exception as error:
            return self.tell(context.scene, error)
        redraw_images(context)
        return {"FINISHED"}


_modal: list[VIR_OT_render] = []
"""those that run in a window"""


def end_modal() -> None:
    """Before the extension is disabled: Blender drops running operators of its classes without a word to them."""
    for operator in list(_modal):
        operator.cancel(bpy.context)


class VIR_OT_render(_Reporting, bpy.types.Operator):
    """Render the passes of the current frame into images. Esc cancels and keeps what was there before"""

    bl_idname = "vir.render"
    bl_label = "Render Passes"
    bl_options = {"UNDO"}

    _scene_uid: int
    _scene_name: str
    _render: SteppedRender
    _timer: Any
    _start: float
    _shown: str

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll(cls, reason_against_rendering(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window, and for scripts: return when the passes are there."""
        scene = context.scene
        try:
            self._begin(scene)
            while not self._render.step():
                time.sleep(TICK_S if self._render.is_threaded else 0.0)
            if self._render.error is not None:
                raise self._render.error
            finish_render(scene, self._render, time.perf_counter() - self._start)
        except Exception as error:
            return self.tell(scene, error)
        finally:
            running = state_of(scene).running
            if running is not None and not running.is_done:  # interrupted
                running.cancel()
            state_of(scene).running = None
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._begin(context.scene)
        except Exception as error:
            return self.tell(context.scene, error)
        _modal.append(self)
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.progress_begin(0.0, 1.0)
        context.window_manager.modal_handler_add(self)
        self._show(context)
        return {"RUNNING_MODAL"}

    def _begin(self, scene: bpy.types.Scene) -> None:
        self._start, self._shown = time.perf_counter(), ""
        self._scene_uid, self._scene_name = scene.session_uid, scene.name
        jobs = plan_frame(scene)
        self._render = SteppedRender(jobs, devices.device_name(scene.vir.device))
        state_of(scene).running = self._render

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self._render.cancel()
        if self._render.is_cancelled:
            self._end(context)
            self.report({"INFO"}, "VIR: cancelled; the passes are those of before")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not self._render.step():
            self._show(context)
            return {"PASS_THROUGH"}
        scene = self._scene()
        self._end(context)
        if scene is None:
            self.report({"WARNING"}, f"VIR: the scene {self._scene_name!r} is gone, and its passes with it")
            return {"CANCELLED"}
        try:
            if self._render.error is not None:
                raise self._render.error
            finish_render(scene, self._render, time.perf_counter() - self._start)
        except Exception as error:
            return self.tell(scene, error)
        seconds = frame_state.seconds_text(time.perf_counter() - self._start)
        self.report({"INFO"}, f"VIR: {len(scene_images(scene.name_full))} passes in {seconds}")
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender when it ends the operator itself: another file, a closed window."""
        self._render.cancel()
        self._end(context)

    def _scene(self) -> bpy.types.Scene | None:
        return next((scene for scene in bpy.data.scenes if scene.session_uid == self._scene_uid), None)

    def _show(self, context: bpy.types.Context) -> None:
        state = self._render.state
        context.window_manager.progress_update(state.share_done)
        text = status_text(self._render)
        if text != self._shown:
            self._shown = text
            context.workspace.status_text_set(text)
            redraw_panels(context)

    def _end(self, context: bpy.types.Context) -> None:
        _modal.remove(self)
        frame_state.forget_running(self._render)
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw_images(context)


def status_text(render: SteppedRender) -> str:
    """'VIR 37 %: 24 of 64 views, Key: resolve, about 3 s left, error 0.012 | Esc: cancel'"""
    state = render.state
    parts = [f"{state.views_done} of {state.views_total} views"]
    parts.append(f"{state.light_name}: {state.stage}" if state.light_name else state.stage)
    if state.seconds_left is not None:
        parts.append(f"about {frame_state.seconds_text(state.seconds_left)} left")
    if state.error_estimate is not None:
        parts.append(f"error {frame_state.error_text(state.error_estimate)}")
    return f"VIR {state.share_done:.0%}: {', '.join(parts)} | Esc: cancel"


class VIR_OT_cancel(bpy.types.Operator):
    """Stop rendering the passes. The images keep what was in them before"""

    bl_idname = "vir.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll(cls, None if state_of(context.scene).running else "No passes are being rendered")

    def execute(self, context: bpy.types.Context) -> set[str]:
        running = state_of(context.scene).running
        if running is not None:
            running.cancel()
        return {"FINISHED"}


class VIR_OT_add_to_compositor(_Reporting, bpy.types.Operator):
    """Add a node with every pass as an output to the scene's compositor. Your own nodes and links stay as they are"""

    bl_idname = "vir.add_to_compositor"
    bl_label = "Add to Compositor"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll(cls, None if scene_images(context.scene.name_full) else "There are no passes yet: press Render Passes first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            made = add_pass_nodes(context.scene, scene_images(context.scene.name_full))
        except VirError as error:
            return self.tell(context.scene, error)
        if made.is_switched_off:
            self.report({"WARNING"}, "VIR: the node is there, but Use Nodes is off in the compositor")
        else:
            self.report({"INFO"}, f"VIR: {len(made.added)} outputs added to the node {made.node.label!r}")
        redraw_images(context)
        return {"FINISHED"}


class VIR_OT_open_report(_Reporting, bpy.types.Operator):
    """Show how the passes were made in the web browser: times, methods, errors, what was left out and why"""

    bl_idname = "vir.open_report"
    bl_label = "Open Report"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll(cls, None if state_of(context.scene).statistics else "Nothing was rendered since the file was opened")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            path = report_file.write_report(context.scene)
        except VirError as error:
            return self.tell(context.scene, error)
        if not bpy.app.background:
            bpy.ops.wm.url_open(url=path.as_uri())
        self.report({"INFO"}, f"VIR: {path}")
        return {"FINISHED"}


def _poll(operator: Any, reason: str | None) -> bool:
    if reason is not None:
        operator.poll_message_set(reason)
    return reason is None


CLASSES = (VIR_OT_plan, VIR_OT_render, VIR_OT_cancel, VIR_OT_add_to_compositor, VIR_OT_open_report)
