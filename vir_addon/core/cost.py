"""What work costs: a linear model of each stage, in milliseconds.

docs/performance.md says how the rates were measured. They belong to a kind of hardware: on a GPU what is drawn is cheap and what is
asked for is dear, so `auto` does not choose there what it would on a software rasterizer.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .bounds import SceneBounds
from .passes.eye import visibility_samples_per_px
from .passes.reflection_maps import ReflectionMap
from .passes.shadow_maps import BYTES_PER_TEXEL, MAX_BATCH_VIEWS
from .sampling import pixel_offsets
from .scene import Light, LightShape, SceneSnapshot
from .settings import Hardware, Method, PointGeneration, PointStorage, ReflectionLookUp, ReflectionMethod, Settings

if TYPE_CHECKING:
    from .reflections.reflectors import PlannedReflections

POINT_BYTES = 16
MICRO_BYTES_PER_TRIANGLE = 48
SMALL_PERIMETER_TEXELS = 12.0
"""around what micro-triangle rasterization calls small (core/passes/small_triangles.py)"""
MAP_NS_PER_TEXEL = 60.0
SHADING_NS_PER_TEXEL = 850.0
"""of a round, of maps that are shaded whole, coarser levels and a lamp's light included: 2.2 s for 2.6 million"""
NEEDED_PLACE_NS = 1600.0
"""of a texel that samples need: .5 s for 325,000"""
LOOK_UPS_PER_RAY = 450.0
"""A reflected ray took about five microseconds on a software rasterizer, and as long the one that the world lights its hit along."""
LOOK_UPS_PER_SHADED_RAY, LOOK_UPS_PER_SAMPLE = 70.0, 20.0
"""of cubes whose texels are shaded, which no ray is followed through: reflecting it took .7 microseconds, and each of 25 samples
that are marked and filtered .2"""
"""of a software rasterizer; on a GPU none of these was measured yet"""
PLACES_PER_EYE_POINT = 1.6
"""that are shaded for a point of the eye's pixels: blocks of texels go by powers of 2, and several pixels share those between them"""
FACES_OF_INSTANCE = 2
"""of a cube, that an instance is drawn for; others do not see it"""
IVIR_SHARE = 1.3
"""time of ivir's cloud for that of epr's"""
LEAST_DISTANCE_SHARE = 1e-6
"""of the scene's largest object: nearer casters count as so far away, for the light is within them"""
MAX_LAYERS = 16
"""surfaces one behind the other that large triangles are taken to fill the maps with"""
POINTS_PER_TEXEL = 2.0
"""of the watertight lattice on a surface that faces the view (core/passes/points.py); the published one has half"""
CACHED_BYTES = 2 << 20
"""of a batch's maps, that caches hold besides what is replayed"""
PROJECTED_SHARE = 0.5
"""of the area of what faces a view, whose slope may be any, in its map; what is culled at random is told by that"""
NEW_DRAW_SHARE = 0.2
"""of the instances of a mesh that begin a draw: those of a view which follow each other share one"""
GLOBAL_RATE_SHARE = 2.0
"""points of vir for one of ivir: 238 to 122 thousand in the preprint of 2020, section 3.2"""


@dataclass(frozen=True)
class Rates:
    """Nanoseconds"""

    raster_triangle: float
    """of mvr, a view"""
    raster_texel: float
    """of a map, a view"""
    raster_draw: float
    """a call, its host's time included"""
    cut_out_texel: float
    """looking an opacity map up and what the rasterizer does besides"""
    gather_triangle: float
    """micro's walk over all triangles"""
    small_triangle: float
    """that micro replays, a view"""
    small_texel: float
    """covered by such, a view"""
    generate_triangle: float
    """ivir's walk over all triangles"""
    generate_point: float
    lattice_triangle: float
    """that faces the light, where the rasterizer makes the points: what it takes longer than the kernel"""
    lattice_point: float
    """likewise"""
    splat_point: float
    """of those generated, a view"""
    splat_cached_point: float
    """the same into maps that the caches hold"""
    clear_texel: float
    look_up: float
    """RESOLVE, of a pixel in a view's map"""
    round_pixel: float
    """what RESOLVE takes for a pixel of each eye sample besides, however few views it looks up"""
    filter_tap: float
    """of pcss, in which most find nothing"""
    eye_pixel: float
    collect_triangle: float
    """reflectors' walk over all triangles for one cloud"""
    splat_triangle: float
    """of those, a cube, culled ones and both rounds included"""
    splat_texel: float
    """of cubes, what is large and hidden included"""


