"""What is known of a scene's passes while Blender runs: the plan's lines, what the last render took and reached, what went wrong.

Nothing of it belongs into a file; it goes when another one is opened. Reading it is cheap: panels do so at every redraw.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import bpy

from ..core.errors import VirError
from ..core.forecast import Forecast, make_forecast, predict_error
from ..core.light_plan import PlannedPass
from ..core.pass_set import REFLECTION_PASS_NAME, PassSet, PassStatistics, SetStatistics
from .images import is_used
from .job import LayerJob
from .stepped_render import SteppedRender, stop_all


@dataclass
class SceneState:
    plans: dict[str, dict[str, PlannedPass]] = field(default_factory=dict)
    """view layer name -> light name -> what the plan decided"""
    reflectors: dict[str, tuple[bool, str]] = field(default_factory=dict)
    """object name -> whether it is drawn, in any view layer, and how or why not"""
    names: dict[int, str] = field(default_factory=dict)
    """session_uid of the scene's own objects in these and in `statistics` -> their names there; they may have been renamed since"""
    known_names: set[str] = field(default_factory=set)
    """the values of `names`"""
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    """one sentence an object"""
    forecasts: dict[str, Forecast] = field(default_factory=dict)
    """view layer name -> its picture's"""
    statistics: dict[str, SetStatistics] = field(default_factory=dict)
    """view layer name -> how the passes were made that are in the images now"""
    frame: int = 0
    problem: str = ""
    """what the user has to mend, in words; empty after a render that went well"""
    problem_while: object = None
    """what the user can mend it by, as it was then; None: it stays until there is a plan or a render"""
    running: SteppedRender | None = None

    def name_of(self, item: bpy.types.Object) -> str:
        """Under which one of the scene's objects is known here; empty where one that is called otherwise now has its name here."""
        name = self.names.get(item.session_uid)
        if name is not None:
            return name
        return "" if item.name in self.known_names else item.name

    def forget_plan(self, scene: bpy.types.Scene) -> None:
        """What a new plan replaces. What the last render took stays, under today's names and without lights that are gone."""
        now = {name: item.name for item in scene.objects if (name := self.names.get(item.session_uid)) is not None}
        for layer_name, layer in self.statistics.items():
            passes = [
                replace(one, light_name=now.get(one.light_name, one.light_name))
                for one in layer.passes
                if one.light_name in now or one.light_name not in self.known_names
            ]
            self.statistics[layer_name] = replace(layer, passes=passes)
        self.plans, self.reflectors, self.notes, self.left_out = {}, {}, (), ()
        self.names, self.known_names = {}, set()

    def planned(self, light_name: str) -> PlannedPass | None:
        """By the first view layer that knows the light and renders it, or else says why not."""
        lines = [lines[light_name] for lines in self.plans.values() if light_name in lines]
        return next((line for line in lines if line.runs), lines[0] if lines else None)

    def made(self, light_name: str) -> PassStatistics | None:
        made = [one for layer in self.statistics.values() for one in layer.passes if one.light_name == light_name and one.view_count]
        return made[0] if made else None


_states: dict[int, SceneState] = {}
"""session_uid of a scene -> its state"""
LEAST_TELLING_S = 1.0
"""of a render: shorter ones go by for the most part with what any render begins with, and tell nothing of long ones"""
_time_factors: dict[str, float] = {}
"""device name -> what its last render took over what the plan had predicted"""


def state_of(scene: bpy.types.Scene) -> SceneState:
    return _states.setdefault(scene.session_uid, SceneState())


def is_rendering() -> bool:
    """Whether passes of any scene are."""
    return any(state.running is not None for state in _states.values())


def forget_running(render: SteppedRender) -> None:
    """The render has ended, or nobody waits for it any more; its scene may be gone."""
    for state in _states.values():
        if state.running is render:
            state.running = None


def forget_all() -> None:
    """Stop what runs and forget all scenes."""
    for state in _states.values():
        if state.running is not None:
            state.running.cancel()
    stop_all()
    _states.clear()


