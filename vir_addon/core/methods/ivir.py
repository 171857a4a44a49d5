"""Improved view-independent rasterization (Gavane & Watson 2022; preprint 2020): triangles become points once, views replay them.

`buffered`: points go into a buffer that every batch of views replays. A buffer too small for all of them is used in
portions, each generated again for each batch. `bufferless`: every batch generates the points and splats them as they come.
"""

from __future__ import annotations

import contextlib
from typing import Any, Protocol, TypeVar

import numpy as np

from ...device.declaration import ComputeDeclaration
from ...device.interface import EMPTY_DEPTH_BITS, LINEAR_TEXTURE_WIDTH, Device, Texture, TextureFormat
from ..errors import DeviceError
from ..fit import FittedFace, light_hull
from ..passes.scene_data import SceneData
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
TEXELS_PER_TILE = 2
"""of a part as well"""
MAX_CUTS = 6
"""A part that touches the light asks for any number of points; six cuts into 8 x 8 make enough."""
BYTES_PER_POINT = 16
FIRST_TILE_CAPACITY = 1 << 15
FIRST_PART_CAPACITY = 1 << 13


def seen_space_planes(views: FaceViews, hull_fs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes (6, 4) around everything that any view sees, and the tangents (4,) around all windows.

    A plane through a view's centre with the window's outermost tangent is linear in the centre, so the outermost of the
    hull's corners bounds all views.
    """
    windows = np.array([views.window_tangents(k) for k in range(views.view_count)])
    left, right, bottom, top = windows[:, 0].min(), windows[:, 1].max(), windows[:, 2].min(), windows[:, 3].max()
    normals = np.array([[1, 0, -left], [-1, 0, right], [0, 1, -bottom], [0, -1, top], [0, 0, 1], [0, 0, -1]], np.float64)
    offsets = (normals @ hull_fs.T).min(axis=1) + np.array([0, 0, 0, 0, views.near_m, -views.far_m])
    return np.concatenate([normals, offsets[:, None]], axis=1), np.array([left, right, bottom, top])


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
    ) -> None:
        super().__init__(scene_data, fitted, face_table, culled)
        self.settings, self.storage = settings, storage
        rotation = fitted.views.face.face_from_world
        hull_fs = (light_hull(light, samples_m) - light.world_from_light[:3, 3]) @ rotation.T
        planes, bounds = seen_space_planes(fitted.views, hull_fs)
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
        self.splat_flags = ["NEAR_SURFACES"] * (fitted.nearest_caster_m < fitted.views.light_diameter_m)
        self.splat_flags += ["FRONT_FACE"] * (fitted.views.face.index == 0)
        self.culled_triangle_count = 0
        self.tile_count = 0
        self.buffered_point_count = 0
        self.kept_point_count = 0
        self._portions: list[tuple[int, int]] = []
        self._cleanup = contextlib.ExitStack()

    def _owned(self, resource: Resource) -> Resource:
        self._cleanup.callback(resource.release)
        return resource

    def prepare(self) -> None:
        self.device.run(self._prepare)

    def _prepare(self) -> None:
        self.work = self._owned(self.scene_data.work_table(self.fitted.caster_indices, ~self.culled))
        self.counters = self._owned(self.device.create_texture(4, 1, TextureFormat.R32UI))
        self.tiles = self._owned(_LinearStore(self.device, TEXELS_PER_TILE * FIRST_TILE_CAPACITY))
        self.parts = self._owned(_LinearStore(self.device, TEXELS_PER_TILE * FIRST_PART_CAPACITY))
        if self.storage is PointStorage.BUFFERED:
            self.capacity_limit = self.settings.point_buffer_mib * (1 << 20) // BYTES_PER_POINT
            self.points = self._owned(_LinearStore(self.device, min(self.capacity_limit, max(1 << 18, 4 * self.work.triangle_count))))
            self._portions = self._plan_portions()
            self.portion_count = len(self._portions)

    # buffered

    def _plan_portions(self) -> list[tuple[int, int]]:
        """Ranges of work groups whose points fit into the buffer; the last range's points are in it afterwards."""
        pending, fitting, total, culled = [(0, self.work.group_count)], [], 0, 0
        while pending:
            first, count = pending.pop()
            points, culled_here = self._generate_into_buffer(first, count)
            if points > self.points.texel_count and points <= self.capacity_limit:
                self.points.reserve(points)
                points, culled_here = self._generate_into_buffer(first, count)
            if points <= self.points.texel_count:
                fitting.append((first, count))
                total, culled = total + points, culled + culled_here
            elif count == 1:
                raise DeviceError(
                    f"{points} points of {self.work.triangle_count} triangles do not fit into the point buffer of "
                    f"{self.settings.point_buffer_mib} MiB; use bufferless points or the method mvr"
                )
            else:
                half = count // 2
                pending += [(first + half, count - half), (first, half)]
        self.point_count, self.culled_triangle_count = total, culled
        return fitting

    def _generate_into_buffer(self, first_group: int, group_count: int) -> tuple[int, int]:
        """Returns how many points there are (more than the buffer holds: the rest is lost) and triangles culled."""
        self._run_triangles(BUFFER_TRIANGLES, first_group, group_count, points=self.points.texture, point_capacity=self.points.texel_count)
        self._run_tiles(BUFFER_TILES, points=self.points.texture, point_capacity=self.points.texel_count)
        counters = self.device.read(self.counters)[0]
        self.buffered_point_count = int(counters[0])
        return int(counters[0]), int(counters[2])

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
            fits = [
                self._fits(store, count) for store, count in ((self.tiles, self.tile_count), (self.parts, part_count))
            ]
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
        return self.sampling_flags + self.splat_flags if "depth_maps" in declaration.images else self.sampling_flags

    def _run_tiles(self, declaration: ComputeDeclaration, **outputs: Any) -> None:
        self.device.compute_kernel(declaration, *self._flags_of(declaration)).dispatch_linear(
            self.tile_count * TILE_CELLS,
            **self.sampling_bindings,
            **outputs,
            tile_list=self.tiles.texture,
            tile_count=self.tile_count,
            counters=self.counters,
        )

    # batches

    def fill(self, maps: DepthMaps, selected: range) -> None:
        self.device.run(self._fill, maps, selected)

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        self.device.fill(maps.texture, EMPTY_DEPTH_BITS)
        outputs = {"depth_maps": maps.texture, "views": self.views_table(selected), "view_count": len(selected)}
        if self.storage is PointStorage.BUFFERLESS:
            self._run_triangles(SPLAT_TRIANGLES, 0, self.work.group_count, **outputs)
            self._run_tiles(SPLAT_TILES, **outputs)
            counters = self.device.read(self.counters)[0]
            self.point_count, self.culled_triangle_count = int(counters[0]), int(counters[2])
            return
        for first, count in self._portions:
            if len(self._portions) > 1:
                self._generate_into_buffer(first, count)
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
            and len(self._portions) == 1
            and len(selected) == MAX_BATCH_VIEWS < self.fitted.views.view_count
        )

    def _keep_seen_points(self, maps: DepthMaps, selected: range) -> None:
        kept = _LinearStore(self.device, self.buffered_point_count)
        self.device.fill(self.counters, 0)
        self.device.compute_kernel(KEEP_SEEN_POINTS).dispatch_linear(
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
        self.points.replace_by(kept)
        self.kept_point_count = self.buffered_point_count = int(self.device.read(self.counters)[0, 0])

    def release(self) -> None:
        self._cleanup.close()