RATES = {
    # points replayed: 24 where they lie as a surface's triangles do, 20 where a forest's lie all over the maps and mvr takes longer, too
    Hardware.SOFTWARE: Rates(
        raster_triangle=100.0,
        raster_texel=4.0,
        raster_draw=30_000.0,
        cut_out_texel=20.0,
        gather_triangle=150.0,
        small_triangle=10.0,
        small_texel=18.0,
        generate_triangle=80.0,
        generate_point=90.0,
        lattice_triangle=1900.0,
        lattice_point=90.0,
        splat_point=22.0,
        splat_cached_point=15.0,
        clear_texel=1.0,
        look_up=11.0,
        round_pixel=50.0,
        filter_tap=5.0,
        eye_pixel=60.0,
        collect_triangle=100.0,
        splat_triangle=20.0,
        splat_texel=60.0,
    ),
    # points replayed: 0.04 where they spread evenly, several times that where many fall into a texel
    Hardware.GPU: Rates(
        raster_triangle=0.8,
        raster_texel=0.02,
        raster_draw=23_000.0,
        cut_out_texel=0.1,
        gather_triangle=1.8,
        small_triangle=0.13,
        small_texel=0.05,
        generate_triangle=1.0,
        generate_point=0.3,
        # not measured on one: twice as long
        lattice_triangle=1.0,
        lattice_point=0.3,
        splat_point=0.3,
        splat_cached_point=0.3,
        clear_texel=0.01,
        look_up=0.7,
        # not told apart there
        round_pixel=0.0,
        filter_tap=0.2,
        eye_pixel=1.7,
        # not measured on one: as micro's
        collect_triangle=1.8,
        splat_triangle=0.2,
        splat_texel=0.2,
    ),
}


def eye_ms(snapshot: SceneSnapshot, settings: Settings, eye_sample_count: int) -> float:
    """A G-buffer of every offset, and rasterizations, each of which as many offsets share as it has samples a pixel."""
    pixels, rates = snapshot.width_px * snapshot.height_px, RATES[settings.hardware]
    offsets_px = pixel_offsets(snapshot.pixel_filter, eye_sample_count)
    # devices whose largest texture leaves room for fewer of a long picture are not told apart
    shared_by = visibility_samples_per_px(offsets_px, (snapshot.width_px, snapshot.height_px), settings.visibility_texel_count) ** 2
    triangles = math.ceil(eye_sample_count / shared_by) * snapshot.instanced_triangle_count
    return (triangles * rates.raster_triangle + eye_sample_count * pixels * rates.eye_pixel) * 1e-6


def reflections_ms(
    snapshot: SceneSnapshot, settings: Settings, planned: PlannedReflections, round_count: int, has_surroundings: bool
) -> float:
    """Maps of all reflectors, rays of all rounds as if all were followed, and texels that are shaded; not the light on what rays
    meet, which is the lights'."""
    texels = sum(each.texel_count for each in planned.maps)
    pixels = sum(math.prod(reflector.covered_px) for reflector in planned.reflectors)
    rays = round_count * planned.bounces * pixels
    maps_ms = sum(
        cubes_ms(snapshot, settings, [each for each in planned.maps if each.method is method], method)
        for method in ReflectionMethod
        if method is not ReflectionMethod.AUTO
    )
    look_ups, texels_ns = LOOK_UPS_PER_RAY * (1 + has_surroundings), texels * MAP_NS_PER_TEXEL
    if settings.reflection_look_up is ReflectionLookUp.SHADED:
        look_ups = LOOK_UPS_PER_SHADED_RAY
        texels_ns += round_count * texels * SHADING_NS_PER_TEXEL
    elif settings.reflection_look_up is ReflectionLookUp.LAZY:
        look_ups = LOOK_UPS_PER_SAMPLE
        # once, as if all samples were of one batch
        texels_ns += min(texels, rays, PLACES_PER_EYE_POINT * settings.points_per_eye_pixel * pixels) * NEEDED_PLACE_NS
    return maps_ms + (texels_ns + rays * look_ups * RATES[settings.hardware].look_up) * 1e-6


