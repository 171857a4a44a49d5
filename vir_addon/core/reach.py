"""What of a scene a light's shadows are about: the visible surfaces that it can reach, and the instances that may shadow them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from .bounds import FLAT_TOLERANCE, SceneBounds
from .sampling import light_samples
from .scene import Light, LightShape, SceneSnapshot
from .views import MAX_SINGLE_FACE_TANGENT, MIN_RECEIVER_MARGIN, light_axes

MAX_RECEIVER_PIXELS = 1 << 17
"""A larger picture is looked at in steps of more than a pixel."""
MAX_RECEIVER_POINTS = 8192
"""Of more some are chosen."""
DIRECTION_CELLS = 128
"""a side of each face of a cube around the light"""
RECEIVER_MARGIN_PX = 5.0
"""Filters reach 1.5 pixels to each side, and perspective may make the outermost pixels cover more than the mean."""
LEAST_SHRINKING = 0.25
"""of steps beyond the picture's edge: a horizon there is as far as four times what it were without perspective"""
MAX_CASTER_PLACES = 4_000_000
"""casters times places that are looked at one by one"""


@dataclass(frozen=True)
class CasterSet:
    """Instances that may cast, with what fitting needs of them."""

    indices: np.ndarray
    """(caster_count,) int64 instance numbers"""
    corners_ws: np.ndarray
    """(caster_count, 8, 3) float64 corners of their bounding boxes"""


def casts_for(snapshot: SceneSnapshot, light: Light) -> np.ndarray:
    """(instance_count,) bool: which may cast this light's shadow."""
    return snapshot.instances.casts_shadow if light.blockers is None else light.blockers


def light_casters(snapshot: SceneSnapshot, light: Light) -> np.ndarray:
    """(n,) int64 instances that may cast this light's shadow."""
    return np.flatnonzero(casts_for(snapshot, light))


@dataclass(frozen=True)
class Receivers:
    """Visible surfaces that a light can reach."""

    points_ws: np.ndarray
    """(n, 3) float64: all of them or, of many, a regular subset and, in slices of depth, the outermost, which decide the windows; of
    lights that take a cube the nearest and the farthest in every direction"""
    margin: float
    """share by which windows are wider than these points: later eye samples are offset by parts of a pixel and see more"""
    gap_tangent: float = 0.0
    """how far from these points, as seen from the light's centre, others may be; 0 where the outermost are all there"""
    beyond_ws: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) float64: what samples of the picture's outermost pixels may see beyond its edge. Faces of a cube may reach into the picture by
    a few pixels, of which a margin is next to nothing; a single face's margin covers these places"""
    instances: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """(k,) int64: of which instances the light reaches something that was looked at"""


