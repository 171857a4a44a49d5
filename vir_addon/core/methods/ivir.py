"""Improved view-independent rasterization (Gavane & Watson 2022; preprint 2020): triangles become points once, views replay them.

`buffered`: points go into a buffer that every batch of views replays. A buffer too small for all of them is used in
portions, each generated again for each batch. `bufferless`: every batch generates the points and splats them as they come.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from ...device.declaration import ComputeDeclaration
from ...device.interface import EMPTY_DEPTH_BITS, LINEAR_TEXTURE_WIDTH, Device, Texture, TextureFormat
from ..errors import DeviceError
from ..fit import FittedFace, box_corners, light_hull
from ..passes.scene_data import WORK_GROUP_SIZE, SceneData
from ..passes.shadow_maps import (
    BUFFER_TILES,
    BUFFER_TRIANGLES,
    CUT_PARTS,
    KEEP_SEEN_POINTS,
    MAX_BATCH_VIEWS,
    SPLAT_POINTS,
    SPLAT_TILES,
    SPLAT_TRIANGLES,
    DepthMaps,
)
from ..scene import Light
from ..settings import PointStorage, Settings
from ..views import FaceViews
from .base import DepthMapMethod


class Releasable(Protocol):
    def release(self) -> None: ...


Resource = TypeVar("Resource", bound=Releasable)

TILE_CELLS = 8
MAX_SMALL_CELLS = 32
"""both as in generate_points.comp.glsl"""
TEXELS_PER_TILE = 2
"""of a part as well"""
WORTHWHILE_SHARE_KEPT = 0.8
"""Kept points are in the order in which invocations finished, which costs the maps' locality: replaying 95 % of them took 18 % longer."""
MAX_CUTS = 6
"""A part that touches the light asks for any number of points; six cuts into 8 x 8 make enough."""
BYTES_PER_POINT = 16
FIRST_TILE_CAPACITY = 1 << 15
FIRST_PART_CAPACITY = 1 << 13


def seen_space_planes(views: FaceViews) -> tuple[np.ndarray, np.ndarray]:
    """Planes (6, 4) around everything that any view sees, and the tangents (4,) around all windows.

    What a view sees ends, at depth z, at a place linear in z. The outermost of these lines bulges inwards between its ends, so the
    plane through the outermost places at the nearest and the farthest depth bounds all views, and exactly at both ends.
    """
    windows = np.array([views.window_tangents(k) for k in range(views.view_count)])
    centers = views.centers_fs
    # a window's side is at centre + slope * (z - centre's z), for suns at centre + shear * z + side
    shears = views.samples_m if views.is_orthographic else None
    near, far = centers[:, 2].min() + views.near_m, centers[:, 2].max() + views.far_m
    planes = np.zeros((6, 4))
    for side in range(4):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        ends = []
        for z in (near, far):
            aside = windows[:, side] * (z - centers[:, 2]) if shears is None else shears[:, axis] * z + windows[:, side]
            ends.append((sign * (centers[:, axis] + aside)).min())
        slope = (ends[1] - ends[0]) / (far - near)
        planes[side, axis] = sign
        planes[side, 2:] = -slope, ends[0] - slope * near
    planes[4, 2:], planes[5, 2:] = (1, near), (-1, -far)
    return planes, np.array([windows[:, 0].min(), windows[:, 1].max(), windows[:, 2].min(), windows[:, 3].max()])