def cubes_ms(snapshot: SceneSnapshot, settings: Settings, maps: Sequence[ReflectionMap], method: ReflectionMethod) -> float:
    """Finding what maps of reflectors show with a method, never AUTO; not what is made of it, which takes the same for all."""
    return float(each_cube_ms(snapshot, settings, maps, method).sum()) + bool(maps) * cloud_ms(snapshot, settings, method)


def cloud_ms(snapshot: SceneSnapshot, settings: Settings, method: ReflectionMethod) -> float:
    """What all cubes made with a method, never AUTO, share: the walk over the scene."""
    if method is ReflectionMethod.MVR:
        return 0.0
    counts, is_cut_out = _instances_triangles(snapshot)
    return _cloud_share(method) * int(counts[~is_cut_out].sum()) * RATES[settings.hardware].collect_triangle * 1e-6


def each_cube_ms(snapshot: SceneSnapshot, settings: Settings, maps: Sequence[ReflectionMap], method: ReflectionMethod) -> np.ndarray:
    """(n,) besides that. A cloud leaves what has an opacity map to the rasterizer."""
    rates = RATES[settings.hardware]
    counts, is_cut_out = _instances_triangles(snapshot)
    times_ns = []
    for drawn in maps:
        shown = drawn.instances
        rasterized = shown if method is ReflectionMethod.MVR else shown[is_cut_out[shown]]
        texels = drawn.face_count * drawn.width_px * drawn.height_px
        time_ns = 0.0
        if method is ReflectionMethod.MVR or len(rasterized):
            draws = drawn.face_count * (1 + NEW_DRAW_SHARE * len(rasterized))
            triangles = min(drawn.face_count, FACES_OF_INSTANCE) * int(counts[rasterized].sum())
            time_ns += triangles * rates.raster_triangle + draws * rates.raster_draw + texels * rates.raster_texel
        if method is not ReflectionMethod.MVR:
            splats = _cloud_share(method) * int(counts[shown[~is_cut_out[shown]]].sum())
            time_ns += splats * rates.splat_triangle + texels * rates.splat_texel
        times_ns.append(time_ns)
    return np.array(times_ns, np.float64) * 1e-6


def _instances_triangles(snapshot: SceneSnapshot) -> tuple[np.ndarray, np.ndarray]:
    """(instance_count,) triangles, and whether they have an opacity map"""
    mesh = snapshot.instances.mesh_index
    counts = np.array([each.triangle_count for each in snapshot.meshes], np.int64)
    return counts[mesh], np.array([each.opacity_map is not None for each in snapshot.meshes], bool)[mesh]


def _cloud_share(method: ReflectionMethod) -> float:
    return IVIR_SHARE if method is ReflectionMethod.IVIR else 1.0


def resolve_ms(snapshot: SceneSnapshot, settings: Settings, view_count: int, round_count: int) -> float:
    """round_count: eye samples that share the views"""
    rates = RATES[settings.hardware]
    return snapshot.width_px * snapshot.height_px * (view_count * rates.look_up + round_count * rates.round_pixel) * 1e-6


def filter_ms(snapshot: SceneSnapshot, settings: Settings, eye_sample_count: int) -> float:
    """Of pcss, which looks the picture up with all taps for every eye sample."""
    taps = eye_sample_count * (settings.blocker_sample_count + settings.filter_sample_count)
    return snapshot.width_px * snapshot.height_px * taps * RATES[settings.hardware].filter_tap * 1e-6


