"""Placed meshes: gathered while the depsgraph's iterator runs, turned into `core.scene.Instances` afterwards.

What iterating yields is one row of plain numbers each, because a kept item silently changes into the last one. All geometry arrives as
objects of type MESH, also that of curves, texts, surfaces, metaballs and geometry nodes: those show up a second time, instanced by
themselves. So nothing has to be converted.
"""

from __future__ import annotations

import array
import zlib
from collections.abc import Hashable
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ...core.material import Layer
from ...core.scene import Instances, LeftOut, Mesh
from ..materials.opacity import MaterialOpacity, MaterialReader
from ..materials.surface import SurfaceReader
from ..properties import reflector_mark
from .corner_layers import with_layers
from .mesh import extract_mesh
from .mesh_cache import MeshCache, ReadMesh
from .mesh_parts import MeshPart, split_mesh

PERSISTENT_ID_LENGTH = 8
_NO_MATRIX_BUFFER = bpy.app.version < (5, 0, 0)
"""4.5 has no buffer protocol for matrices; where there is one it is three times faster"""


@dataclass(frozen=True)
class ObjectFacts:
    """What is read once of an object, however many instances of it there are."""

    name: str
    sort_key: str
    """name and library: unique in the file"""
    uid: int
    """session_uid of the original; the evaluated copy has another"""
    visible_to_camera: bool
    visible_to_shadow: bool
    visible_to_glossy: bool
    reflector_mark: int
    """as in `Instances.reflector_mark`"""
    is_holdout: bool
    is_indirect_only: bool
    hide_render: bool
    stays: bool
    """as in `Instances.stays`"""


class ObjectTable:
    """Facts by address of the evaluated object; addresses are those of the depsgraph's own objects, valid while it lives."""

    def __init__(self, view_layer: bpy.types.ViewLayer, hidden_uids: frozenset[int] = frozenset()) -> None:
        """view_layer: evaluated. hidden_uids: objects that no renderable collection holds."""
        self.rows: list[ObjectFacts] = []
        self._row_of_address: dict[int, int] = {}
        self.view_layer = view_layer
        self._hidden_uids = hidden_uids

    def row(self, evaluated: bpy.types.Object) -> int:
        address = evaluated.as_pointer()
        row = self._row_of_address.get(address)
        if row is None:
            row = self._row_of_address[address] = len(self.rows)
            self.rows.append(self._read(evaluated))
        return row

    def rank(self) -> np.ndarray:
        """(row_count,) int64: place of each row when sorted by name and library"""
        rank = np.empty(len(self.rows), dtype=np.int64)
        rank[sorted(range(len(self.rows)), key=lambda row: self.rows[row].sort_key)] = np.arange(len(self.rows))
        return rank

    def _read(self, evaluated: bpy.types.Object) -> ObjectFacts:
        original = evaluated.original
        library = original.library
        is_holdout = evaluated.is_holdout or evaluated.holdout_get(view_layer=self.view_layer)
        return ObjectFacts(
            name=evaluated.name,
            sort_key=f"{evaluated.name}\0{library.filepath if library else ''}",
            uid=original.session_uid,
            visible_to_camera=evaluated.visible_camera,
            visible_to_shadow=evaluated.visible_shadow,
            visible_to_glossy=evaluated.visible_glossy,
            reflector_mark=reflector_mark(original),
            is_holdout=is_holdout,
            is_indirect_only=not is_holdout and evaluated.indirect_only_get(view_layer=self.view_layer),
            hide_render=evaluated.hide_render or original.session_uid in self._hidden_uids,
            stays=_stays(original),
        )


_STEADY_MODIFIERS = frozenset(
    (
        "ARRAY",
        "BEVEL",
        "DECIMATE",
        "DISPLACE",
        "EDGE_SPLIT",
        "MASK",
        "MIRROR",
        "MULTIRES",
        "NORMAL_EDIT",
        "REMESH",
        "SCREW",
        "SOLIDIFY",
        "SUBSURF",
        "TRIANGULATE",
        "WEIGHTED_NORMAL",
        "WELD",
        "WIREFRAME",
    )
)
"""They make the same of the same mesh in every frame, unless animation changes their settings."""


