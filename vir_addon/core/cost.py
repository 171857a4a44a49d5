"""What work costs: a linear model of each stage, in milliseconds.

The rates were measured on a software rasterizer with two processors (docs/performance.md says how); on a GPU
absolute times are far smaller, but what `auto` needs, the ratio between rasterizing triangles again for every view and replaying
points, is of the same order.
"""

from __future__ import annotations

import numpy as np

from .bounds import SceneBounds
from .scene import Light, Mesh, SceneSnapshot
from .settings import Method, PointStorage, Settings

RASTER_NS_PER_TRIANGLE = 100.0
RASTER_MS_PER_DRAW = 0.03
RASTER_NS_PER_TEXEL = 4.0
GENERATE_NS_PER_TRIANGLE = 300.0
GENERATE_NS_PER_POINT = 60.0
SPLAT_NS_PER_POINT = 9.0
"""13 for a point that is replayed; about a third is found hidden after the first batch"""
CLEAR_NS_PER_TEXEL = 1.0
RESOLVE_NS_PER_LOOKUP = 14.0
EYE_NS_PER_PIXEL = 60.0
SAMPLED_TRIANGLES = 2048
MAX_LAYERS = 16
"""surfaces one behind the other that large triangles are taken to fill the maps with"""
POINTS_PER_TEXEL = 2.0
"""of the watertight lattice on a surface that faces the view (core/passes/shadow_maps.py); the published one has half"""


def eye_ms(snapshot: SceneSnapshot, eye_sample_count: int) -> float:
    """One rasterization, which all offsets share, and a G-buffer of each."""
    pixels = snapshot.width_px * snapshot.height_px
    return (snapshot.instanced_triangle_count * RASTER_NS_PER_TRIANGLE + eye_sample_count * pixels * EYE_NS_PER_PIXEL) * 1e-6


def resolve_ms(snapshot: SceneSnapshot, view_count: int) -> float:
    return snapshot.width_px * snapshot.height_px * view_count * RESOLVE_NS_PER_LOOKUP * 1e-6


def _mean_edge_products(mesh: Mesh) -> tuple[float, float]:
    """Mean area (m^2) and mean perimeter (m) of a regular subset of the triangles, object space."""
    step = max(1, mesh.triangle_count // SAMPLED_TRIANGLES)
    a, b, c = np.moveaxis(mesh.positions_os[mesh.triangles[::step]].astype(np.float64), 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    perimeter = sum(np.linalg.norm(d, axis=1) for d in (b - a, c - b, a - c))
    return float(area.mean()), float(perimeter.mean())


def estimate_point_count(snapshot: SceneSnapshot, light: Light, settings: Settings, bounds: SceneBounds) -> float:
    """Points of one generation: every triangle touches its area plus half its perimeter in lattice cells, and one more.

    Flat meshes are left out: floors and walls that everything visible stands before cast nothing (core/fit.py).
    """
    instances = snapshot.instances
    statistics = np.array([_mean_edge_products(mesh) for mesh in snapshot.meshes]).reshape(-1, 2)[instances.mesh_index]
    counts = np.array([mesh.triangle_count for mesh in snapshot.meshes])[instances.mesh_index] * (
        bounds.flat_axis[instances.mesh_index] < 0
    )
    scale = np.cbrt(np.abs(np.linalg.det(instances.world_from_object[:, :3, :3].astype(np.float64))))
    centers = instances.world_from_object[:, :3, 3] - light.world_from_light[:3, 3]
    distance = np.maximum(np.linalg.norm(centers, axis=1), 1e-3)
    # windows are fitted: a map spans roughly what the objects span, about a radian
    cell = distance / settings.map_resolution_px / np.sqrt(POINTS_PER_TEXEL if settings.watertight else 1.0)
    area, half_perimeter = statistics[:, 0] * scale**2 / cell**2, statistics[:, 1] * scale / cell / 2
    visible = min(1.0, MAX_LAYERS * POINTS_PER_TEXEL * settings.map_resolution_px**2 / max(float((counts * area).sum()), 1.0))
    facing = np.where([mesh.is_closed for mesh in snapshot.meshes], 0.5, 1.0)[instances.mesh_index]
    return float((counts * facing * (1 + half_perimeter * 0.5 + area * visible)).sum())


def estimate_methods(
    snapshot: SceneSnapshot, light: Light, view_count: int, settings: Settings, bounds: SceneBounds, face_count: int = 1
) -> dict[Method, float]:
    """Milliseconds of making all depth maps with each method.

    face_count: maps a view; they share out what casts, and each has its own texels to clear and its own walk over the triangles.
    """
    casts = snapshot.instances.casts_shadow if light.blockers is None else light.blockers
    mesh_index = snapshot.instances.mesh_index[casts]
    triangles = float(np.array([mesh.triangle_count for mesh in snapshot.meshes])[mesh_index].sum())
    texels = face_count * float(settings.map_resolution_px) ** 2
    draws = len(np.unique(mesh_index))
    raster = view_count * (triangles * RASTER_NS_PER_TRIANGLE * 1e-6 + draws * RASTER_MS_PER_DRAW + texels * RASTER_NS_PER_TEXEL * 1e-6)
    points = estimate_point_count(snapshot, light, settings, bounds)
    generations = 1 if settings.points is PointStorage.BUFFERED else max(1, view_count // 8)
    generate = generations * (face_count * triangles * GENERATE_NS_PER_TRIANGLE + points * GENERATE_NS_PER_POINT)
    replay = view_count * (points * SPLAT_NS_PER_POINT + texels * CLEAR_NS_PER_TEXEL)
    return {Method.MVR: raster, Method.IVIR: (generate + replay) * 1e-6}