def _small_shares(sizes: list[tuple[np.ndarray, np.ndarray]], mesh_index: np.ndarray, limit_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each caster, (caster_count,): the share of its triangles, and of their area, with a perimeter of at most `limit_m`
    (caster_count,) object space. Means alone would call a column large whose capital is most of its triangles."""
    count_share, area_share = np.zeros(len(mesh_index)), np.zeros(len(mesh_index))
    order = np.argsort(mesh_index, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(mesh_index[order])) + 1) if len(order) else ():
        area, perimeter = sizes[mesh_index[own[0]]]
        small = np.searchsorted(perimeter, limit_m[own], side="right")
        count_share[own] = small / max(len(area), 1)
        area_share[own] = np.r_[0.0, np.cumsum(area)][small] / max(area.sum(), 1e-30)
    return count_share, area_share


@dataclass(frozen=True)
class LikelyFace:
    """A face of a light that needs maps, as far as the plan can tell."""

    caster_indices: np.ndarray
    """(n,) int64 instances in it"""
    texel_tangent: float
    """the root of a texel's area over its depth; of suns, metres"""


@dataclass(frozen=True)
class _CasterEstimates:
    """Arrays (caster_count,), each caster once for every face that has it."""

    mesh_index: np.ndarray

    triangle_count: np.ndarray
    facing: np.ndarray
    """share of the triangles that face the light: half of a closed surface's"""
    texel_area: np.ndarray
    """mean area of a triangle, texels"""
    texel_perimeter: np.ndarray
    """mean perimeter of a triangle, texels"""
    small_share: np.ndarray
    """share of the triangles that micro-triangle rasterization calls small"""
    small_area_share: np.ndarray
    """share of the triangles' area that is theirs"""
    cut_out_count: np.ndarray
    """triangles with an opacity map, which are not in `triangle_count`"""


def _estimate_casters(snapshot: SceneSnapshot, light: Light, bounds: SceneBounds, faces: Sequence[LikelyFace]) -> _CasterEstimates:
    casters = np.concatenate([np.zeros(0, np.int64), *(face.caster_indices for face in faces)])
    mesh = snapshot.instances.mesh_index[casters]
    matrix = snapshot.instances.world_from_object[casters].astype(np.float64)
    sizes = [mesh.sampled_sizes for mesh in snapshot.meshes]
    statistics = np.array([[area.mean(), perimeter.mean()] for area, perimeter in sizes]).reshape(-1, 2)[mesh]
    is_cut_out = np.array([mesh.opacity_map is not None for mesh in snapshot.meshes], bool)[mesh]
    all_counts = np.array([mesh.triangle_count for mesh in snapshot.meshes], np.int64)[mesh]
    # of lengths and areas in all directions, root mean squares: of a flattened object the volume, and with it the determinant, vanishes
    axes = matrix[:, :3, :3]
    scale = np.sqrt((axes**2).sum(axis=(1, 2)) / 3)
    cofactors = np.stack([np.cross(axes[..., 1], axes[..., 2]), np.cross(axes[..., 2], axes[..., 0]), np.cross(axes[..., 0], axes[..., 1])])
    area_scale = np.sqrt((cofactors**2).sum(axis=(0, 2)) / 3)
    distance = bounds.distances_m(casters, light.world_from_light[:3, 3])
    tangent = np.repeat([face.texel_tangent for face in faces], [len(face.caster_indices) for face in faces])
    texel = tangent if light.shape is LightShape.SUN else np.maximum(distance, LEAST_DISTANCE_SHARE * bounds.yardstick_m) * tangent
    facing = np.where([mesh.is_closed for mesh in snapshot.meshes], 0.5, 1.0)[mesh]
    texel_area, texel_perimeter = statistics[:, 0] * area_scale / texel**2, statistics[:, 1] * scale / texel
    small_share, small_area_share = _small_shares(sizes, mesh, SMALL_PERIMETER_TEXELS * texel / np.maximum(scale, 1e-30))
    return _CasterEstimates(
        mesh, all_counts * ~is_cut_out, facing, texel_area, texel_perimeter, small_share, small_area_share, all_counts * is_cut_out
    )


def _point_counts(estimates: _CasterEstimates, settings: Settings, texels: float) -> np.ndarray:
    """(caster_count,) mean points of a triangle: it touches its area plus half its perimeter in lattice cells, and one more; of those far
    below a texel only some are kept."""
    points_per_texel = POINTS_PER_TEXEL if settings.watertight else 1.0
    area, perimeter = estimates.texel_area * points_per_texel, estimates.texel_perimeter * np.sqrt(points_per_texel)
    all_area = float((estimates.triangle_count * area).sum())
    visible = min(1.0, MAX_LAYERS * POINTS_PER_TEXEL * texels / max(all_area, 1.0))
    kept = np.minimum(PROJECTED_SHARE * estimates.texel_area / settings.culling_area_texels, 1) if settings.stochastic_culling else 1.0
    return kept * (1 + perimeter / 4 + area * visible)


def estimate_methods(
    snapshot: SceneSnapshot,
    light: Light,
    view_count: int,
    settings: Settings,
    bounds: SceneBounds,
    faces: Sequence[LikelyFace],
    batch_count: int = 1,
    *,
    is_replayed: bool = True,
) -> dict[Method, float]:
    """Milliseconds of making all depth maps with each method.

    batch_count: times that the views are taken in turn; what does not fit into its memory is made again for each, and all of it if nothing
    is_replayed.
    """
    estimates = _estimate_casters(snapshot, light, bounds, faces)
    work = _MapWork(settings, RATES[settings.hardware], estimates, len(faces), view_count, batch_count, is_replayed)
    everything = np.ones(len(estimates.triangle_count), bool)
    becomes_points = work.point_counts <= settings.small_triangle_points
    nanoseconds = {
        Method.MVR: work.raster_ns(),
        Method.MICRO: work.micro_ns(),
        Method.IVIR: work.points_ns(everything),
        Method.HYBRID: work.points_ns(becomes_points) + view_count * work.left_to_rasterizer_ns(work.facing * ~becomes_points),
        Method.VIR: work.points_ns(everything, GLOBAL_RATE_SHARE),
        Method.VWSS: work.points_ns(everything, keeps_part=False),
        Method.EPR: work.splatted_triangles_ns(),
        Method.PCSS: work.raster_ns(),
    }
    cut_out_ns = view_count * _cut_out_ns_a_view(estimates, work.texels, work.rates)
    return {method: (ns + cut_out_ns) * 1e-6 for method, ns in nanoseconds.items()}


@dataclass(frozen=True)
class _MapWork:
    """All maps of a light, in nanoseconds by the way they are made."""

    settings: Settings
    rates: Rates
    estimates: _CasterEstimates
    face_count: int
    view_count: int
    batch_count: int
    is_replayed: bool
    """False: everything is made again for every batch"""

    @functools.cached_property
    def triangles(self) -> float:
        return float(self.estimates.triangle_count.sum())

    @functools.cached_property
    def texels(self) -> float:
        """of a view"""
        return self.face_count * float(self.settings.map_resolution_px) ** 2

    @functools.cached_property
    def covered_texels(self) -> float:
        return min(float((self.facing * self.estimates.texel_area).sum()), MAX_LAYERS * self.texels)

    @functools.cached_property
    def facing(self) -> np.ndarray:
        """(caster_count,) triangles that face the light"""
        return self.estimates.triangle_count * self.estimates.facing

    @functools.cached_property
    def point_counts(self) -> np.ndarray:
        """(caster_count,) points of a triangle"""
        return _point_counts(self.estimates, self.settings, self.texels)

    @property
    def budget_bytes(self) -> int:
        return self.settings.replay_buffer_mib << 20

    def raster_ns(self) -> float:
        draws = _draw_count(self.estimates.mesh_index[self.estimates.triangle_count > 0])
        rates = self.rates
        return self.view_count * (self.triangles * rates.raster_triangle + draws * rates.raster_draw + self.texels * rates.raster_texel)

    def micro_ns(self) -> float:
        estimates, rates = self.estimates, self.rates
        small = float((self.facing * estimates.small_share).sum())
        gatherings = 1 if self.is_replayed and small * MICRO_BYTES_PER_TRIANGLE <= self.budget_bytes else self.batch_count
        small_texels = float((self.facing * estimates.texel_area * estimates.small_area_share).sum())
        return gatherings * self.triangles * rates.gather_triangle + self.view_count * (
            small * rates.small_triangle
            + min(small_texels, self.covered_texels) * rates.small_texel
            + self.texels * rates.clear_texel
            + self.left_to_rasterizer_ns(self.facing * (1 - estimates.small_share))
        )

    def left_to_rasterizer_ns(self, counts: np.ndarray) -> float:
        """A view of the (caster_count,) triangles that are too large for points, or for kernels."""
        drawn = counts >= 1
        if not drawn.any():
            return 0.0
        draws_ns = max(self.face_count, NEW_DRAW_SHARE * int(drawn.sum())) * self.rates.raster_draw
        return float(counts.sum()) * self.rates.raster_triangle + draws_ns + self.texels * self.rates.raster_texel

    def points_ns(self, becomes_points: np.ndarray, share: float = 1.0, *, keeps_part: bool = True) -> float:
        """becomes_points: (caster_count,) bool; share: of the points that `ivir` would make. keeps_part: of points that do not all fit into
        their memory those that do stay there"""
        settings, rates = self.settings, self.rates
        batch_views = min(math.ceil(self.view_count / self.batch_count), MAX_BATCH_VIEWS)
        is_cached = batch_views * BYTES_PER_TEXEL * settings.map_resolution_px**2 <= CACHED_BYTES
        splat_point = rates.splat_cached_point if is_cached else rates.splat_point
        points = share * float((self.facing * self.point_counts)[becomes_points].sum())
        walk_ns = self.triangles * rates.generate_triangle + points * rates.generate_point
        if settings.point_generation is PointGeneration.RASTERIZER:
            walk_ns += float(self.facing[becomes_points].sum()) * rates.lattice_triangle + points * rates.lattice_point
        replay_ns = self.view_count * (points * splat_point + self.texels * rates.clear_texel)
        return self._walk_count(points, keeps_part) * walk_ns + replay_ns

    def _walk_count(self, points: float, keeps_part: bool) -> float:
        """Over all triangles."""
        if not self._keeps_points:
            return self.batch_count
        room = self.budget_bytes / max(points * POINT_BYTES, 1)
        if room >= 1 or not keeps_part:
            return 1 if room >= 1 else self.batch_count
        # that there is no room is found out by one; then those that have some are kept, and each batch makes the others. Of faces that
        # take turns with the memory each batch makes all, which is not told apart
        return 1 + room + (1 - room) * self.batch_count

    def splatted_triangles_ns(self) -> float:
        """Of `epr`: its splats cover texels as triangles of `micro` do, and what is large is cut into few."""
        rates = self.rates
        walks = 1 if self._keeps_points else self.batch_count
        splats_ns = float(self.facing.sum()) * rates.small_triangle + self.covered_texels * rates.small_texel
        return walks * self.triangles * rates.generate_triangle + self.view_count * (splats_ns + self.texels * rates.clear_texel)

    @property
    def _keeps_points(self) -> bool:
        return self.is_replayed and self.settings.points is PointStorage.BUFFERED


def _draw_count(mesh_index: np.ndarray) -> float:
    """A view's, of the meshes of (n,) casters."""
    mesh_count = len(np.unique(mesh_index))
    return mesh_count + NEW_DRAW_SHARE * (len(mesh_index) - mesh_count)


def _cut_out_ns_a_view(estimates: _CasterEstimates, texels: float, rates: Rates) -> float:
    """The same for all methods, as all hand them to the rasterizer."""
    count = estimates.cut_out_count
    draws = _draw_count(estimates.mesh_index[count > 0])
    covered = min(float((count * estimates.texel_area).sum()), MAX_LAYERS * texels)
    return float(count.sum()) * rates.raster_triangle + draws * rates.raster_draw + covered * rates.cut_out_texel