def is_animated(item: bpy.types.Object) -> bool:
    """Whether the object, its data or its shape keys have keyframes or drivers, or had some."""
    parts = (item, item.data, getattr(item.data, "shape_keys", None))
    return any(part is not None and part.animation_data is not None for part in parts)


def _stays(original: bpy.types.Object) -> bool:
    """Whether nothing in the settings of an object, or of what carries it, moves or deforms it: no animation, constraints, physics or
    modifiers that do."""
    carrier: bpy.types.Object | None = original
    while carrier is not None:
        physics = carrier.rigid_body
        if (
            is_animated(carrier)
            or len(carrier.constraints)
            or (physics is not None and (physics.type == "ACTIVE" or physics.kinematic))
            or getattr(carrier.data, "shape_keys", None) is not None
            or any(modifier.type not in _STEADY_MODIFIERS for modifier in carrier.modifiers)
        ):
            return False
        carrier = carrier.parent
    return True


@dataclass
class PlacedInstances:
    """The finished table, and what light linking asks of it."""

    meshes: tuple[Mesh, ...]
    instances: Instances
    world_origin_m: np.ndarray
    """(3,) float64"""
    object_uid: np.ndarray
    """(instance_count,) int64, session_uid of the instanced object"""
    instancer_uid: np.ndarray
    """(instance_count,) int64, of the instancer, or of the object itself"""
    left_out: list[LeftOut]
    holdout_names: list[str]


@dataclass(frozen=True)
class _PlacedPart:
    """One mesh of an object's, and what instances of it do."""

    mesh_index: int
    is_visible: bool
    casts: bool