class _LinearStore:
    """A growing device array; its content is lost when it grows."""

    def __init__(self, device: Device, texel_count: int) -> None:
        self.device = device
        self._create(texel_count)

    def reserve(self, texel_count: int) -> None:
        self.texture.release()
        self._create(texel_count)

    def _create(self, texel_count: int) -> None:
        rows = max(1, -(-texel_count // LINEAR_TEXTURE_WIDTH))
        if rows > self.device.max_texture_size_px:
            raise DeviceError(f"{texel_count} texels exceed the device's largest texture; choose a smaller map resolution")
        self.texture: Texture = self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, TextureFormat.RGBA32F)
        self.texel_count = rows * LINEAR_TEXTURE_WIDTH

    def replace_by(self, other: _LinearStore) -> None:
        self.texture.release()
        self.texture, self.texel_count = other.texture, other.texel_count

    def release(self) -> None:
        self.texture.release()


class PointScratch:
    """What all faces of all lights use in turn: lists that live while points are made, and the budget for points that are kept.

    The budget is `Settings.point_buffer_mib` for all lights together. Points that do not fit beside those of other faces push out those
    used last before them, which are made again when their turn comes: faces take turns, so those used longest ago are needed next.
    """

    def __init__(self, device: Device, settings: Settings) -> None:
        self.counters = device.create_texture(4, 1, TextureFormat.R32UI)
        self.tiles = _LinearStore(device, TEXELS_PER_TILE * FIRST_TILE_CAPACITY)
        self.parts = _LinearStore(device, TEXELS_PER_TILE * FIRST_PART_CAPACITY)
        self.capacity = settings.point_buffer_mib * (1 << 20) // BYTES_PER_POINT
        """points"""
        self._keepers: list[ImprovedViewIndependentRasterization] = []
        """those whose points are on the device, the one used last at the end"""

    def touch(self, keeper: ImprovedViewIndependentRasterization) -> None:
        """Note that a face's points are in use, and let go of those of others beyond the budget."""
        self.forget(keeper)
        self._keepers.append(keeper)
        while len(self._keepers) > 1 and sum(each.points.texel_count for each in self._keepers) > self.capacity:
            self._keepers.pop(-2).drop_points()

    def forget(self, keeper: ImprovedViewIndependentRasterization) -> None:
        if keeper in self._keepers:
            self._keepers.remove(keeper)

    def release(self) -> None:
        for store in (self.counters, self.tiles, self.parts):
            store.release()


@dataclass(frozen=True)
class _Portion:
    """Work groups whose points are in the buffer together; if even one group has too many, so many of its tiles at once."""

    first_group: int
    group_count: int
    tiles_at_once: int = 0
    """0: all"""


class ImprovedViewIndependentRasterization(DepthMapMethod):
    def __init__(
        self,
        scene_data: SceneData,
        fitted: FittedFace,
        face_table: np.ndarray,
        culled: np.ndarray,
        light: Light,
        samples_m: np.ndarray,
        settings: Settings,
        storage: PointStorage,
        scratch: PointScratch,
    ) -> None:
        super().__init__(scene_data, fitted, face_table, culled)
        self.settings, self.storage, self.scratch = settings, storage, scratch
        self.counters, self.tiles, self.parts = scratch.counters, scratch.tiles, scratch.parts
        rotation = fitted.views.face.face_from_world
        hull_fs = (light_hull(light, samples_m) - fitted.views.origin_ws) @ rotation.T
        if fitted.views.is_orthographic:
            hull_fs = box_corners(samples_m)
        planes, bounds = seen_space_planes(fitted.views)
        farthest = np.maximum(np.abs(bounds[0::2]), np.abs(bounds[1::2]))
        hull_box = np.zeros((2, 4))
        hull_box[:, :3] = (hull_fs.max(axis=0) + hull_fs.min(axis=0)) / 2, (hull_fs.max(axis=0) - hull_fs.min(axis=0)) / 2
        hull_box[0, 3] = 1 / np.sqrt(1 + (farthest**2).sum())
        self.sampling_bindings = {
            **scene_data.bindings,
            "face": face_table,
            "hull": np.pad(hull_fs, ((0, 0), (0, 1))),
            "hull_count": len(hull_fs),
            "hull_box": hull_box,
            "seen_space": planes,
            "window_bounds": bounds,
        }
        self.sampling_flags = ["WATERTIGHT"] * settings.watertight + ["STOCHASTIC_CULLING"] * settings.stochastic_culling
        self.sampling_flags += self.projection_flags
        self.splat_flags = ["NEAR_SURFACES"] * (fitted.nearest_caster_m < fitted.views.light_diameter_m)
        self.splat_flags += ["FRONT_FACE"] * fitted.views.is_planar + self.projection_flags
        self.culled_triangle_count = 0
        self.tile_count = 0
        self.buffered_point_count = 0
        self.kept_point_count = 0
        self._portions: list[_Portion] = []
        self._has_points = self._was_dropped = False
        self._cleanup = contextlib.ExitStack()

    def _owned(self, resource: Resource) -> Resource:
        self._cleanup.callback(resource.release)
        return resource

    def prepare(self) -> None:
        self.device.run(self._prepare)

    def _prepare(self) -> None:
        self.work = self._owned(self.scene_data.work_table(self.fitted.caster_indices, ~self.culled))
        if self.storage is PointStorage.BUFFERED:
            self._make_points()

    def _make_points(self) -> None:
        self.points = _LinearStore(self.device, min(self.scratch.capacity, max(1 << 18, 4 * self.work.triangle_count)))
        self._has_points = True
        self.portion_count = 1
        self._portions = self._plan_portions()
        self.scratch.touch(self)

    def drop_points(self) -> None:
        """Give the buffer's memory back; `fill` makes the points again."""
        self.points.release()
        self._has_points, self._was_dropped = False, True
        self.kept_point_count = 0

    # buffered

    def _plan_portions(self) -> list[_Portion]:
        """Ranges of work groups whose points fit into the buffer; a single range's points are in it afterwards."""
        pending, portions, total, culled = [_Portion(0, self.work.group_count)], [], 0, 0
        while pending:
            portion = pending.pop()
            points, culled_here = self._generate_into_buffer(portion)
            if points > self.points.texel_count and points <= self.scratch.capacity:
                self.points.reserve(points)
                points, culled_here = self._generate_into_buffer(portion)
            first, count = portion.first_group, portion.group_count
            if points > self.points.texel_count and count > 1:
                half = count // 2
                pending += [_Portion(first + half, count - half), _Portion(first, half)]
                continue
            if points > self.points.texel_count:
                # a few large triangles that fill the buffer many times over
                self.points.reserve(self.scratch.capacity)
                room = self.points.texel_count - WORK_GROUP_SIZE * MAX_SMALL_CELLS
                portion = _Portion(first, count, tiles_at_once=room // TILE_CELLS**2)
                self.portion_count += -(-self.tile_count // portion.tiles_at_once) - 1
            portions.append(portion)
            total, culled = total + points, culled + culled_here
        self.portion_count += len(portions) - 1
        self.point_count, self.culled_triangle_count = total, culled
        return portions

    def _generate_into_buffer(self, portion: _Portion) -> tuple[int, int]:
        """Returns how many points there are (more than the buffer holds: the rest is lost) and triangles culled."""
        outputs = {"points": self.points.texture, "point_capacity": self.points.texel_count}
        self._run_triangles(BUFFER_TRIANGLES, portion.first_group, portion.group_count, **outputs)
        self._run_tiles(BUFFER_TILES, 0, self.tile_count, **outputs)
        counters = self.device.read(self.counters)[0]
        self.buffered_point_count = int(counters[0])
        return int(counters[0]), int(counters[2])

    def _buffer_fillings(self) -> Iterator[None]:
        """Yields every time the buffer holds `buffered_point_count` points to replay, until all points had their turn."""
        if len(self._portions) == 1 and not self._portions[0].tiles_at_once:
            yield
            return
        for portion in self._portions:
            if not portion.tiles_at_once:
                self._generate_into_buffer(portion)
                yield
                continue
            outputs = {"points": self.points.texture, "point_capacity": self.points.texel_count}
            self._run_triangles(BUFFER_TRIANGLES, portion.first_group, portion.group_count, **outputs)
            # tiles come in another order each time they are found, so they are counted off within one finding
            for first_tile in range(0, self.tile_count, portion.tiles_at_once):
                if first_tile:
                    self.device.fill(self.counters, 0)
                self._run_tiles(BUFFER_TILES, first_tile, min(portion.tiles_at_once, self.tile_count - first_tile), **outputs)
                self.buffered_point_count = int(self.device.read(self.counters)[0, 0])
                yield

    def _run_triangles(self, declaration: ComputeDeclaration, first_group: int, group_count: int, **outputs: Any) -> None:
        kernel = self.device.compute_kernel(declaration, *self._flags_of(declaration))
        while True:
            self.device.fill(self.counters, 0)
            kernel.dispatch_linear(
                group_count * kernel.declaration.local_size[0],
                **self.sampling_bindings,
                **outputs,
                work_table=self.work.texture,
                first_group=first_group,
                group_count=group_count,
                counters=self.counters,
                parts=self.parts.texture,
                part_capacity=self.parts.texel_count // TEXELS_PER_TILE,
            )
            if self._cut_parts():
                return

    def _cut_parts(self) -> bool:
        """Cut parts until only tiles are left. False when a list was too small: it has grown, and its content is lost."""
        kernel = self.device.compute_kernel(CUT_PARTS, *self.sampling_flags)
        done = 0
        for cut in range(MAX_CUTS + 1):
            _, self.tile_count, _, part_count = (int(count) for count in self.device.read(self.counters)[0])
            fits = [self._fits(store, count) for store, count in ((self.tiles, self.tile_count), (self.parts, part_count))]
            if not all(fits):
                return False
            if part_count == done:
                break
            kernel.dispatch_linear(
                part_count - done,
                **self.sampling_bindings,
                counters=self.counters,
                parts=self.parts.texture,
                tiles=self.tiles.texture,
                first_part=done,
                part_count=part_count - done,
                part_capacity=self.parts.texel_count // TEXELS_PER_TILE,
                tile_capacity=self.tiles.texel_count // TEXELS_PER_TILE,
                may_leave_parts=int(cut < MAX_CUTS - 1),
            )
            done = part_count
        return True

    @staticmethod
    def _fits(store: _LinearStore, count: int) -> bool:
        if TEXELS_PER_TILE * count <= store.texel_count:
            return True
        store.reserve(TEXELS_PER_TILE * 2 * count)
        return False

    def _flags_of(self, declaration: ComputeDeclaration) -> list[str]:
        return sorted({*self.sampling_flags, *(self.splat_flags if "depth_maps" in declaration.images else ())})

    def _run_tiles(self, declaration: ComputeDeclaration, first_tile: int, tile_count: int, **outputs: Any) -> None:
        self.device.compute_kernel(declaration, *self._flags_of(declaration)).dispatch_linear(
            tile_count * TILE_CELLS,
            **self.sampling_bindings,
            **outputs,
            tile_list=self.tiles.texture,
            first_tile=first_tile,
            tile_count=tile_count,
            counters=self.counters,
        )

    # batches

    def fill(self, maps: DepthMaps, selected: range) -> None:
        self.device.run(self._fill, maps, selected)

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        self.device.fill(maps.texture, EMPTY_DEPTH_BITS)
        outputs = {"depth_maps": maps.texture, "views": self.views_table(selected), "view_count": len(selected)}
        if self.storage is PointStorage.BUFFERED:
            if self._has_points:
                self.scratch.touch(self)
            else:
                self._make_points()
        if self.storage is PointStorage.BUFFERLESS:
            self._run_triangles(SPLAT_TRIANGLES, 0, self.work.group_count, **outputs)
            self._run_tiles(SPLAT_TILES, 0, self.tile_count, **outputs)
            counters = self.device.read(self.counters)[0]
            self.point_count, self.culled_triangle_count = int(counters[0]), int(counters[2])
            return
        for _ in self._buffer_fillings():
            self.device.compute_kernel(SPLAT_POINTS, *self.splat_flags).dispatch_linear(
                self.buffered_point_count,
                **outputs,
                face=self.face_table,
                points=self.points.texture,
                point_count=self.buffered_point_count,
            )
        if self._may_cull_hidden_points(selected):
            self._keep_seen_points(maps, selected)

    def _may_cull_hidden_points(self, selected: range) -> bool:
        """Once, after a batch large enough to stand for all views, and only if there is something left to gain."""
        return (
            self.settings.cull_hidden_points
            and self.kept_point_count == 0
            and self.portion_count == 1
            # points that are made again for every batch would be searched every time
            and not self._was_dropped
            and len(selected) == MAX_BATCH_VIEWS < self.fitted.views.view_count
        )

    def _keep_seen_points(self, maps: DepthMaps, selected: range) -> None:
        kept = _LinearStore(self.device, self.buffered_point_count)
        self.device.fill(self.counters, 0)
        self.device.compute_kernel(KEEP_SEEN_POINTS, *self.projection_flags).dispatch_linear(
            self.buffered_point_count,
            points=self.points.texture,
            depth_maps=maps.texture,
            kept_points=kept.texture,
            counters=self.counters,
            views=self.views_table(selected),
            view_count=len(selected),
            face=self.face_table,
            point_count=self.buffered_point_count,
        )
        self.kept_point_count = int(self.device.read(self.counters)[0, 0])
        if self.kept_point_count > WORTHWHILE_SHARE_KEPT * self.buffered_point_count:
            kept.release()
            self.kept_point_count = self.buffered_point_count
            return
        self.points.replace_by(kept)
        self.buffered_point_count = self.kept_point_count

    def release(self) -> None:
        self.scratch.forget(self)
        if self._has_points:
            self.drop_points()
        self._cleanup.close()
