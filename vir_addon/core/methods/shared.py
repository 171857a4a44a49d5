"""What all faces of all lights share while a frame is rendered: the memory for what is replayed, and lists that live while it is made."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple, Protocol

from ...device.interface import Device, TextureFormat
from ...device.owned import Owned
from ..passes.points import LATTICE_VIEWPORT_PX, PARTS_OF_A_SLIVER
from ..passes.scene_data import WORK_GROUP_SIZE
from ..settings import Settings
from .linear_store import LinearStore

TEXELS_PER_TILE = TEXELS_PER_PART = 2
TEXELS_PER_SPLAT = 2
TILE_CAPACITY = 1 << 15
"""Tiles that become points in one step: up to two million points."""
FIRST_PART_CAPACITY = 1 << 15
MOST_PART_CAPACITY = 2 * WORK_GROUP_SIZE * PARTS_OF_A_SLIVER
"""Half of it holds what the triangles of a work group may become; the other half, halved by every cut, is room for more than one part to
be cut."""
SOURCE_PART_PX = 2048
"""The source view of `vwss` is drawn in parts of at most so many texels each way: it may be larger than a viewport."""


class ReplayKeeper(Protocol):
    """A face's method that keeps something on the device from batch to batch, and can make it again."""

    @property
    def held_bytes(self) -> int: ...

    def drop(self) -> None:
        """Give the memory back."""


class Counts(NamedTuple):
    """In the order of COUNTERS in core/passes/points.py."""

    points: int = 0
    tiles: int = 0
    culled_triangles: int = 0
    parts: int = 0
    """or large triangles, where these are listed"""
    splats: int = 0


class Counters:
    """What kernels count. Counters of 32 bits go round where lights touch walls: read before they do, they count on."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.texture = device.create_texture(len(Counts._fields), 1, TextureFormat.R32UI)
        self.last = Counts()
        """as last read, which no device has to be waited for"""

    def clear(self) -> None:
        self.device.fill(self.texture, 0)
        self.last = Counts()

    def read(self) -> Counts:
        """All that was counted since they were cleared."""
        counted = (int(count) for count in self.device.read(self.texture)[0])
        self.last = Counts(*(last + (now - last) % (1 << 32) for now, last in zip(counted, self.last, strict=True)))
        return self.last

    def release(self) -> None:
        self.texture.release()


class PointScratch:
    """Lists of `ivir` that live while points are made."""

    def __init__(self, device: Device) -> None:
        with Owned() as owned:
            self.counters = owned.own(Counters(device))
            self.tiles = owned.own(LinearStore(device, TEXELS_PER_TILE * TILE_CAPACITY))
            self.parts = owned.own(LinearStore(device, TEXELS_PER_PART * FIRST_PART_CAPACITY))
            self._owned = owned.pop_all()

    def release(self) -> None:
        self._owned.close()


class UnseenTarget:
    """What the rasterizer draws into where nobody looks at it: what counts is what fragments store."""

    def __init__(self, device: Device, side_px: int) -> None:
        with Owned() as owned:
            color = owned.own(device.create_texture(side_px, side_px, TextureFormat.R32UI))
            depth = owned.own(device.create_texture(side_px, side_px, TextureFormat.DEPTH32F))
            self.target = owned.own(device.create_target(color, depth))
            self._owned = owned.pop_all()

    def release(self) -> None:
        self._owned.close()


class SharedByFaces:
    """`Settings.replay_buffer_mib` is for all lights together. What does not fit beside what other faces keep is a guest: let go of when
    the next face's turn comes, and made again in its own. Faces take turns: would it push out others, these would be made again, too."""

    def __init__(self, device: Device, settings: Settings) -> None:
        self.device = device
        self.budget_bytes = settings.replay_buffer_mib << 20
        self._keepers: list[ReplayKeeper] = []
        """those that hold something"""
        self._guest: ReplayKeeper | None = None

    @cached_property
    def point_scratch(self) -> PointScratch:
        return PointScratch(self.device)

    @cached_property
    def source_target(self) -> UnseenTarget:
        """of `vwss`"""
        return UnseenTarget(self.device, SOURCE_PART_PX)

    @cached_property
    def lattice_target(self) -> UnseenTarget:
        """of `ivir` with points from the rasterizer"""
        return UnseenTarget(self.device, LATTICE_VIEWPORT_PX)

    def begin_turn(self, keeper: ReplayKeeper) -> None:
        """Before a face's memory is made or used: let go of that of a guest, unless others have left it room."""
        guest = self._guest
        if guest is not None and guest is not keeper:
            is_over_budget = self._is_over_budget
            self.forget(guest)
            if is_over_budget:
                guest.drop()
            else:
                self._keepers.append(guest)

    def touch(self, keeper: ReplayKeeper) -> None:
        """Note that a face's memory is in use."""
        self.begin_turn(keeper)
        self.forget(keeper)
        self._keepers.append(keeper)
        if self._is_over_budget:
            self._guest = keeper

    @property
    def _is_over_budget(self) -> bool:
        return sum(each.held_bytes for each in self._keepers) > self.budget_bytes

    def forget(self, keeper: ReplayKeeper) -> None:
        if keeper in self._keepers:
            self._keepers.remove(keeper)
        if keeper is self._guest:
            self._guest = None

    def release(self) -> None:
        for name in ("point_scratch", "source_target", "lattice_target"):
            if name in self.__dict__:
                self.__dict__[name].release()
