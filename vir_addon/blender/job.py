"""The one room that every front end goes through: snapshot -> plan -> render -> hand over."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import bpy

from ..core.errors import SceneError
from ..core.pass_set import PassSet
from ..core.plan import RenderPlan, plan
from ..core.render import Progress, render
from ..core.scene import SceneSnapshot
from ..core.settings import Effect, Settings
from ..core.stopwatch import OnStage
from ..device.failure import as_told
from ..device.interface import Device
from .extract import snapshot
from .extract.instances import is_animated
from .render_depsgraph import with_render_depsgraph

SURFACE_TYPES = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META"})
"""types of objects that Blender evaluates to meshes"""
TIME_NODES = frozenset({"GeometryNodeInputSceneTime", "GeometryNodeSimulationInput"})
"""of geometry, by which frames differ"""


@dataclass(frozen=True)
class LayerJob:
    """What will be rendered of one view layer in one frame."""

    snapshot: SceneSnapshot
    plan: RenderPlan


def rendered_view_layers(scene: bpy.types.Scene) -> list[bpy.types.ViewLayer]:
    """The layers that Blender would render: those in use, or the first when none is."""
    return [layer for layer in scene.view_layers if layer.use] or [scene.view_layers[0]]


OnStep = Callable[[str], None]
"""called with what is being done, in words, when it begins"""


def take_snapshot(
    scene: bpy.types.Scene,
    view_layer: bpy.types.ViewLayer,
    resolution: tuple[int, int] | None = None,
    on_step: OnStep | None = None,
    *,
    with_materials: bool = False,
) -> SceneSnapshot:
    """The scene at its current frame as a render would see it. with_materials: as reflections need it"""

    def read(depsgraph: bpy.types.Depsgraph) -> SceneSnapshot:
        if on_step is not None:
            on_step(f"reading {view_layer.name}")
        return snapshot(depsgraph, resolution=resolution, with_materials=with_materials)

    if on_step is not None:
        on_step(f"evaluating {view_layer.name}")
    taken = with_render_depsgraph(scene, view_layer, read)
    if not scene.render.use_multiview:
        return taken
    # said here, as the evaluation switches stereoscopy off meanwhile
    return replace(taken, notes=(*taken.notes, "Stereoscopy is on: the passes are those of the active camera only, not of either eye."))


def frame_jobs(
    scene: bpy.types.Scene,
    frame: int | None,
    settings: Settings,
    resolution: tuple[int, int] | None = None,
    on_step: OnStep | None = None,
) -> dict[str, LayerJob]:
    """View layer name -> job, for one frame. frame: None as the scene stands, which is then left as it is

    Raises SceneError for a scene that has no surface in any frame, as far as can be told. A frame, or a view layer, that shows none gets
    white passes: things are hidden and scaled to nothing by animation, and a layer of its own for smoke is common.
    """
    if frame is not None:
        scene.frame_set(frame)
    reflects = Effect.REFLECTION in settings.effects
    snapshots = {
        layer.name: take_snapshot(scene, layer, resolution, on_step, with_materials=reflects) for layer in rendered_view_layers(scene)
    }
    left_out_items = [item for taken in snapshots.values() for item in taken.left_out]
    without_surface = {item.object_name for item in left_out_items if item.is_never_surface}
    if not any(len(taken.instances) for taken in snapshots.values()) and not _has_surface_objects(scene.objects, without_surface):
        left_out = sorted({item.text for item in left_out_items})
        raise SceneError(
            f"scene {scene.name!r} has no surface that a shadow could fall on; add a mesh, a curve with a bevel, a text or a metaball"
            + (f"; left out: {', '.join(left_out)}" if left_out else "")
        )
    return {name: LayerJob(taken, plan(taken, settings)) for name, taken in snapshots.items()}


def replanned(jobs: Mapping[str, LayerJob], settings: Settings) -> dict[str, LayerJob]:
    """The same snapshots with other settings."""
    return {name: LayerJob(job.snapshot, plan(job.snapshot, settings)) for name, job in jobs.items()}


def _has_surface_objects(objects: Iterable[bpy.types.Object], without: Collection[str]) -> bool:
    """Whether any object could show a surface in some frame, hidden ones and those of instanced collections included. without: names of
    those that show something else in this one"""
    pending, seen = list(objects), set()
    while pending:
        candidate = pending.pop()
        is_other_now = candidate.name in without or _stays_without_faces(candidate)
        if candidate.type in SURFACE_TYPES and (not is_other_now or _may_become_other(candidate)):
            return True
        instanced = candidate.instance_collection
        if instanced is not None and instanced.session_uid not in seen:
            seen.add(instanced.session_uid)
            pending += instanced.all_objects
    return False


def _stays_without_faces(candidate: bpy.types.Object) -> bool:
    """A mesh of points or edges, or of nothing, that no modifier makes anything of."""
    data = candidate.data
    return candidate.type == "MESH" and not (candidate.modifiers or data.is_editmode or len(data.polygons))


def _may_become_other(candidate: bpy.types.Object) -> bool:
    """Whether what an object shows may be another kind of thing in another frame: it, its data or its nodes are animated or read the time,
    or it is built."""
    kinds = {modifier.type for modifier in candidate.modifiers}
    trees = [modifier.node_group for modifier in candidate.modifiers if modifier.type == "NODES"]
    return is_animated(candidate) or not kinds.isdisjoint({"BUILD", "MESH_SEQUENCE_CACHE"}) or _depends_on_time(trees)


def _depends_on_time(trees: list[bpy.types.NodeTree | None]) -> bool:
    """Or some group within does."""
    pending, seen = list(trees), set()
    while pending:
        tree = pending.pop()
        if tree is None or tree.session_uid in seen:
            continue
        seen.add(tree.session_uid)
        if tree.animation_data is not None or any(node.bl_idname in TIME_NODES for node in tree.nodes):
            return True
        pending += [node.node_tree for node in tree.nodes if node.bl_idname == "GeometryNodeGroup"]
    return False


def run(job: LayerJob, device: Device, on_progress: Callable[[Progress], None] | None = None, on_stage: OnStage | None = None) -> PassSet:
    """Render to the end. KeyboardInterrupt and errors leave nothing behind on the device."""
    progress = None
    try:
        with contextlib.closing(render(job.snapshot, job.plan, device, on_stage)) as steps:
            for progress in steps:
                if on_progress is not None:
                    on_progress(progress)
    except Exception as error:
        if (told := as_told(error)) is not error:
            raise told from error
        raise
    if progress is None:
        raise RuntimeError("the render ended before its first batch")
    return progress.pass_set
