"""Triangles that are too large to be replayed one by one: culled and placed once for all views, drawn by the hardware rasterizer."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np

from ...device.interface import DeviceMesh, Draw, RasterKernel
from ...device.owned import Owned
from ..passes.shadow_maps import RASTERIZE_DEPTH, DepthMaps
from ..steps import compiling_raster
from .base import DepthMapMethod
from .linear_store import LinearStore

TEXELS_PER_TRIANGLE = 3
BYTES_PER_TRIANGLE = 48
DEPTH_STEPS = 1 << 16
"""that an instance's triangles are sorted by; within one of them the order does not matter"""
FINGERPRINT_BITS = 24


@dataclass(frozen=True)
class _PlacedTriangles:
    """Of one list, on the device, instance by instance."""

    mesh: DeviceMesh
    instances: np.ndarray
    """(n,) int64 instance numbers"""
    first: np.ndarray
    """(n,) int64: the first triangle of each"""
    count: np.ndarray
    """(n,) int64: how many each has"""

    def draws(self, seen: np.ndarray, culled: np.ndarray) -> Iterator[Draw]:
        """seen, culled: (instance_count,) bool, which instances to draw and which without back faces. Neighbours share a draw."""
        chosen = seen[self.instances]
        first, count, cull = self.first[chosen], self.count[chosen], culled[self.instances[chosen]]
        starts = np.flatnonzero(np.r_[True, (first[1:] != first[:-1] + count[:-1]) | (cull[1:] != cull[:-1])])
        if len(first):
            for start, triangle_count in zip(starts, np.add.reduceat(count, starts), strict=True):
                triangle_range = (int(first[start]), int(triangle_count))
                yield Draw(self.mesh, 1, {"first_instance": 0}, bool(cull[start]), triangle_range)


def _front_to_back(triangles: np.ndarray, instance: np.ndarray) -> np.ndarray:
    """(n,) int64 order of drawing in which instances stay together: most of what is hidden is then found so before it is shaded.

    Kernels list triangles in any order, and where two are equally deep the rasterizer keeps the first: the order hangs on the corners
    alone. triangles: (n, 3, 3) float32 corners, face space
    """
    depth_m = triangles[:, :, 2].min(axis=1)
    nearest_m = np.full(int(instance.max()) + 1, np.inf, np.float32)
    np.minimum.at(nearest_m, instance, depth_m)
    rank = np.empty(len(nearest_m), np.uint64)
    rank[np.argsort(nearest_m, kind="stable")] = np.arange(len(nearest_m), dtype=np.uint64)
    first_m, last_m = float(depth_m.min()), float(depth_m.max())
    step = ((depth_m - first_m) * ((DEPTH_STEPS - 1) / max(last_m - first_m, 1e-30))).astype(np.uint64)
    # one number for sorting: comparing three arrays takes five times as long
    return np.argsort((rank[instance] * DEPTH_STEPS + step) << np.uint64(FINGERPRINT_BITS) | _fingerprints(triangles))


def _fingerprints(triangles: np.ndarray) -> np.ndarray:
    """(n,) uint64 of FINGERPRINT_BITS bits, the same for the same corners; triangles: (n, 3, 3) float32"""
    bits = np.ascontiguousarray(triangles).view(np.uint32).reshape(-1, 9)
    factors = np.random.default_rng(20220).integers(0, 1 << 32, 9, dtype=np.uint32) | np.uint32(1)
    return (np.einsum("ij,j->i", bits, factors) >> np.uint32(32 - FINGERPRINT_BITS)).astype(np.uint64)


class LargeTriangles:
    """The large triangles of a face."""

    def __init__(self, method: DepthMapMethod) -> None:
        self.method = method
        self._owned = Owned()
        self._lists: list[_PlacedTriangles] = []

    @property
    def triangle_count(self) -> int:
        return sum(placed.mesh.triangle_count for placed in self._lists)

    def add(self, store: LinearStore, first_texel: int, count: int) -> None:
        """Take over `count` triangles from a list of a kernel: three texels each, corners in face space, w: instance."""
        if not count:
            return
        texel_count = TEXELS_PER_TRIANGLE * count
        with Owned() as temporary:
            part = temporary.own(store.copied(first_texel, texel_count))
            triangles = self.method.device.read(part.texture).reshape(-1, 4)[:texel_count].reshape(count, 3, 4)
        instance = triangles[:, 0, 3].astype(np.int64)
        order = _front_to_back(triangles[:, :, :3], instance)
        corners = triangles[order][:, :, :3].reshape(-1, 3)
        mesh = self._owned.own(self.method.device.upload_mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3)))
        first = np.flatnonzero(np.diff(instance[order], prepend=-1))
        self._lists.append(_PlacedTriangles(mesh, instance[order][first], first, np.diff(first, append=count)))

    def compiling(self) -> Generator[None, None, RasterKernel]:
        """What draws them, in steps."""
        return compiling_raster(self.method.device, RASTERIZE_DEPTH, "PLACED", *self.method.raster_flags)

    def rasterize(self, maps: DepthMaps, selected: range, views: np.ndarray) -> None:
        """Draw those of the instances that each view needs.

        views: rows of `views_table` of the selected views.
        """
        method = self.method
        kernel = method.device.raster_kernel(RASTERIZE_DEPTH, "PLACED", *method.raster_flags)
        for index, seen, viewport in method.maps_to_draw(selected):
            is_seen = np.zeros(len(method.culled), bool)
            is_seen[seen] = True
            draws = [draw for placed in self._lists for draw in placed.draws(is_seen, method.culled)]
            bindings = {"instances": method.scene_data.instances, "face": method.face_table, "views": views, "view_index": index}
            kernel.draw(maps.target, viewport, draws, **bindings)

    def release(self) -> None:
        self._owned.close()
        self._lists = []