@dataclass
class SurfaceRows:
    """Grows by one row for every mesh that the iterator shows."""

    objects: ObjectTable
    materials: MaterialReader
    surfaces: SurfaceReader | None = None
    """None: a snapshot without materials"""
    is_viewport: bool = False
    """a viewport depsgraph: meshes subdivided on the GPU are complete only through `to_mesh`"""
    cache: MeshCache | None = None
    cache_keys: set[Hashable] = field(default_factory=set)
    """of all that was found in the cache or put there"""
    meshes: list[Mesh] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    _parts_of_object: dict[tuple[int, int], list[_PlacedPart]] = field(default_factory=dict)
    _parts_of_mesh: dict[tuple[object, ...], list[_PlacedPart]] = field(default_factory=dict)
    _lost_meshes: set[int] = field(default_factory=set)
    """addresses of evaluated data of which no triangle could be kept"""
    _set_of_object: dict[tuple[int, int], int] = field(default_factory=dict)
    _index_of_set: dict[tuple[int, ...], int] = field(default_factory=dict)
    _material_set: array.array = field(default_factory=lambda: array.array("i"))
    _mesh_index: array.array = field(default_factory=lambda: array.array("i"))
    _object_row: array.array = field(default_factory=lambda: array.array("i"))
    _instancer_row: array.array = field(default_factory=lambda: array.array("i"))
    _persistent_ids: array.array = field(default_factory=lambda: array.array("i"))
    _matrices: array.array = field(default_factory=lambda: array.array("f"))
    _is_visible: array.array = field(default_factory=lambda: array.array("b"))
    _casts: array.array = field(default_factory=lambda: array.array("b"))

    def add(self, item: bpy.types.DepsgraphObjectInstance, shown: bpy.types.Object, object_row: int, instancer_row: int) -> None:
        """shown: `item.object`, of type MESH. Rows into `objects`."""
        parts = self._parts_of(shown, object_row, instancer_row)
        if not parts and shown.data.as_pointer() in self._lost_meshes:
            reason = "has no triangle whose coordinates are finite numbers (and below 1e15)"
            name = self.objects.rows[object_row].name
            self.left_out.append(LeftOut(name, reason, instance_count=1, is_never_surface=True))
        for part in parts:
            if self.surfaces is not None:
                self._material_set.append(self._set_of_object[object_row, shown.data.as_pointer()])
            self._mesh_index.append(part.mesh_index)
            self._is_visible.append(part.is_visible)
            self._casts.append(part.casts)
            self._object_row.append(object_row)
            self._instancer_row.append(instancer_row)
            if item.is_instance:
                self._persistent_ids.extend(item.persistent_id)
            else:
                self._persistent_ids.extend(_NO_PERSISTENT_ID)
            world_from_object = item.matrix_world
            if _NO_MATRIX_BUFFER:
                for row in world_from_object:
                    self._matrices.extend(row)
            else:
                self._matrices.frombytes(memoryview(world_from_object).tobytes())

    def _parts_of(self, shown: bpy.types.Object, object_row: int, instancer_row: int) -> list[_PlacedPart]:
        """Objects with the same evaluated data, which is what Blender gives duplicates and instances, share its meshes, unless they
        give it materials of their own that make a difference."""
        address = shown.data.as_pointer()
        parts = self._parts_of_object.get((object_row, address))
        if parts is None:
            materials = self.materials.materials_of(shown)
            layers = self._layers_of(shown, object_row)
            parts = self._parts_of_mesh.get((address, materials, layers))
            if parts is None:
                read = self._read_cached(shown, materials, layers, object_row, instancer_row)
                first = len(self.meshes)
                self.meshes += [part.mesh for part in read.parts]
                self.left_out += read.left_out
                if read.has_lost_all:
                    self._lost_meshes.add(address)
                parts = [_PlacedPart(first + k, part.is_visible, part.casts) for k, part in enumerate(read.parts)]
                self._parts_of_mesh[address, materials, layers] = parts
            self._parts_of_object[object_row, address] = parts
        return parts

    def _layers_of(self, shown: bpy.types.Object, object_row: int) -> frozenset[Layer] | None:
        """What the object's materials, whose set is noted, ask of its mesh; None without materials."""
        if self.surfaces is None:
            return None
        material_set = self.surfaces.material_set(shown)
        index = self._index_of_set.setdefault(material_set, len(self._index_of_set))
        self._set_of_object[object_row, shown.data.as_pointer()] = index
        return self.surfaces.layers_of(material_set)

    def _read_cached(
        self,
        shown: bpy.types.Object,
        materials: tuple[MaterialOpacity | None, ...],
        layers: frozenset[Layer] | None,
        object_row: int,
        instancer_row: int,
    ) -> ReadMesh:
        uids = frozenset({self.objects.rows[object_row].uid, self.objects.rows[instancer_row].uid, shown.data.original.session_uid})
        if self.cache is None:
            return self._read(shown, materials, layers, uids)
        data = shown.data
        key = (data.as_pointer(), len(data.vertices), len(data.polygons), len(data.loops), materials, layers, shown.mode == "EDIT", uids)
        read = self.cache.find(key, self.objects.rows[object_row].name, len(data.loops))
        if read is None:
            read = self._read(shown, materials, layers, uids)
            self.cache.keep(key, read)
        self.cache_keys.add(key)
        return read

    def _read(
        self,
        shown: bpy.types.Object,
        materials: tuple[MaterialOpacity | None, ...],
        layers: frozenset[Layer] | None,
        uids: frozenset[int],
    ) -> ReadMesh:
        # in edit mode the evaluated data is a wrapper without polygons, in a render's depsgraph too
        needs_mesh = shown.mode == "EDIT" or (self.is_viewport and shown.modifiers and shown.modifiers[-1].type == "SUBSURF")
        data = shown.to_mesh() if needs_mesh else shown.data
        extracted = extract_mesh(data, shown.data.name)
        left_out = []
        has_lost_all = extracted.mesh is None and extracted.dropped_triangle_count > 0
        if extracted.dropped_vertex_count and not has_lost_all:
            reason = "has vertices whose coordinates are not finite numbers (or beyond 1e15); the triangles at them are missing"
            dropped = extracted.dropped_vertex_count, extracted.dropped_triangle_count
            left_out.append(LeftOut(shown.name, reason, vertex_count=dropped[0], triangle_count=dropped[1]))
        if extracted.mesh is not None and layers is not None:
            extracted = replace(extracted, mesh=with_layers(data, extracted, layers))
        if extracted.mesh is None:
            parts = []
        elif not materials:
            parts = [MeshPart(extracted.mesh)]
        else:
            parts, missing = split_mesh(data, extracted, materials)
            left_out += [LeftOut(shown.name, reason) for reason in missing]
        if needs_mesh:
            shown.to_mesh_clear()
        return ReadMesh(tuple(parts), tuple(left_out), uids, has_lost_all)

    def place(self) -> PlacedInstances:
        """Sort, so that neither the order in the file nor that of evaluation matters, and move to the origin."""
        object_row = np.array(self._object_row, dtype=np.int32)
        instancer_row = np.array(self._instancer_row, dtype=np.int32)
        persistent_ids = np.array(self._persistent_ids, dtype=np.int32).reshape(-1, PERSISTENT_ID_LENGTH)
        world_from_object = np.array(self._matrices, dtype=np.float64).reshape(-1, 4, 4)
        is_usable = _is_invertible(world_from_object)
        # an object's meshes stand at one place, which counts once
        unusable = np.flatnonzero(~is_usable)
        places = np.column_stack([object_row[unusable], instancer_row[unusable], persistent_ids[unusable]])
        unusable = unusable[np.unique(places, axis=0, return_index=True)[1]]
        left_out = self.left_out + _unusable_matrices(object_row[unusable], world_from_object[unusable], self.objects)

        rank = self.objects.rank()
        order = np.lexsort((*persistent_ids.T[::-1], rank[instancer_row], rank[object_row]))  # the last key counts most
        order = order[is_usable[order]]
        object_row, instancer_row, world_from_object = object_row[order], instancer_row[order], world_from_object[order]
        meshes, mesh_index = _in_order_of_use(self.meshes, np.array(self._mesh_index, dtype=np.int32)[order])
        world_origin_m = choose_world_origin(meshes, mesh_index, world_from_object)
        world_from_object[:, :3, 3] -= world_origin_m

        is_visible, casts = (np.array(flags, dtype=bool) for flags in (self._is_visible, self._casts))
        facts = self.objects.rows
        object_names, object_index = _name_objects(facts, object_row, rank)
        uid = np.array([fact.uid for fact in facts], dtype=np.int64)
        camera = np.array([fact.visible_to_camera for fact in facts], dtype=bool)
        shadow = np.array([fact.visible_to_shadow for fact in facts], dtype=bool)
        is_indirect_only = np.array([fact.is_indirect_only for fact in facts], dtype=bool)
        stays = np.array([fact.stays for fact in facts], dtype=bool)
        instances = Instances(
            mesh_index=mesh_index,
            world_from_object=world_from_object.astype(np.float32),
            object_index=object_index,
            object_names=object_names,
            visible_to_camera=camera[object_row] & camera[instancer_row] & ~is_indirect_only[instancer_row] & is_visible[order],
            casts_shadow=shadow[object_row] & shadow[instancer_row] & casts[order],
            stable_id=_stable_ids(facts, object_row, instancer_row, persistent_ids[order]),
            stays=stays[object_row] & stays[instancer_row],
            **self._of_reflections(object_row, instancer_row, order, is_visible),
        )
        return PlacedInstances(
            meshes=meshes,
            instances=instances,
            world_origin_m=world_origin_m,
            object_uid=uid[object_row],
            instancer_uid=uid[instancer_row],
            left_out=left_out,
            holdout_names=sorted({facts[row].name for row in np.unique(instancer_row) if facts[row].is_holdout}),
        )

    def _of_reflections(
        self, object_row: np.ndarray, instancer_row: np.ndarray, order: np.ndarray, is_visible: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Fields of `Instances` that only a snapshot with materials has."""
        if self.surfaces is None:
            return {}
        facts = self.objects.rows
        is_seen = np.array([fact.visible_to_glossy for fact in facts], dtype=bool)
        mark = np.array([fact.reflector_mark for fact in facts], dtype=np.int8)
        return {
            "visible_in_reflections": is_seen[object_row] & is_seen[instancer_row] & is_visible[order],
            "material_set": np.array(self._material_set, dtype=np.int32)[order],
            # what an object says of itself goes before what its instancer says
            "reflector_mark": np.where(mark[object_row] >= 0, mark[object_row], mark[instancer_row]),
        }

    @property
    def material_sets(self) -> tuple[tuple[int, ...], ...]:
        return tuple(self._index_of_set)


_NO_PERSISTENT_ID = (0,) * PERSISTENT_ID_LENGTH


def _is_invertible(world_from_object: np.ndarray) -> np.ndarray:
    """(instance_count,) bool. Relative to the lengths of the axes: a small object is not a flat one."""
    axes = world_from_object[:, :3, :3]
    is_finite = np.isfinite(world_from_object).all(axis=(1, 2))
    axes = np.where(is_finite[:, None, None], axes, 0.0)
    lengths = np.linalg.norm(axes, axis=1)
    unit = axes / np.where(lengths > 0.0, lengths, 1.0)[:, None, :]
    return is_finite & (lengths > 0.0).all(axis=1) & (np.abs(np.linalg.det(unit)) > 1e-7)


def _unusable_matrices(object_row: np.ndarray, world_from_object: np.ndarray, objects: ObjectTable) -> list[LeftOut]:
    is_finite = np.isfinite(world_from_object).all(axis=(1, 2))
    left_out = []
    for reason, rows in (
        ("has a scale of zero along at least one axis", object_row[is_finite]),
        ("has a position or scale that is not a finite number", object_row[~is_finite]),
    ):
        left_out += [
            LeftOut(objects.rows[row].name, reason, instance_count=int(count))
            for row, count in zip(*np.unique(rows, return_counts=True), strict=True)
        ]
    return left_out


def _in_order_of_use(meshes: list[Mesh], mesh_index: np.ndarray) -> tuple[tuple[Mesh, ...], np.ndarray]:
    """Only meshes that some instance shows, in the order of the instances; and the new (instance_count,) int32 index."""
    used, first_use = np.unique(mesh_index, return_index=True)
    used = used[np.argsort(first_use)]
    new_index = np.zeros(len(meshes), dtype=np.int32)
    new_index[used] = np.arange(len(used), dtype=np.int32)
    return tuple(meshes[index] for index in used), new_index[mesh_index]


def _name_objects(facts: list[ObjectFacts], object_row: np.ndarray, rank: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of the objects that are shown, sorted, and the (instance_count,) int32 index into them."""
    shown = np.unique(object_row)
    shown = shown[np.argsort(rank[shown])]
    index_of_row = np.zeros(len(facts), dtype=np.int32)
    index_of_row[shown] = np.arange(len(shown), dtype=np.int32)
    return tuple(facts[row].name for row in shown), index_of_row[object_row]


def _stable_ids(facts: list[ObjectFacts], object_row: np.ndarray, instancer_row: np.ndarray, persistent_ids: np.ndarray) -> np.ndarray:
    """(instance_count,) uint32 from the names, libraries and persistent ids only"""
    of_name = np.array([zlib.crc32(fact.sort_key.encode()) for fact in facts], dtype=np.uint32)
    result = np.zeros(len(object_row), dtype=np.uint32)
    for column in (of_name[object_row], of_name[instancer_row], *persistent_ids.T.astype(np.uint32)):
        # FNV's multiplication spreads low bits upwards, the shift brings them back down.
        result = (result ^ column) * np.uint32(16777619)
        result ^= result >> np.uint32(15)
    return result


def choose_world_origin(meshes: tuple[Mesh, ...], mesh_index: np.ndarray, world_from_object: np.ndarray) -> np.ndarray:
    """(3,) float64: a point near the middle of all instances' boxes, on a grid as wide as the scene (a power of two).

    Coordinates relative to it stay below the scene's own size, and it moves only when the scene's middle moves by about the scene's size:
    an object that walks about, or another camera, leaves it alone. A scene around Blender's origin keeps that origin.
    """
    if len(mesh_index) == 0:
        return np.zeros(3)
    lowest_os, highest_os = np.array([mesh.bounds_os for mesh in meshes], dtype=np.float64)[mesh_index].transpose(1, 0, 2)
    middle, half = 0.5 * (lowest_os + highest_os), 0.5 * (highest_os - lowest_os)
    axes = world_from_object[:, :3, :3]
    middle_ws = np.einsum("nij,nj->ni", axes, middle) + world_from_object[:, :3, 3]
    half_ws = np.einsum("nij,nj->ni", np.abs(axes), half)
    lowest, highest = (middle_ws - half_ws).min(axis=0), (middle_ws + half_ws).max(axis=0)
    size = float((highest - lowest).max())
    if not 0.0 < size < np.inf:
        return np.zeros(3)
    grid = 2.0 ** np.ceil(np.log2(size))
    return np.rint(0.5 * (lowest + highest) / grid) * grid + 0.0  # adding zero turns -0 into 0
