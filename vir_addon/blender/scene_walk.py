"""A walk over all that a depsgraph shows: surfaces, lights, and what cannot be rendered.

No item, nor anything it hands out, is kept beyond its turn, and no iterator beyond a call: what Blender does between two of them may free
what these stand for. So a walk that was left finds its place again by counting, which costs a tenth of walking.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, field

import bpy

from ..core.scene import LeftOut
from .extract_instances import ObjectTable, SurfaceRows
from .extract_lights import LightRow, read_light
from .mesh_cache import MaterialReaders, MeshCache, OutOfTimeError
from .render_depsgraph import engine_of

_UNRENDERABLE = {
    "CURVES": ("curves", "hair curves are not surfaces that VIR can render yet"),
    "POINTCLOUD": ("points", "point clouds are not surfaces that VIR can render yet"),
    "VOLUME": (None, "volumes are not surfaces that VIR can render yet"),
    "GREASEPENCIL": ("layers", "grease pencil is not a surface that VIR can render yet"),
}
"""object type -> what its data must have to show anything (None: always), why it is left out"""
_ITEMS_BETWEEN_LOOKS = 32
"""at the clock"""


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
        only_lights: bool = False,
    ) -> None:
        """outside_uids: objects whose surfaces are not seen, nor their lights while there are others. only_lights: pass surfaces by"""
        self._is_viewport = depsgraph.mode == "VIEWPORT"
        hidden_uids = _not_in_rendered_collections(depsgraph.view_layer) if self._is_viewport else frozenset()
        self._objects = ObjectTable(depsgraph.view_layer_eval, hidden_uids)
        self.surfaces = SurfaceRows(
            self._objects, readers.opacity, readers.surfaces if with_materials else None, is_viewport=self._is_viewport, cache=cache
        )
        self.left_out: list[LeftOut] = []
        """without lights"""
        self._lights = _Lights()
        self._outside_uids, self._cache, self._only_lights = outside_uids, cache, only_lights
        self._uses_portals = engine_of(depsgraph.scene) == "CYCLES"
        self._done_count = 0

    @property
    def light_rows(self) -> list[LightRow]:
        return self._lights.shown or self._lights.outside

    @property
    def left_out_lights(self) -> list[LeftOut]:
        return self._lights.left_out

    def go_on(self, depsgraph: bpy.types.Depsgraph) -> bool:
        """As far as the cache gives time, and for as long as finding the place took; whether that was all. depsgraph: that of before, not
        evaluated since"""
        self._objects.view_layer = depsgraph.view_layer_eval
        start_s = time.perf_counter()
        least_end_s: float | None = None
        for item in itertools.islice(depsgraph.object_instances, self._done_count, None):
            if least_end_s is None:
                least_end_s = 2 * time.perf_counter() - start_s
            self._done_count += 1
            if not self._only_lights or item.object.type == "LIGHT":
                try:
                    self._take(item)
                except OutOfTimeError:
                    self._done_count -= 1
                    return False
            is_look_due = self._done_count % _ITEMS_BETWEEN_LOOKS == 0
            if is_look_due and self._cache is not None and self._cache.is_over and time.perf_counter() > least_end_s:
                return False
        return True

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
            self.left_out += _hair(shown)
        if not item.show_self:
            return
        if is_surface:
            self.surfaces.add(item, shown, object_row, instancer_row)
        elif kind != "LIGHT":
            content, reason = _UNRENDERABLE[kind]
            if content is None or len(getattr(shown.data, content)):
                self.left_out.append(LeftOut(shown.name, reason))
        elif self._uses_portals and shown.data.type == "AREA" and shown.data.cycles.is_portal:
            self._lights.left_out.append(LeftOut(shown.name, "light portals give no light of their own"))
        else:
            (self._lights.outside if is_outside else self._lights.shown).append(read_light(item))


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
