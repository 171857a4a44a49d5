"""The only way in: an evaluated Blender scene -> `core.scene.SceneSnapshot`.

Hand it the depsgraph of a render (a frame handler's, an engine's, or `render_depsgraph.with_render_depsgraph`'s); with the viewport's it
works too, and says so in the notes.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.material import Material, World
from ...core.scene import LeftOut, Light, SceneSnapshot
from ...core.steps import HostWork, Steps, run_steps
from ..materials.image_cache import ImageCache, OutOfTimeError
from ..render_depsgraph import engine_of
from .camera import Picture, extract_camera, extract_picture, extract_pixel_filter
from .instances import PlacedInstances, SurfaceRows
from .light_linking import SceneLinking
from .lights import LightRow, UnusableLight, instanced_name, name_lights, notes_on_lights, place_light
from .mesh_cache import MaterialReaders, MeshCache
from .scene_walk import CountedWalk, SceneWalk, hidden_by_collections
from .viewport_view import ViewportView
from .world import WorldReader


def snapshot(
    depsgraph: bpy.types.Depsgraph,
    *,
    resolution: tuple[int, int] | None = None,
    view: ViewportView | None = None,
    with_materials: bool = False,
    images: ImageCache | None = None,
) -> SceneSnapshot:
    """Everything that renders, as numpy arrays that outlive the depsgraph.

    resolution: width and height of the whole frame in place of the scene's; a cropping render border cuts its part out of that.
    view: looked from instead of the scene's camera, which then need not exist. with_materials: what surfaces and the world look like, which
    reflections need. images: what was read of them for earlier snapshots. Raises SceneError for a scene that no renderer could make a
    picture of.
    """
    reading = SceneReading(resolution=resolution, view=view, with_materials=with_materials, images=images)
    run_steps(reading.steps(depsgraph))
    assert reading.snapshot is not None
    return reading.snapshot


@dataclass(frozen=True)
class ReadSurfaces:
    """What a scene has but for its lights."""

    placed: PlacedInstances
    appearance: _Appearance | None
    material_sets: tuple[tuple[int, ...], ...]
    left_out: list[LeftOut]
    notes: list[str]
    linking: SceneLinking
    """of all but lights"""
    hidden_uids: frozenset[int]
    """as of SceneWalk"""


class SceneReading:
    """A snapshot in steps, for who has no time to take it at once."""

    def __init__(
        self,
        *,
        resolution: tuple[int, int] | None = None,
        view: ViewportView | None = None,
        with_materials: bool = False,
        cache: MeshCache | None = None,
        images: ImageCache | None = None,
        surfaces: ReadSurfaces | None = None,
    ) -> None:
        """As for `snapshot`. cache: of the depsgraph, and of images; meshes that it knows are the same objects in every snapshot, and steps
        end when its time is over. surfaces: of an earlier reading of the same depsgraph, with as much of materials, since when at most
        lights have changed."""
        self.snapshot: SceneSnapshot | None = None
        """when there are no more steps"""
        self.surfaces = surfaces
        self.with_materials = with_materials
        self._resolution, self._view, self._cache, self._images = resolution, view, cache, images

    def steps(self, depsgraph: bpy.types.Depsgraph) -> Steps:
        """Not to be gone on with once the depsgraph is evaluated anew."""
        start_s = time.perf_counter()
        scene, view = depsgraph.scene_eval, self._view
        if view is not None:
            picture = Picture(view.width_px, view.height_px, view.width_px, view.height_px)
        elif scene.camera is None:  # before any work: reading a large scene takes a while
            raise SceneError(f"The scene '{scene.name}' has no camera. Add one, or make one the active camera.")
        else:
            picture = extract_picture(scene.render, self._resolution)
        walk = yield from self._walking(depsgraph)
        of_lights, of_surfaces = yield from self._reading_linking(depsgraph)
        if self.surfaces is None:
            placed = yield walk.surfaces.place
            appearance = (yield from self._reading_appearance(walk.surfaces, depsgraph)) if self.with_materials else None
            self.surfaces = self._surfaces(walk, placed, of_surfaces, appearance)
        surfaces, placed = self.surfaces, self.surfaces.placed
        lights, unplaced = _place_lights(walk.light_rows, placed, surfaces.linking.joined(of_lights))
        appearance = surfaces.appearance
        self.snapshot = SceneSnapshot(
            scene_name=scene.name,
            view_layer_name=depsgraph.view_layer_eval.name,
            frame=scene.frame_current,
            width_px=picture.width_px,
            height_px=picture.height_px,
            meshes=placed.meshes,
            instances=placed.instances,
            lights=lights,
            camera=view.camera(placed.world_origin_m)
            if view
            else extract_camera(scene.camera, scene.render, picture, placed.world_origin_m),
            pixel_filter=extract_pixel_filter(scene, engine_of(depsgraph.scene)),
            world_origin_m=placed.world_origin_m,
            left_out=_sorted_left_out([*surfaces.left_out, *walk.left_out_lights, *unplaced]),
            lights_elsewhere=_lights_elsewhere(depsgraph, lights) if view is None else (),
            notes=(*(_notes(depsgraph, placed) if view is None else []), *notes_on_lights(walk.light_rows), *surfaces.notes),
            materials=appearance.materials if appearance else (),
            material_sets=surfaces.material_sets if appearance else (),
            world=appearance.world if appearance else None,
            extract_ms=1e3 * (time.perf_counter() - start_s),
        )

    def _walking(self, depsgraph: bpy.types.Depsgraph) -> Generator[HostWork | None, Any, SceneWalk]:
        self._readers = _material_readers(depsgraph, self._cache, self._images)
        outside_uids = frozenset() if self._view is None else self._view.hidden_uids
        known_uids = None if self.surfaces is None else self.surfaces.hidden_uids
        walk = SceneWalk(depsgraph, self._readers, outside_uids, self._cache, with_materials=self.with_materials, only_lights_of=known_uids)
        while not walk.go_on(depsgraph):
            yield self._host_work()
        if self._cache is not None and self.surfaces is None:
            self._cache.note_used(walk.surfaces.cache_keys)
        return walk

    def _reading_linking(self, depsgraph: bpy.types.Depsgraph) -> Generator[HostWork | None, Any, tuple[SceneLinking, SceneLinking]]:
        """Of lights, and of all else unless it is known."""
        of_lights, of_surfaces = SceneLinking(), SceneLinking()
        is_known = self.surfaces is not None

        def take(shown: bpy.types.Object) -> None:
            if shown.type == "LIGHT":
                of_lights.add(shown)
            elif not is_known:
                of_surfaces.add(shown)

        walk = CountedWalk(take)
        while not walk.go_on(depsgraph.objects, self._cache):
            yield None
        return of_lights, of_surfaces

    def _reading_appearance(self, surfaces: SurfaceRows, depsgraph: bpy.types.Depsgraph) -> Generator[HostWork | None, Any, _Appearance]:
        while True:
            try:
                return _appearance(surfaces, self._readers.world, depsgraph)
            except OutOfTimeError:
                yield self._host_work()

    def _host_work(self) -> HostWork | None:
        """What reading goes on after; None: another slice."""
        return None if self._cache is None else self._cache.host_work()

    def _surfaces(self, walk: SceneWalk, placed: PlacedInstances, linking: SceneLinking, appearance: _Appearance | None) -> ReadSurfaces:
        left_out = [*walk.left_out, *self._readers.opacity.left_out, *placed.left_out, *(appearance.left_out if appearance else [])]
        notes = [*sorted(self._readers.opacity.notes), *sorted(set(appearance.notes) if appearance else [])]
        return ReadSurfaces(placed, appearance, walk.surfaces.material_sets, left_out, notes, linking, walk.hidden_uids)


def _material_readers(depsgraph: bpy.types.Depsgraph, cache: MeshCache | None, images: ImageCache | None) -> MaterialReaders:
    engine, override = engine_of(depsgraph.scene), depsgraph.view_layer_eval.material_override
    return MaterialReaders.make(engine, override, images) if cache is None else cache.material_readers(engine, override)


@dataclass(frozen=True)
class _Appearance:
    """What only a snapshot with materials has."""

    materials: tuple[Material, ...]
    world: World
    left_out: list[LeftOut]
    notes: list[str]


def _appearance(surfaces: SurfaceRows, worlds: WorldReader, depsgraph: bpy.types.Depsgraph) -> _Appearance:
    looks = surfaces.surfaces
    assert looks is not None
    # 4.5 knows no override
    override = getattr(depsgraph.view_layer_eval, "world_override", None)
    world = worlds.read(override or depsgraph.scene_eval.world)
    return _Appearance(tuple(looks.materials), world, looks.left_out + worlds.left_out, looks.notes + worlds.notes)


def _place_lights(rows: list[LightRow], placed: PlacedInstances, linking: SceneLinking) -> tuple[tuple[Light, ...], list[LeftOut]]:
    lights, left_out = [], []
    for name, row in name_lights(rows):
        try:
            light = place_light(row, name, placed.world_origin_m)
        except UnusableLight as error:
            left_out.append(LeftOut(name, str(error), instance_count=1, is_light=True))
            continue
        blocking = linking.blockers.mask(row.object_uid, placed.object_uid, placed.instancer_uid)
        lights.append(
            replace(
                light,
                receivers=linking.receivers.mask(row.object_uid, placed.object_uid, placed.instancer_uid),
                blockers=None if blocking is None else blocking & placed.instances.casts_shadow,
            )
        )
    return tuple(lights), left_out


def _sorted_left_out(left_out: list[LeftOut]) -> tuple[LeftOut, ...]:
    """One a reason and object, whose instances are summed."""
    instance_count: dict[LeftOut, int] = {}
    for one in left_out:
        same = replace(one, instance_count=0)
        instance_count[same] = instance_count.get(same, 0) + one.instance_count
    summed = (replace(one, instance_count=count) for one, count in instance_count.items())
    return tuple(sorted(summed, key=lambda one: (one.object_name, one.reason, one.vertex_count, one.triangle_count)))


def _lights_elsewhere(depsgraph: bpy.types.Depsgraph, here: tuple[Light, ...]) -> tuple[str, ...]:
    """As `SceneSnapshot` has them. Those that nodes, particles, vertices or faces instance are not looked for."""
    scene = depsgraph.scene
    # whichever are in use: others than this one are switched off while it is evaluated
    others = [layer for layer in scene.view_layers if layer != depsgraph.view_layer]
    in_others = {item.session_uid for layer in others for item in layer.objects} - frozenset().union(*map(hidden_by_collections, others))
    names: set[str] = set()
    for item in scene.objects:
        if item.type != "LIGHT" and item.instance_collection is None:
            continue
        may_show = item.animation_data is not None or (item.session_uid in in_others and not item.hide_render)
        if item.type == "LIGHT":
            names |= {item.name} if may_show else set()
        elif item.instance_type == "COLLECTION":
            lights = _lights_of(item.instance_collection)
            names |= {instanced_name(light.name, item.name) for light in lights if may_show or light.animation_data is not None}
    return tuple(sorted(names - {light.name for light in here}))


def _lights_of(collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Of what it instances, too."""
    pending, lights = [collection], []
    seen: set[int] = set()
    while pending:
        members = pending.pop().all_objects
        lights += [member for member in members if member.type == "LIGHT"]
        inner = [member.instance_collection for member in members if member.instance_collection is not None]
        pending += [each for each in inner if each.session_uid not in seen]
        seen.update(each.session_uid for each in inner)
    return lights


def _notes(depsgraph: bpy.types.Depsgraph, placed: PlacedInstances) -> list[str]:
    scene = depsgraph.scene_eval
    render = scene.render
    notes = []
    if depsgraph.mode == "VIEWPORT":
        notes.append("Taken from the viewport: modifiers at their viewport levels, objects hidden in the viewport missing.")
    if render.use_border and not render.use_crop_to_border:
        notes.append("The render border does not crop, so the whole frame is made.")
    if render.use_motion_blur:
        notes.append("Motion blur is on: the passes show the frame's own moment, without blur.")
    if scene.camera.data.dof.use_dof:
        notes.append("Depth of field is on: the passes are sharp everywhere.")
    if placed.holdout_names:
        notes.append(f"Holdouts are treated as ordinary surfaces: {', '.join(placed.holdout_names)}.")
    if np.linalg.norm(placed.world_origin_m) > 0.0:
        x, y, z = placed.world_origin_m
        notes.append(f"The scene lies far from the origin; positions are taken relative to ({x:g}, {y:g}, {z:g}) m.")
    return notes
