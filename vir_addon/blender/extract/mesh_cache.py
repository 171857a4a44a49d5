"""Meshes, materials and images that were read before, so that a preview reads only what has changed since.

Blender's evaluated geometry stays in place, and is not read again, until an update of the dependency graph says that its object, the
object that instances it or its data have changed. Materials are few, and are all looked at again when one of them changes; the texels of
images stay, unless it may have been an image that has changed.
"""

from __future__ import annotations

import time
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import bpy

from ..materials.image_cache import ImageCache, OutOfTimeError
from ..materials.opacity import MaterialReader
from ..materials.surface import SurfaceReader
from .mesh_parts import MeshPart
from .world import WorldReader

if TYPE_CHECKING:
    from ...core.scene import LeftOut
    from ...core.steps import HostWork

LARGE_MESH_CORNERS = 1 << 20
"""A mesh of so many is read in a twentieth of a second or more, by calls that cannot be left half done: who waits is told before."""

_SURFACE_TYPES = (bpy.types.Material, bpy.types.World, bpy.types.NodeTree, bpy.types.Image, bpy.types.Texture)


class MaterialReaders(NamedTuple):
    """They know what they have read."""

    opacity: MaterialReader
    surfaces: SurfaceReader
    world: WorldReader

    @classmethod
    def make(
        cls, engine: str, override: bpy.types.Material | None, images: ImageCache | None = None, world: WorldReader | None = None
    ) -> MaterialReaders:
        images = images or ImageCache()
        return cls(MaterialReader(engine, images, override), SurfaceReader(engine, images, override), world or WorldReader(engine, images))


@dataclass(frozen=True)
class ReadMesh:
    """What came of an object's evaluated data."""

    parts: tuple[MeshPart, ...]
    left_out: tuple[LeftOut, ...]
    uids: frozenset[int]
    """session_uid of the originals that it was made from"""
    has_lost_all: bool = False
    """there were triangles, and none could be kept"""


def changes_only_lights(depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether an evaluation has changed nothing else; what hangs on a light is named besides it."""
    originals = [update.id.original for update in depsgraph.updates]
    owned = (original for original in originals if not (isinstance(original, bpy.types.NodeTree) and original.is_embedded_data))
    return bool(originals) and all(
        isinstance(original, bpy.types.Light)
        or (isinstance(original, bpy.types.Object) and original.type == "LIGHT" and not original.is_instancer)
        for original in owned
    )


class MeshCache:
    """Of one view layer's viewport depsgraph. Tell it of every update of that."""

    def __init__(self) -> None:
        self._meshes: dict[Hashable, ReadMesh] = {}
        self._materials: tuple[Hashable, MaterialReaders] | None = None
        self._world: tuple[Hashable, WorldReader] | None = None
        """and what it depends on: the engine that it reads for, and which images are packed"""
        self.images = ImageCache(self._begin_reading)
        self._used: set[Hashable] = set()
        self._deadline_s = float("inf")
        self._has_read = False
        self.read_count = 0
        """meshes read since this was made"""
        self.large_name = ""
        """of the large mesh's object that is read next, if one is"""
        self._announced: set[Hashable] = set()
        self._announced_before: set[Hashable] = set()
        """large meshes that have been told of and not been read, since a walk ended and before that: each viewport may wait at another"""

    def note_updates(self, depsgraph: bpy.types.Depsgraph) -> None:
        """From a handler that is told of an evaluation."""
        changed = set()
        for update in depsgraph.updates:
            original = update.id.original
            if isinstance(original, bpy.types.NodeTree) and original.is_embedded_data:
                continue  # its owner is named too, which may be a light
            if isinstance(original, _SURFACE_TYPES):
                self._materials = None
                if self.images.forget_changed() or not isinstance(original, bpy.types.Material):
                    self._world = None
                if isinstance(original, bpy.types.Image):
                    self.images.forget(original.session_uid)
            elif update.is_updated_geometry or not isinstance(original, bpy.types.Object):
                changed.add(original.session_uid)
        self._meshes = {key: read for key, read in self._meshes.items() if not read.uids & changed}

    def forget(self) -> None:
        """After what comes without updates: undoing replaces everything."""
        self._meshes, self._materials, self._world = {}, None, None
        self._announced, self._announced_before, self.large_name = set(), set(), ""
        self.images.forget_changed()

    def begin(self, budget_s: float = float("inf")) -> None:
        """Before some steps of a `SceneReading`: how long they may take. At least one mesh or image is read."""
        self._deadline_s = time.perf_counter() + budget_s
        self._has_read = False

    def host_work(self) -> HostWork | None:
        """What reading has to wait for, once: after `OutOfTimeError`."""
        return self.images.host_work()

    @property
    def is_over(self) -> bool:
        """The time is."""
        return time.perf_counter() > self._deadline_s

    def note_used(self, keys: set[Hashable]) -> None:
        """A walk has met these and no others: what neither this one nor the one before met has gone. Two viewports may take turns."""
        kept = keys | self._used
        self._meshes = {key: read for key, read in self._meshes.items() if key in kept}
        self._used = keys
        # what was told of may have gone before it was read, or another viewport may wait at it still
        self._announced, self._announced_before, self.large_name = set(), self._announced, ""

    def find(self, key: Hashable, name: str, corner_count: int) -> ReadMesh | None:
        """OutOfTimeError if there is nothing and no time to read it, or it is large and has not been told of. name: of the object"""
        read = self._meshes.get(key)
        if read is None:
            if corner_count >= LARGE_MESH_CORNERS and key not in self._announced | self._announced_before:
                self._announced.add(key)
                self.large_name = name
                raise OutOfTimeError
            self._begin_reading()
        return read

    def _begin_reading(self) -> None:
        if self._has_read and self.is_over:
            raise OutOfTimeError
        self._has_read = True

    def keep(self, key: Hashable, read: ReadMesh) -> None:
        self.read_count += 1
        self.large_name = ""
        self._announced.discard(key)
        self._announced_before.discard(key)
        self._meshes[key] = read

    def material_readers(self, engine: str, override: bpy.types.Material | None) -> MaterialReaders:
        """Those that know what they have read, as long as no material and no image has changed, come or gone."""
        uids = (*(one.session_uid for one in bpy.data.materials), *(one.session_uid for one in bpy.data.images))
        # of packing no update tells
        world_key = engine, tuple(one.session_uid for one in bpy.data.images if one.packed_file)
        key = (world_key, None if override is None else override.session_uid, uids)
        if self._materials is None or self._materials[0] != key:
            known = self._world[1] if self._world is not None and self._world[0] == world_key else None
            self._materials = key, MaterialReaders.make(engine, override, self.images, known)
            self._world = world_key, self._materials[1].world
        return self._materials[1]
