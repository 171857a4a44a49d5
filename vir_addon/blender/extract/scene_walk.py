"""A walk over all that a depsgraph shows: surfaces, lights, and what cannot be rendered.

No item, nor anything it hands out, is kept beyond its turn, and no iterator beyond a call: what Blender does between two of them may free
what these stand for. So a walk that was left finds its place again by counting, which costs a tenth of walking.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...core.scene import LeftOut
from ..materials.image_cache import OutOfTimeError
from ..render_depsgraph import engine_of
from .instances import ObjectTable, SurfaceRows
from .lights import LightRow, read_light
from .mesh_cache import MaterialReaders, MeshCache

_UNRENDERABLE = {
    "CURVES": ("curves", "hair curves are not surfaces that VIR can render yet"),
    "POINTCLOUD": ("points", "point clouds are not surfaces that VIR can render yet"),
    "VOLUME": (None, "volumes are not surfaces that VIR can render yet"),
    "GREASEPENCIL": ("layers", "grease pencil is not a surface that VIR can render yet"),
}
"""object type -> what its data must have to show anything (None: always), why it is left out"""
_ITEMS_BETWEEN_LOOKS = 32
"""at the clock"""


class CountedWalk:
    """Over what Blender lists, in as many goes as it takes."""

    def __init__(self, take: Callable[[Any], None]) -> None:
        """take: called with each item; OutOfTimeError leaves the item for the next go"""
        self._take = take
        self._done_count = 0

    def go_on(self, items: Iterable[Any], cache: MeshCache | None) -> bool:
        """As far as the cache gives time, and for as long as finding the place took; whether that was all. items: the same each time"""
        start_s = time.perf_counter()
        least_end_s: float | None = None
        for item in itertools.islice(items, self._done_count, None):
            if least_end_s is None:
                least_end_s = 2 * time.perf_counter() - start_s
            try:
                self._take(item)
            except OutOfTimeError:
                return False
            self._done_count += 1
            is_look_due = self._done_count % _ITEMS_BETWEEN_LOOKS == 0
            if is_look_due and cache is not None and cache.is_over and time.perf_counter() > least_end_s:
                return False
        return True


@dataclass
class _Lights:
    shown: list[LightRow] = field(default_factory=list)
    outside: list[LightRow] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)


class SceneWalk:
    def __init__(
        self,
        depsgraph: bpy.types.Depsgraph,
        readers: MaterialReaders,
        outside_uids: frozenset[int] = frozenset(),
        cache: MeshCache | None = None,
        *,
        with_materials: bool = False,
        only_lights_of: frozenset[int] | None = None,
    ) -> None:
        """outside_uids: objects whose surfaces are not seen, nor their lights while there are others. only_lights_of: pass surfaces by; the
        `hidden_uids` of the walk that took them"""
        self._is_viewport = depsgraph.mode == "VIEWPORT"
        if only_lights_of is not None:
            self.hidden_uids = only_lights_of
        else:
            self.hidden_uids = hidden_by_collections(depsgraph.view_layer) if self._is_viewport else frozenset()
        self._objects = ObjectTable(depsgraph.view_layer_eval, self.hidden_uids)
        self.surfaces = SurfaceRows(
            self._objects, readers.opacity, readers.surfaces if with_materials else None, is_viewport=self._is_viewport, cache=cache
        )
        self.left_out: list[LeftOut] = []
        """without lights"""
        self._lights = _Lights()
        self._outside_uids, self._cache = outside_uids, cache
        self._uses_portals = engine_of(depsgraph.scene) == "CYCLES"
        self._walk = CountedWalk(self._take if only_lights_of is None else self._take_light)

    @property
    def light_rows(self) -> list[LightRow]:
        return self._lights.shown or self._lights.outside

    @property
    def left_out_lights(self) -> list[LeftOut]:
        return self._lights.left_out

    def go_on(self, depsgraph: bpy.types.Depsgraph) -> bool:
        """As far as the cache gives time; whether that was all. depsgraph: that of before, not evaluated since"""
        self._objects.view_layer = depsgraph.view_layer_eval
        return self._walk.go_on(depsgraph.object_instances, self._cache)

    def _take_light(self, item: bpy.types.DepsgraphObjectInstance) -> None:
        if item.object.type == "LIGHT":
            self._take(item)

    def _take(self, item: bpy.types.DepsgraphObjectInstance) -> None:
        shown = item.object
        kind = shown.type
        is_surface = kind == "MESH"
        if not (is_surface or kind == "LIGHT" or kind in _UNRENDERABLE):
            return
        objects = self._objects
        is_instance = item.is_instance
        object_row = objects.row(item.instance_object if is_instance else shown)
        instancer_row = objects.row(item.parent) if is_instance else object_row
        if self._is_viewport and (objects.rows[object_row].hide_render or objects.rows[instancer_row].hide_render):
            return
        is_outside = bool(self._outside_uids) and objects.rows[instancer_row].uid in self._outside_uids
        if is_outside and kind != "LIGHT":
            return
        if is_surface and item.show_particles and len(shown.particle_systems):
            self.left_out += _hair(shown, is_all=not item.show_self)
        if not item.show_self:
            return
        if is_surface:
            self.surfaces.add(item, shown, object_row, instancer_row)
        elif kind != "LIGHT":
            content, reason = _UNRENDERABLE[kind]
            if content is None or len(getattr(shown.data, content)):
                self.left_out.append(LeftOut(shown.name, reason, instance_count=1, is_never_surface=True))
        elif self._uses_portals and shown.data.type == "AREA" and shown.data.cycles.is_portal:
            self._lights.left_out.append(LeftOut(shown.name, "light portals give no light of their own", instance_count=1))
        else:
            (self._lights.outside if is_outside else self._lights.shown).append(read_light(item))


def _hair(shown: bpy.types.Object, is_all: bool) -> list[LeftOut]:
    """is_all: the object that it grows on is not shown"""
    return [
        LeftOut(
            shown.name,
            f"the hair of its particle system '{modifier.particle_system.name}' is not a surface that VIR can render yet",
            is_never_surface=is_all,
        )
        for modifier in shown.modifiers
        if modifier.type == "PARTICLE_SYSTEM"
        and modifier.show_render
        and modifier.particle_system.settings.type == "HAIR"
        and modifier.particle_system.settings.render_type == "PATH"
    ]


def hidden_by_collections(view_layer: bpy.types.ViewLayer) -> frozenset[int]:
    """session_uid of the view layer's objects that are only in collections hidden from renders. (A render's depsgraph lacks them.)"""
    shown: set[int] = set()
    pending = [view_layer.layer_collection]
    while pending:
        layer_collection = pending.pop()
        if not layer_collection.collection.hide_render:
            pending.extend(layer_collection.children)
            if not layer_collection.exclude:
                shown.update(_uids(layer_collection.collection.objects))
    return frozenset(_uids(view_layer.objects)) - shown


def _uids(objects: Any) -> list[int]:
    uids = np.empty(len(objects), np.uint32)
    objects.foreach_get("session_uid", uids)
    found: list[int] = uids.tolist()
    return found
