"""View-warped soft shadows (Marrs et al. 2018): all fragments of one view behind an area light are warped into the views of its points.

The source view is moved back from the light until it contains all views (eqs. 1, 2) and its texels shrink by as much (eq. 3), so that at
the nearest caster it samples as finely as they do. The hardware rasterizer makes the points, without a depth test: what is hidden from
the source view may be seen from a point of the light. `buffered`: fragments are kept and replayed for every batch of views;
`bufferless`: every batch draws the source view again and splats fragments as they come. Either serves `Settings.views_per_thread` maps
at a time. A surface that the source view sees more edge-on than another view does is sampled too sparsely for that one, which
`Settings.watertight` makes rarer and never impossible.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...device.interface import TextureFormat
from ..passes.points import BUFFER_FRAGMENTS, SPLAT_FRAGMENTS, SPLAT_POINTS
from ..passes.shadow_maps import DepthMaps
from ..settings import PointStorage
from ..views import FaceViews
from .base import FaceJob, ReplayMethod
from .ivir import BYTES_PER_POINT
from .linear_store import LinearStore
from .seen_space import window_bounds, windows_of_views
from .shared import SOURCE_PART_PX

FIRST_POINT_CAPACITY = 1 << 18
WATERTIGHT_OVERSAMPLING = 1.5
"""Texels away from outlines that stay empty, of a bumpy sphere, a furnished room and leaves: 0.6, 2.4 and 1.7 % with the published
resolution, 0.03, 0 and 0.05 % with texels smaller by this."""
MAX_FOOTPRINT_TEXELS = 16.0
TOUCHING_SHARE = 1 / 64
"""both as in the shaders: what is nearer to the light than its diameter is sampled as if it stood there, as by other points"""


@dataclass(frozen=True)
class _Part:
    """Of the source view, texels of the lattice that starts at tangent 0."""

    x: int
    y: int
    width: int
    height: int

    def halves(self) -> tuple[_Part, _Part]:
        if self.width >= self.height:
            half = self.width // 2
            return _Part(self.x, self.y, half, self.height), _Part(self.x + half, self.y, self.width - half, self.height)
        half = self.height // 2
        return _Part(self.x, self.y, self.width, half), _Part(self.x, self.y + half, self.width, self.height - half)


@dataclass(frozen=True)
class SourceView:
    eye_fs: np.ndarray
    """(3,) float64 face space"""
    texel_tangent: tuple[float, float]
    near_m: float
    far_m: float
    bounds_texels: tuple[int, int, int, int]
    """left, right, bottom, top on the lattice that starts at tangent 0"""

    @property
    def parts(self) -> list[_Part]:
        left, right, bottom, top = self.bounds_texels
        return [
            _Part(x, y, min(SOURCE_PART_PX, right - x), min(SOURCE_PART_PX, top - y))
            for y in range(bottom, top, SOURCE_PART_PX)
            for x in range(left, right, SOURCE_PART_PX)
        ]


def source_view(views: FaceViews, nearest_caster_m: float, is_watertight: bool) -> SourceView:
    """nearest_caster_m: depth before any view from which on the source view samples as finely as they do"""
    centers = views.centers_fs
    low, high = centers.min(axis=0), centers.max(axis=0)
    bounds = window_bounds(views)
    # eq. 1, with the windows' own fields of view
    half_tangent = max(bounds[1] - bounds[0], bounds[3] - bounds[2]) / 2
    back_m = float((high - low)[:2].max() / (2 * half_tangent))
    eye = np.array([*(low + high)[:2] / 2, low[2] - back_m])
    # the places where a window's sides are at the nearest and the farthest depth bound all that the view sees
    windows = windows_of_views(views)
    ends = []
    for depth in (views.near_m, views.far_m):
        sides = centers[:, [0, 0, 1, 1]] + windows * depth - eye[[0, 0, 1, 1]]
        ends.append(sides / (centers[:, 2:] + depth - eye[2]))
    tangents = np.concatenate(ends)
    nearest_m = max(nearest_caster_m, views.near_m, TOUCHING_SHARE * views.light_diameter_m)
    nearest_m = max(nearest_m, min(views.light_diameter_m, MAX_FOOTPRINT_TEXELS * nearest_m))
    # eq. 3
    shrinkage = nearest_m / (nearest_m + back_m) / (WATERTIGHT_OVERSAMPLING if is_watertight else 1.0)
    shrunk_x, shrunk_y = (tangent * shrinkage for tangent in views.texel_tangent)
    return SourceView(
        eye,
        (shrunk_x, shrunk_y),
        float(back_m + views.near_m),
        float(high[2] - eye[2] + views.far_m),
        (
            int(np.floor(tangents[:, 0].min() / shrunk_x)),
            int(np.ceil(tangents[:, 1].max() / shrunk_x)),
            int(np.floor(tangents[:, 2].min() / shrunk_y)),
            int(np.ceil(tangents[:, 3].max() / shrunk_y)),
        ),
    )


class ViewWarpedSoftShadows(ReplayMethod):
    def __init__(self, job: FaceJob, storage: PointStorage) -> None:
        super().__init__(job)
        self.storage = storage
        views = job.fitted.views
        self.source = source_view(views, job.fitted.nearest_caster_m, self.settings.watertight)
        self.capacity_limit = job.shared.budget_bytes // BYTES_PER_POINT
        self.splat_flags = ["NEAR_SURFACES"] * (job.fitted.nearest_caster_m < views.light_diameter_m)
        self.splat_flags += ["FRONT_FACE"] * views.is_planar
        self.point_count = 0
        self.buffered_point_count = 0
        self._portions: list[list[_Part]] = []

    def preparing(self) -> Generator[None, None, None]:
        self.draws = self.scene_data.draws(self.opaque_indices, None if self.settings.back_faces else self.culled)
        self.counters = self._owned.own(self.device.create_texture(1, 1, TextureFormat.R32UI))
        if self.storage is PointStorage.BUFFERED:
            yield from self._holding()

    def _making(self) -> Generator[None, None, None]:
        self.points = LinearStore(self.device, min(self.capacity_limit, FIRST_POINT_CAPACITY))
        self._is_held = True
        self._plan_portions()
        self.portion_count = len(self._portions)
        yield from ()

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_POINT * self.points.texel_count

    def _free(self) -> None:
        self.points.release()
        self._portions = []

    def _plan_portions(self) -> None:
        """Parts whose points fit into the buffer together; all of them, if they do."""
        self.point_count = self._buffer(self.source.parts)
        if self.points.texel_count < self.point_count <= self.capacity_limit:
            self.points.reserve(self.point_count)
            self._buffer(self.source.parts)
        if self.point_count <= self.points.texel_count:
            self._portions = [self.source.parts]
            return
        pending = self.source.parts[::-1]
        while pending:
            part = pending.pop()
            count = self._buffer([part])
            if self.points.texel_count < count <= self.capacity_limit:
                self.points.reserve(count)
            if count > self.points.texel_count and max(part.width, part.height) > 1:
                pending += part.halves()[::-1]
            elif count:
                self._portions.append([part])

    def _buffer(self, parts: list[_Part]) -> int:
        """Returns how many points there are; more than the buffer holds are lost."""
        self.device.fill(self.counters, 0)
        for part in parts:
            self._draw(part, BUFFER_FRAGMENTS, counters=self.counters, points=self.points.texture, texel_capacity=self.points.texel_count)
        self.buffered_point_count = int(self.device.read(self.counters)[0, 0])
        return self.buffered_point_count

    def _draw(self, part: _Part, declaration: Any, *flags: str, **outputs: Any) -> None:
        self.device.raster_kernel(declaration, *flags).draw(
            self.shared.source_target.target,
            (0, 0, part.width, part.height),
            self.draws,
            **outputs,
            instances=self.scene_data.instances,
            face=self.face_table,
            source_eye=self.source.eye_fs,
            source_texel=self.source.texel_tangent,
            source_depths=(self.source.near_m, self.source.far_m),
            source_window=(part.x, part.y, part.width, part.height),
        )

    # batches

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        table, at_once = self.views_table(selected), self.settings.views_per_thread
        self._begin(maps, selected, table)
        groups = [table[2 * first : 2 * (first + at_once)] for first in range(0, len(selected), at_once)]
        outputs = [{"depth_maps": maps.texture, "views": views, "view_count": len(views) // 2} for views in groups]
        if self.storage is PointStorage.BUFFERLESS:
            for part in self.source.parts:
                for output in outputs:
                    self._draw(part, SPLAT_FRAGMENTS, *self.splat_flags, **output)
            return
        self._hold()
        for _ in self._buffer_fillings():
            for output in outputs:
                self.device.compute_kernel(SPLAT_POINTS, *self.splat_flags).dispatch_linear(
                    self.buffered_point_count,
                    **output,
                    face=self.face_table,
                    points=self.points.texture,
                    point_count=self.buffered_point_count,
                )

    def _buffer_fillings(self) -> Iterator[None]:
        """Yields every time the buffer holds `buffered_point_count` points to replay, until all had their turn."""
        for portion in self._portions:
            if len(self._portions) > 1:
                self._buffer(portion)
            yield

    def counts(self) -> dict[str, int]:
        return {"point_count": self.point_count}
