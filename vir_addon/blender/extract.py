"""The only way in: an evaluated Blender scene -> `core.scene.SceneSnapshot`.

Hand it the depsgraph of a render (a frame handler's, an engine's, or `render_depsgraph.with_render_depsgraph`'s); with the viewport's it
works too, and says so in the notes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.material import Material, World
from ..core.scene import LeftOut, Light, SceneSnapshot
from .extract_camera import Picture, extract_camera, extract_picture, extract_pixel_filter
from .extract_instances import ObjectTable, PlacedInstances, SurfaceRows
from .extract_lights import LightRow, name_lights, place_light, read_light
from .extract_world import WorldReader
from .light_linking import read_linking
from .mesh_cache import MaterialReaders, MeshCache
from .render_depsgraph import engine_of
from .viewport_view import ViewportView

_UNRENDERABLE = {
    "CURVES": ("curves", "hair curves are not surfaces that VIR can render yet"),
    "POINTCLOUD": ("points", "point clouds are not surfaces that VIR can render yet"),
    "VOLUME": (None, "volumes are not surfaces that VIR can render yet"),
    "GREASEPENCIL": ("layers", "grease pencil is not a surface that VIR can render yet"),
}
"""object type -> what its data must have to show anything (None: always), why it is left out"""


def snapshot(
    depsgraph: bpy.types.Depsgraph,
    *,
    resolution: tuple[int, int] | None = None,
    view: ViewportView | None = None,
    cache: MeshCache | None = None,
    with_materials: bool = False,
) -> SceneSnapshot:
    """Everything that renders, as numpy arrays that outlive the depsgraph.

    resolution: width and height of the whole frame in place of the scene's; a cropping render border cuts its part out of that.
    view: looked from instead of the scene's camera, which then need not exist. cache: of the same depsgraph; meshes that it knows are
    the same objects in every snapshot. with_materials: what surfaces and the world look like, which reflections need.
    Raises SceneError for a scene that no renderer could make a picture of, OutOfTimeError as the cache demands.
    """
    start_s = time.perf_counter()
    scene = depsgraph.scene_eval
    if view is not None:
        picture = Picture(view.width_px, view.height_px, view.width_px, view.height_px)
    elif scene.camera is None:  # before any work: reading a large scene takes a while
        raise SceneError(f"The scene '{scene.name}' has no camera. Add one, or make one the active camera.")
    else:
        picture = extract_picture(scene.render, resolution)
    readers = _material_readers(depsgraph, cache)
    surfaces, light_rows, left_out = _walk(
        depsgraph, frozenset() if view is None else view.hidden_uids, cache, readers, with_materials=with_materials
    )
    placed = surfaces.place()
    appearance = _appearance(surfaces, readers.world, depsgraph) if with_materials else None
    lights, unplaced = _place_lights(light_rows, placed, depsgraph)
    return SceneSnapshot(
        scene_name=scene.name,
        view_layer_name=depsgraph.view_layer_eval.name,
        frame=scene.frame_current,
        width_px=picture.width_px,
        height_px=picture.height_px,
        meshes=placed.meshes,
        instances=placed.instances,
        lights=lights,
        camera=view.camera(placed.world_origin_m) if view else extract_camera(scene.camera, scene.render, picture, placed.world_origin_m),
        pixel_filter=extract_pixel_filter(scene, engine_of(depsgraph.scene)),
        world_origin_m=placed.world_origin_m,
        left_out=_sorted_left_out([*left_out, *placed.left_out, *unplaced, *(appearance.left_out if appearance else [])]),
        notes=(
            *(_notes(depsgraph, placed) if view is None else []),
            *sorted(surfaces.materials.notes),
            *sorted(set(appearance.notes) if appearance else []),
        ),
        materials=appearance.materials if appearance else (),
        material_sets=surfaces.material_sets if appearance else (),
        world=appearance.world if appearance else None,
        extract_ms=1e3 * (time.perf_counter() - start_s),
    )


def _walk(
    depsgraph: bpy.types.Depsgraph, outside_uids: frozenset[int], cache: MeshCache | None, readers: MaterialReaders, *, with_materials: bool
) -> tuple[SurfaceRows, list[LightRow], list[LeftOut]]:
    """One pass over all that the depsgraph shows. No item, nor anything it hands out, is kept beyond its turn.

    outside_uids: objects whose surfaces are not seen, nor their lights while there are others.
    """
    is_viewport = depsgraph.mode == "VIEWPORT"
    hidden_uids = _not_in_rendered_collections(depsgraph.view_layer) if is_viewport else frozenset()
    objects = ObjectTable(depsgraph.view_layer_eval, hidden_uids)
    surfaces = SurfaceRows(objects, readers.opacity, readers.surfaces if with_materials else None, is_viewport=is_viewport, cache=cache)
    light_rows: list[LightRow] = []
    outside_light_rows: list[LightRow] = []
    left_out: list[LeftOut] = []
    uses_portals = engine_of(depsgraph.scene) == "CYCLES"
    for item in depsgraph.object_instances:
        shown = item.object
        kind = shown.type
        is_surface = kind == "MESH"
        if not (is_surface or kind == "LIGHT" or kind in _UNRENDERABLE):
            continue
        is_instance = item.is_instance
        object_row = objects.row(item.instance_object if is_instance else shown)
        instancer_row = objects.row(item.parent) if is_instance else object_row
        if is_viewport and (objects.rows[object_row].hide_render or objects.rows[instancer_row].hide_render):
            continue
        is_outside = objects.rows[instancer_row].uid in outside_uids
        if is_outside and kind != "LIGHT":
            continue
        if is_surface and item.show_particles and len(shown.particle_systems):
            left_out += _hair(shown)
        if not item.show_self:
            continue
        if is_surface:
            surfaces.add(item, shown, object_row, instancer_row)
        elif kind != "LIGHT":
            content, reason = _UNRENDERABLE[kind]
            if content is None or len(getattr(shown.data, content)):
                left_out.append(LeftOut(shown.name, reason))
        elif uses_portals and shown.data.type == "AREA" and shown.data.cycles.is_portal:
            left_out.append(LeftOut(shown.name, "light portals give no light of their own"))
        else:
            (outside_light_rows if is_outside else light_rows).append(read_light(item))
    return surfaces, light_rows or outside_light_rows, left_out + readers.opacity.left_out


def _material_readers(depsgraph: bpy.types.Depsgraph, cache: MeshCache | None) -> MaterialReaders:
    engine, override = engine_of(depsgraph.scene), depsgraph.view_layer_eval.material_override
    return MaterialReaders.make(engine, override) if cache is None else cache.material_readers(engine, override)


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


def _hair(shown: bpy.types.Object) -> list[LeftOut]:
    return [
        LeftOut(shown.name, f"the hair of its particle system '{modifier.particle_system.name}' is not a surface that VIR can render yet")
        for modifier in shown.modifiers
        if modifier.type == "PARTICLE_SYSTEM"
        and modifier.show_render
        and modifier.particle_system.settings.type == "HAIR"
        and modifier.particle_system.settings.render_type == "PATH"
    ]


def _not_in_rendered_collections(view_layer: bpy.types.ViewLayer) -> frozenset[int]:
    """session_uid of the view layer's objects that are only in collections hidden from renders. (A render's depsgraph lacks them.)"""
    shown: set[int] = set()
    pending = [view_layer.layer_collection]
    while pending:
        layer_collection = pending.pop()
        if not layer_collection.collection.hide_render:
            pending.extend(layer_collection.children)
            if not layer_collection.exclude:
                shown.update(member.session_uid for member in layer_collection.collection.objects)
    return frozenset(member.session_uid for member in view_layer.objects) - shown


def _place_lights(rows: list[LightRow], placed: PlacedInstances, depsgraph: bpy.types.Depsgraph) -> tuple[tuple[Light, ...], list[LeftOut]]:
    receivers, blockers = read_linking(depsgraph.objects)
    lights, left_out = [], []
    for name, row in name_lights(rows):
        light = place_light(row, name, placed.world_origin_m)
        if light is None:
            left_out.append(LeftOut(name, "the light has a scale of zero or a position that is not a finite number"))
            continue
        blocking = blockers.mask(row.object_uid, placed.object_uid, placed.instancer_uid)
        lights.append(
            replace(
                light,
                receivers=receivers.mask(row.object_uid, placed.object_uid, placed.instancer_uid),
                blockers=None if blocking is None else blocking & placed.instances.casts_shadow,
            )
        )
    return tuple(lights), left_out


def _sorted_left_out(left_out: list[LeftOut]) -> tuple[LeftOut, ...]:
    return tuple(sorted(set(left_out), key=lambda one: (one.object_name, one.reason, one.vertex_count)))


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