def select_receivers(positions: np.ndarray, normals: np.ndarray, light: Light, beyond_px: float = 0.0) -> Receivers:
    """What of an eye G-buffer lies where the light shines and is (by either normal) turned towards some of it.

    positions, normals: the G-buffer's textures, (height, width, 4). beyond_px: how far beyond the centres of the picture's outermost pixels
    its samples reach.
    """
    # rows and columns between are within the margin
    step = math.ceil(math.sqrt(positions.shape[0] * positions.shape[1] / MAX_RECEIVER_PIXELS))
    rows, columns = (np.unique([*range(0, count, step), count - 1]) for count in positions.shape[:2])  # up to the picture's edges
    is_sun = light.shape is LightShape.SUN
    beyond = _beyond_edges(positions, normals, rows, columns, beyond_px) if beyond_px > 0 and not is_sun else None
    beyond_ws = np.zeros((0, 3)) if beyond is None else _reached(*beyond, light)[1]
    chosen = np.ix_(rows, columns)
    is_reached, points, p = _reached(positions[chosen], normals[chosen], light)
    margin, numbers = _margin(is_reached), positions[chosen][is_reached][:, 3]
    if step > 1:
        missed = _missed_between(positions[..., 3], rows, columns)
        is_reached, *more = _reached(positions[missed], normals[missed], light)
        points, p = (np.concatenate(both) for both in zip((points, p), more, strict=True))
        numbers = np.concatenate([numbers, positions[missed][is_reached][:, 3]])
    instances = np.unique(numbers).astype(np.int64)
    if len(points) <= MAX_RECEIVER_POINTS:
        return Receivers(points, margin, beyond_ws=beyond_ws, instances=instances)
    # what one map of each view reaches has no seams
    half = _half_size_m(light)
    single_tangent = MAX_SINGLE_FACE_TANGENT * (1 - MIN_RECEIVER_MARGIN)
    is_single = is_sun or (light.shape.is_area and _is_within(p, single_tangent, half).all())
    if is_single:
        every = np.arange(0, len(points), -(-len(points) // MAX_RECEIVER_POINTS))
        outermost = _outermost(p[:, :2] if is_sun else p[:, :2] / p[:, 2:], p[:, 2])
        return Receivers(points[np.unique(np.concatenate([every, *outermost]))], margin, instances=instances)
    return Receivers(points[np.unique(_spread_over_directions(p))], margin, 2 / DIRECTION_CELLS, beyond_ws, instances)


def _missed_between(instance: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels, as indices, of instances that none of some rows and columns shows: thin ones and small ones. instance: (height, width)
    float32 numbers, -1 for the background"""
    numbers = instance.astype(np.int64)
    is_missed = np.ones(numbers.max(initial=-1) + 2, bool)
    is_missed[numbers[np.ix_(rows, columns)]] = is_missed[-1] = False  # the last is the background
    found = np.nonzero(is_missed[numbers])
    every = -(-len(found[0]) // MAX_RECEIVER_PIXELS) or 1
    return found[0][::every], found[1][::every]


def _half_size_m(light: Light) -> float:
    return float(np.hypot(light.size_x_m, light.size_y_m)) / 2


def _reached(positions: np.ndarray, normals: np.ndarray, light: Light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of (..., 4) positions and normals, as of `select_receivers`: (...) bool what the light reaches, and where that is, (n, 3) float64
    world space and light space."""
    is_reached = positions[..., 3] >= 0
    if light.receivers is not None:
        is_reached &= light.receivers[np.maximum(positions[..., 3], 0).astype(np.int64)]
    points = positions[is_reached][:, :3].astype(np.float64)
    normal = normals[is_reached][:, :3].astype(np.float64)
    axes = light_axes(light)
    p = _along(axes, points - light.world_from_light[:3, 3])
    # the light's nearest point to the plane of the surface decides whether any of it is above the horizon; the shading normal
    # may lean towards the light by as much again, so surfaces turned away by a little are kept
    towards = np.full_like(p, (0.0, 0.0, -1.0)) if light.shape is LightShape.SUN else -p
    distances = np.sqrt(np.einsum("ij,ij->i", towards, towards))
    turned = np.einsum("ij,ij->i", _along(axes, normal), towards) > -_half_size_m(light) - 0.5 * distances
    reach = lit_places(light, p) & turned
    is_reached[is_reached] = reach
    return is_reached, points[reach], p[reach]


def lit_places(light: Light, p_ls: np.ndarray) -> np.ndarray:
    """(n,) bool: which places, (n, 3) light space, some of the light shines upon: before an area light's plane, in a spot's cone."""
    if light.shape is LightShape.SUN:
        return np.ones(len(p_ls), bool)
    if not light.shape.is_omni:
        return p_ls[:, 2] > 0
    half = light.cone_rad / 2
    if half >= np.pi:
        return np.ones(len(p_ls), bool)
    scale = np.array([max(factor, 1e-6) for factor in (*light.cone_scale, 1.0)])
    q, radius_m = p_ls / scale, light.radius_m / scale.min()
    # the cones of all places of the sphere lie in the one whose apex is moved back until it touches the sphere
    depth = q[:, 2] + radius_m / np.sin(half)
    distance = np.sqrt(q[:, 0] ** 2 + q[:, 1] ** 2 + depth**2)
    return (depth >= np.cos(half) * distance) | (np.linalg.norm(p_ls, axis=1) <= light.radius_m)


def _along(axes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(n, 3) components of vectors along the rows of axes, (3, 3), both float64. Each component lies together; multiplied the other way
    around, or of different types, these take up to thirty times as long."""
    components: np.ndarray = axes @ vectors.T
    return components.T


def _is_within(p: np.ndarray, tangent: float, width_m: float = 0.0) -> np.ndarray:
    """(n,) bool: places, (n, 3), within a square pyramid about z, by so much"""
    return np.logical_and(*(np.abs(p[:, axis]) + width_m < tangent * p[:, 2] for axis in (0, 1)))


def _spread_over_directions(p: np.ndarray) -> np.ndarray:
    """Indices of the nearest and the farthest of (n, 3) places in each cell of a cube's faces that has any: no view's window lacks more
    than a cell, whichever face they are in from there."""
    sizes = np.abs(p)
    axis = sizes.argmax(axis=1)
    rows = np.arange(len(p))
    size = np.maximum(sizes[rows, axis], np.finfo(np.float64).tiny)
    cell = 2 * axis + (p[rows, axis] < 0)
    for other in (1, 2):
        tangent = p[rows, (axis + other) % 3] / size
        cell = DIRECTION_CELLS * cell + np.clip((tangent + 1) / 2 * DIRECTION_CELLS, 0, DIRECTION_CELLS - 1).astype(np.int64)
    order = np.argsort(cell + size / (1.001 * size.max()))
    starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
    return np.concatenate([order[starts], order[np.append(starts[1:], len(order)) - 1]])


def _outermost(places: np.ndarray, depths: np.ndarray) -> list[np.ndarray]:
    """Indices of the outermost of (n, 2) places in slices of depth."""
    if not len(depths):
        return []
    chosen = []
    for part in np.array_split(np.argsort(depths), min(32, len(depths))):
        chosen += [part[places[part].argmin(axis=0)], part[places[part].argmax(axis=0)], part[[0, -1]]]
    return chosen


def _beyond_edges(
    positions: np.ndarray, normals: np.ndarray, rows: np.ndarray, columns: np.ndarray, beyond_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """What samples see beyond the outermost pixels, some rows and columns of them, and beyond the corners: (n, 4) positions and normals,
    as of `select_receivers`."""
    height, width = positions.shape[:2]
    columns = np.unique(np.clip([*columns, *range(3), *range(width - 3, width)], 0, width - 1))
    strips = [np.clip(inwards, 0, height - 1) for inwards in (np.arange(3), height - 1 - np.arange(3))]
    below, above = (_extrapolated(positions[strip][:, columns], normals[strip][:, columns], beyond_px) for strip in strips)
    outer = [image[:, columns] for image in (normals[[0]], normals[[-1]])]
    tall = np.concatenate([below[None], positions[np.ix_(rows, columns)], above[None]])
    tall_normals = np.concatenate([outer[0], normals[np.ix_(rows, columns)], outer[1]])
    sides = (slice(None, 3), slice(None, -4, -1))
    left, right = (_extrapolated(np.moveaxis(tall[:, side], 1, 0), np.moveaxis(tall_normals[:, side], 1, 0), beyond_px) for side in sides)
    return (
        np.concatenate([below, above, left, right]),
        np.concatenate([outer[0][0], outer[1][0], tall_normals[:, 0], tall_normals[:, -1]]),
    )


def _extrapolated(inwards: np.ndarray, normals: np.ndarray, beyond_px: float) -> np.ndarray:
    """(n, 4) positions so far beyond the first of (3, n, 4), pixels from the edge inwards; the background where these are not all in one
    plane of one instance: how anything else goes on is not known. In perspective the way to the r-th pixel is a r / (1 + b r)."""
    first, second, third = inwards
    steps = second[:, :3] - first[:, :3]
    near, far = (np.linalg.norm(each, axis=1) for each in (steps, third[:, :3] - second[:, :3]))
    with np.errstate(divide="ignore", invalid="ignore"):
        shrinking = np.nan_to_num((near - far) / (2 * far), nan=0.0, posinf=0.0, neginf=0.0)
    factor = (1 + shrinking) * beyond_px / np.maximum(1 - shrinking * beyond_px, LEAST_SHRINKING)
    found = first.copy()
    found[:, :3] -= factor[:, None] * steps
    is_one = (first[:, 3] == second[:, 3]) & (second[:, 3] == third[:, 3])
    is_even = (np.abs(normals - normals[0])[..., :3] < FLAT_TOLERANCE).all(axis=(0, 2))
    aside = np.abs(np.einsum("ij,ij->i", normals[0, :, :3], steps))
    found[~(is_one & is_even & (aside < 1e-3 * near)), 3] = -1.0
    return found


def _margin(is_reached: np.ndarray) -> float:
    """In a small picture, or one that shows little of what is lit, a pixel is a large share of the window.

    is_reached: (rows, columns) bool
    """
    rows, columns = np.nonzero(is_reached)
    if not len(rows):
        return MIN_RECEIVER_MARGIN
    return max(MIN_RECEIVER_MARGIN, RECEIVER_MARGIN_PX / (min(np.ptp(rows), np.ptp(columns)) + 1))


def _shadows_nothing(snapshot: SceneSnapshot, bounds: SceneBounds, instance: int, samples_ws: np.ndarray, receivers_ws: np.ndarray) -> bool:
    """Whether a flat caster has the light and every receiver on the same side: then it shadows nothing, itself included."""
    mesh_index = int(snapshot.instances.mesh_index[instance])
    mesh, axis = snapshot.meshes[mesh_index], int(bounds.flat_axis[mesh_index])
    matrix = snapshot.instances.world_from_object[instance].astype(np.float64)
    normal = np.linalg.inv(matrix[:3, :3])[axis]
    normal /= np.linalg.norm(normal)
    origin = matrix[:3, :3] @ mesh.positions_os[mesh.triangles[0, 0]].astype(np.float64) + matrix[:3, 3]
    light_side = (samples_ws - origin) @ normal
    receiver_side = (receivers_ws - origin) @ normal
    if light_side.min() < 0:
        light_side, receiver_side = -light_side, -receiver_side
    size = np.ptp(bounds.corners_ws[instance], axis=0).max()
    return bool(light_side.min() > 0 and receiver_side.min() > -10 * FLAT_TOLERANCE * size)


def shadowing_casters(
    snapshot: SceneSnapshot, light: Light, bounds: SceneBounds, receivers_ws: np.ndarray, samples_m: np.ndarray
) -> CasterSet:
    """Casters of the light without flat ones that shadow nothing visible."""
    samples_ws = _samples_in_world(light, bounds, samples_m)
    indices = light_casters(snapshot, light)
    flat = bounds.flat_axis[snapshot.instances.mesh_index[indices]] >= 0
    idle = [i for i in indices[flat] if _shadows_nothing(snapshot, bounds, int(i), samples_ws, receivers_ws)]
    indices = np.setdiff1d(indices, np.array(idle, np.int64))
    return CasterSet(indices, bounds.corners_ws[indices])


def may_shadow(snapshot: SceneSnapshot, light: Light, bounds: SceneBounds, places_ws: np.ndarray, view_count: int) -> bool:
    """Whether `shadowing_casters` may find any for receivers within the hull of some places, (n, 3) world space. True where looking at
    all of them would take long."""
    indices = light_casters(snapshot, light)
    if (bounds.flat_axis[snapshot.instances.mesh_index[indices]] < 0).any() or len(indices) * len(places_ws) > MAX_CASTER_PLACES:
        return True
    samples_ws = _samples_in_world(light, bounds, light_samples(light, view_count))
    return any(not _shadows_nothing(snapshot, bounds, int(i), samples_ws, places_ws) for i in indices)


def _samples_in_world(light: Light, bounds: SceneBounds, samples_m: np.ndarray) -> np.ndarray:
    """(n, 3) float64"""
    if light.shape is LightShape.SUN:
        # so far away that every plane in the scene has it on the side from which its rays come
        far_m = 1e6 * max(float(np.ptp(bounds.corners_ws.reshape(-1, 3), axis=0).max()), float(np.abs(bounds.corners_ws).max()))
        return -far_m * np.add(samples_m, (0, 0, 1)) @ light_axes(light)
    return light.world_from_light[:3, 3] + samples_m @ light_axes(light)