def note_plan(scene: bpy.types.Scene, jobs: Mapping[str, LayerJob]) -> None:
    """Of all view layers."""
    state = state_of(scene)
    state.problem = ""
    state.forget_plan(scene)
    state.forecasts = {}
    for name, job in jobs.items():
        _add_plan(state, scene, name, job)
        state.forecasts[name] = make_forecast(job.snapshot, job.plan)


def _add_plan(state: SceneState, scene: bpy.types.Scene, layer_name: str, job: LayerJob) -> None:
    state.plans[layer_name] = {planned.light_name: planned for planned in job.plan.passes}
    if job.plan.reflections is not None:
        for reflector in job.plan.reflections.lines:
            how = f"{reflector.method_text}: {reflector.reason}" if reflector.runs and reflector.method_text else reflector.reason
            # instances of one object share its name, in several view layers as well: what is told is how they are drawn where any is
            runs, _ = state.reflectors.get(reflector.name, (None, ""))
            if reflector.maps or runs is None or reflector.runs > runs:
                state.reflectors[reflector.name] = (reflector.runs, how)
    made = (one.light_name for layer in state.statistics.values() for one in layer.passes)
    objects = {item.name: item for item in reversed(scene.objects.values())}  # of linked ones of one name the first
    own = {*state.plans[layer_name], *state.reflectors, *made} & objects.keys()
    state.names |= {objects[name].session_uid: name for name in own}
    state.known_names |= own
    state.notes = tuple(dict.fromkeys((*state.notes, *job.plan.notes)))
    state.left_out = tuple(sorted({*state.left_out, *(item.text for item in job.snapshot.left_out)}))


def note_render(scene: bpy.types.Scene, jobs: Mapping[str, LayerJob], layers: Mapping[str, PassSet], render_s: float) -> None:
    """Of all view layers, after `note_plan`."""
    state = state_of(scene)
    state.problem = ""
    state.statistics = {name: passes.statistics for name, passes in layers.items()}
    state.frame = next(iter(jobs.values())).snapshot.frame
    _note_time(jobs, layers, render_s)


def note_layer(scene: bpy.types.Scene, job: LayerJob, passes: PassSet, render_s: float, *, is_first: bool) -> None:
    """Of one view layer of a frame that Blender renders; the first one of a frame replaces what was known of the last."""
    state, layer_name = state_of(scene), job.snapshot.view_layer_name
    if is_first:
        state.problem = ""
        state.statistics = {}
        state.forget_plan(scene)
    _add_plan(state, scene, layer_name, job)
    state.statistics[layer_name] = passes.statistics
    state.frame = job.snapshot.frame
    _note_time({layer_name: job}, {layer_name: passes}, render_s)


def note_unmade(scene: bpy.types.Scene, layer_name: str, filled: Mapping[str, bpy.types.Image]) -> list[str]:
    """After `note_render` or `note_layer`. filled: of `images.fill_unmade`. Tells, and returns, of those that anything in the file uses."""
    notes = [
        f"{name} is not rendered in this frame: the pass is {'black' if name.startswith(REFLECTION_PASS_NAME) else 'white'}"
        for name, image in filled.items()
        if is_used(image)
    ]
    for note in notes:
        add_note(scene, layer_name, note)
    return notes


def add_note(scene: bpy.types.Scene, layer_name: str, note: str) -> None:
    """Beside those of the last plan, and to what the report says of the layer's render."""
    state = state_of(scene)
    state.notes = tuple(dict.fromkeys((*state.notes, note)))
    state.statistics[layer_name].notes.append(note)


def _note_time(jobs: Mapping[str, LayerJob], layers: Mapping[str, PassSet], render_s: float) -> None:
    predicted_ms = sum(job.plan.predicted_ms for job in jobs.values())
    # where nothing is rendered next to nothing is predicted, and what took the time says nothing of other renders
    if predicted_ms > 0 and any(_has_work(passes.statistics) for passes in layers.values()):
        device = next(iter(layers.values())).statistics.device.partition(":")[0]
        before = _time_factors.pop(device, None)  # the last one in the table is the last one used
        factor = render_s * 1e3 / predicted_ms if render_s >= LEAST_TELLING_S else before
        if factor is not None:
            _time_factors[device] = factor


def _has_work(statistics: SetStatistics) -> bool:
    has_rays = statistics.reflections is not None and statistics.reflections.ray_count > 0
    return has_rays or any(one.view_count for one in statistics.passes)


def note_problem(scene: bpy.types.Scene, error: BaseException, problem_while: object = None) -> str:
    """Remember and return what to tell the user. problem_while: as of `SceneState`, for errors that a user can mend"""
    is_mendable = isinstance(error, VirError)
    text = str(error) if is_mendable else f"internal error, see the console: {type(error).__name__}: {error}"
    state = state_of(scene)
    state.problem, state.problem_while = text, problem_while if is_mendable else None
    return text


def time_factor() -> float | None:
    """Measured over predicted time of the device that rendered last; None before any render."""
    return list(_time_factors.values())[-1] if _time_factors else None


def forecast_text(scene: bpy.types.Scene) -> str:
    """Time and error that the scene's quality stands for: "about 2.1 s, error about 0.006"; what is not known yet is said."""
    state, view_count = state_of(scene), scene.vir.view_count
    if not state.forecasts:
        return "time and error: not planned yet"
    factor = time_factor()
    seconds = (
        sum(forecast.compute_ms(view_count, scene.vir.map_resolution_px) for forecast in state.forecasts.values()) * 1e-3 * (factor or 1.0)
    )
    text = f"about {seconds_text(seconds)}"
    measured = [one for layer in state.statistics.values() for one in layer.passes if one.view_count > 1]
    if not measured:
        return text
    worst = max(predict_error(one.error_estimate, one.view_count, view_count) for one in measured)
    return f"{text}, error about {error_text(worst)}"


def decision_text(state: SceneState, light_name: str, letter_count: int | None = None) -> str:
    """One short line on a light: "64 views, ~0.8 s", after a render "64 views, 0.8 s, error 0.006", planned with other views after that
    "128 views, ~1.5 s, error ~0.004", or "skipped: casts no shadow". In fewer words where these letters are too many."""
    planned = state.planned(light_name)
    if planned is None:
        return "not planned yet"
    if not planned.runs:
        return planned.reason
    made = state.made(light_name)
    if made is not None and made.view_count == planned.view_count:
        return made_text(made, letter_count)
    took = f"~{seconds_text(planned.predicted_ms * 1e-3 * (time_factor() or 1.0))}"
    if made is None or made.view_count < 2:
        return f"{_views_text(planned.view_count)}, {took}"
    error = predict_error(made.error_estimate, made.view_count, planned.view_count)
    return _figures_text(planned.view_count, took, error, "~", letter_count)


def made_text(made: PassStatistics, letter_count: int | None = None) -> str:
    """Of the last render, whatever is planned since: "64 views, 0.8 s, error 0.006"."""
    return _figures_text(made.view_count, seconds_text(sum(made.stage_ms.values()) * 1e-3), made.error_estimate, "", letter_count)


def _views_text(count: int) -> str:
    return f"{count} view{'s' * (count != 1)}"


def _figures_text(view_count: int, took: str, error: float, about: str, letter_count: int | None) -> str:
    views = _views_text(view_count)
    variants = [f"{views}, {took}, error {about}{error_text(error)}"]
    if error < 1:
        variants += [f"{views}, {took}, ±{error_text(error)}", f"{view_count}, {took}, ±{error_text(error)}"]
    return next((text for text in variants if letter_count is None or len(text) <= letter_count), variants[-1])


def seconds_text(seconds: float) -> str:
    if seconds >= 90:
        return f"{seconds / 60:.0f} min"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s" if seconds >= 0.95 else f"{seconds * 1e3:.0f} ms"


def error_text(error: float) -> str:
    return f"{error:.3f}" if error < 1 else "unknown"
