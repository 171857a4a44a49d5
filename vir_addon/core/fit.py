"""Fitting a light's views to what casts and what receives.

A map is needed only where something that casts lies before something visible: what lies outside every caster's
outline is lit. So a view's window is the bounds of (casters' outlines intersected with the receivers' bounds), casters that
cannot shadow a visible receiver left out (core/reach.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from .bounds import SceneBounds
from .eye_pixels import EyePixels
from .reach import CasterSet, Receivers, shadowing_casters
from .sampling import Cone, cone_of
from .scene import Light, LightShape, SceneSnapshot
from .views import (
    LEAST_WIDTH,
    NEAR_SHARE_OF_FAR,
    Face,
    FaceViews,
    area_light_faces,
    fit_windows,
    fits_single_face,
    light_axes,
    omni_faces,
    single_omni_face,
)

NOTHING = np.array([1.0, -1.0, 1.0, -1.0])
"""bounds (left, right, bottom, top) that hold no point"""
TEXELS_PER_EYE_PIXEL = 4.0
"""each way, as many as a pixel has visibility samples (core/passes/eye.py), which show by what part of a pixel an edge is off"""
SEARCH_TANGENT = 1.0
"""How much farther to the sides than its face a map reaches in which blockers are searched: a cube's faces overlap so far. What is beyond
shadows nothing in it."""
SEAM_TANGENT = 0.1
"""How far before a cube's seam, and beyond it, receivers are looked for that may have others up to it between them."""
CONE_STEP_RAD = math.radians(15)
"""of the half angle of a cone around the receivers, to which samples of a sphere are fitted: few steps, so that moving cameras change them
rarely"""
MAX_PAIRS = 4_000_000
"""view-instance pairs evaluated exactly; beyond it all views share one window"""
WALL_PERIMETER_TEXELS = 64.0
"""of a triangle, from which on what is not closed may be a wall: leaves and petals are not worth looking for their feet"""


@dataclass(frozen=True)
class FittedFace:
    views: FaceViews
    caster_indices: np.ndarray
    """(n,) int64 instances that some view needs"""
    seen_by_view: np.ndarray
    """(view_count, n) bool: which view needs which"""
    has_receivers: np.ndarray
    """(view_count,) bool: views which see a receiver that was known in this face; all of suns, and where no map is made and nobody asks"""
    nearest_caster_m: float
    """a lower bound of the depth of casters before any view; may be negative"""


def choose_faces(light: Light, receivers_ws: np.ndarray, samples_m: np.ndarray) -> tuple[Face, ...]:
    """One face if it holds all receivers, otherwise those of a cube."""
    if light.shape.is_omni:
        single = single_omni_face(light, receivers_ws, samples_m)
        return omni_faces(light) if single is None else (single,)
    (front,) = area_light_faces(light, needs_cube=False)
    return (front,) if fits_single_face(front, light, receivers_ws, samples_m) else area_light_faces(light, needs_cube=True)


def receiver_cone(light: Light, receivers: Receivers) -> Cone:
    """Around all that receives light from a point light or spot, for the samples on its sphere, around one of the light's axes, so that
    cameras that move seldom change it. The light's own cone where a single face does not hold the receivers, and with a soft falloff: then
    both sides of the sphere count and no sample is wasted."""
    own = cone_of(light)
    if light.has_soft_falloff or not len(receivers.points_ws):
        return own
    sphere_m = light.radius_m * np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    face = single_omni_face(light, receivers.points_ws, sphere_m)
    if face is None:
        return own
    forward = face.face_from_world[2]
    toward = receivers.points_ws - light.world_from_light[:3, 3]
    least = float((toward @ forward / np.linalg.norm(toward, axis=1)).min())
    half_rad = CONE_STEP_RAD * math.ceil(math.acos(min(least, 1.0)) * (1 + receivers.margin) / CONE_STEP_RAD)
    x, y, z = (round(part) for part in light_axes(light) @ forward)
    cone = Cone((x, y, z), max(half_rad, CONE_STEP_RAD))
    return cone if cone.half_rad < own.half_rad and (own.half_rad >= math.pi or cone.axis == own.axis) else own


def light_hull(light: Light, samples_m: np.ndarray) -> np.ndarray:
    """(1, 2, 4 or 8, 3) float64 world-space corners of a box around all light samples"""
    return light.world_from_light[:3, 3] + box_corners(samples_m) @ light_axes(light)


def box_corners(points: np.ndarray) -> np.ndarray:
    """(1, 2, 4 or 8, 3) corners of the box around (n, 3) points"""
    ends = (points.min(axis=0), points.max(axis=0))
    return np.unique([[ends[i][0], ends[j][1], ends[k][2]] for k in (0, 1) for j in (0, 1) for i in (0, 1)], axis=0)


def _tangent_bounds(points: np.ndarray, near_m: float, limits: tuple[float, float, float, float]) -> np.ndarray:
    """Bounds of sets of points as a view sees them: (3, point, set) face space -> (4, set) left, right, bottom, top.

    Clipped to the limits. A set that reaches behind the near depth fills them as far as it may; one without a visible point has
    left > right.
    """
    sides, z = points[:2], points[2]
    behind = z <= near_m
    depth = np.maximum(z, near_m)
    bounds = np.empty((4, z.shape[1]))
    for axis in (0, 1):
        tangents = sides[axis] / depth
        bounds[2 * axis] = np.maximum(tangents.min(axis=0), limits[2 * axis])
        bounds[2 * axis + 1] = np.minimum(tangents.max(axis=0), limits[2 * axis + 1])
    crossing = np.flatnonzero(behind.any(axis=0))
    if len(crossing):
        # what is before the near depth has no projection; a set wholly to one side still cannot come nearer to the axis than its
        # deepest point would
        deepest = np.maximum(z[:, crossing].max(axis=0), near_m)
        for axis in (0, 1):
            low, high = limits[2 * axis], limits[2 * axis + 1]
            crossing_sides = sides[axis][:, crossing]
            nearest_low, nearest_high = crossing_sides.min(axis=0) / deepest, crossing_sides.max(axis=0) / deepest
            bounds[2 * axis, crossing] = np.where(nearest_low > 0, np.maximum(nearest_low, low), low)
            bounds[2 * axis + 1, crossing] = np.where(nearest_high < 0, np.minimum(nearest_high, high), high)
    bounds[:, behind.all(axis=0)] = NOTHING[:, None]
    return bounds


def _may_be_in_face(sets: np.ndarray, hull_fs: np.ndarray, near_m: float, limits: tuple[float, float, float, float]) -> np.ndarray:
    """(n,) bool: hulls of points, (n, m, 3) face space, of which some view in the box around the hull may have a part within the limits."""
    low, high = hull_fs.min(axis=0), hull_fs.max(axis=0)
    x, y, z = np.moveaxis(sets, -1, 0)
    deepest = z - low[2]
    inside = (deepest > near_m).any(axis=-1)
    for axis, sides in enumerate((x, y)):
        inside &= (sides - high[axis] <= max(limits[2 * axis + 1], 0.0) * deepest).any(axis=-1)
        inside &= (sides - low[axis] >= min(limits[2 * axis], 0.0) * deepest).any(axis=-1)
    return inside


def _is_empty(bounds: np.ndarray) -> np.ndarray:
    """(...) bool of (4, ...) bounds"""
    return (bounds[0] > bounds[1]) | (bounds[2] > bounds[3])


def _intersect(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(4, ...) of bounds that broadcast against each other"""
    low, high = np.maximum(a[0::2], b[0::2]), np.minimum(a[1::2], b[1::2])
    return np.stack([low[0], high[0], low[1], high[1]])


def _union(bounds: np.ndarray) -> np.ndarray:
    """(4, set) -> (4,) around the sets that are not empty; empty when all are."""
    kept = bounds[:, ~_is_empty(bounds)]
    if not kept.shape[1]:
        return NOTHING
    return np.array([kept[0].min(), kept[1].max(), kept[2].min(), kept[3].max()])


def finest_tangent(points_fs: np.ndarray, centers_fs: np.ndarray, widths_m: np.ndarray) -> float:
    """Of a texel which on no receiver, (n, 3) face space, is smaller than TEXELS_PER_EYE_PIXEL of the (n,) widths that the eye's pixels
    have there: d_lt / d_er of Gavane & Watson 2022 b, eq. 6, the most demanding receiver and view counting."""
    distances = np.linalg.norm(points_fs, axis=1) + np.linalg.norm(centers_fs, axis=1).max()
    return float((widths_m / distances).min()) / TEXELS_PER_EYE_PIXEL


def _may_be_outermost(points: np.ndarray, eyes: np.ndarray, near_m: float, limits: tuple[float, float, float, float]) -> np.ndarray:
    """(n,) bool: points, (n, 3) face space, without which some view, (m, 3) centres, might see narrower bounds of all. The others lie, for
    every view, between points that all views see."""
    low, high = eyes.min(axis=0), eyes.max(axis=0)
    nearest, farthest = points[:, 2] - high[2], points[:, 2] - low[2]
    is_before = nearest > near_m
    is_seen, spans = is_before.copy(), []
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in (0, 1):
            left, right = points[:, axis] - high[axis], points[:, axis] - low[axis]
            spans.append((np.minimum(left / nearest, left / farthest), np.maximum(right / nearest, right / farthest)))
            is_seen &= (spans[axis][0] > limits[2 * axis]) & (spans[axis][1] < limits[2 * axis + 1])
    may_be = ~is_before
    for lowest, highest in spans:
        # the second of each is what some point reaches in every view
        may_be |= lowest <= highest[is_seen].min(initial=np.inf)
        may_be |= highest >= lowest[is_seen].max(initial=-np.inf)
    return may_be


def _searched_places(points: np.ndarray, lit_from: np.ndarray, depth_m: float) -> np.ndarray:
    """With (n, 3) receivers, the (n * (1 + m), 3) places where rays from them to (m, 3) points of the light are at a depth. Between
    the two lies, seen from the light's centre, all that may be in the way. Face space"""
    toward = lit_from[:, None] - points
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip((points[:, 2] - depth_m) / -toward[..., 2], 0, 1)
    return np.concatenate([points, (points + np.nan_to_num(share)[..., None] * toward).reshape(-1, 3)])


def fit_face(
    face: Face,
    light: Light,
    samples_m: np.ndarray,
    casters: CasterSet,
    receivers: Receivers,
    resolution_px: int,
    pixels: EyePixels | None = None,
    searched_m: np.ndarray | None = None,
) -> FittedFace | None:
    """Windows of all views of a face. None when the face holds no receiver; without casters when nothing in it is shadowed.

    pixels: of the eye, which decide how fine maps have to be; None: they have `resolution_px`. searched_m: as of `fit_light`
    """
    rotation, center = face.face_from_world, light.world_from_light[:3, 3]
    centers_fs = samples_m @ light_axes(light) @ rotation.T
    hull_fs = (light_hull(light, samples_m) - center) @ rotation.T
    points = (receivers.points_ws - center) @ rotation.T
    goes_on = _goes_on_beyond(points, face.limits)
    far_m = float(points[:, 2].max() - hull_fs[:, 2].min())
    if far_m <= 0:
        return None
    in_face = _may_be_in_face(points[:, None], hull_fs, NEAR_SHARE_OF_FAR * far_m, face.limits)
    if not in_face.any():
        return None
    points = points[in_face]
    finest = None if pixels is None else finest_tangent(points, centers_fs, pixels.widths_m(receivers.points_ws[in_face]))
    far_m = float(points[:, 2].max() - hull_fs[:, 2].min()) * (1 + min(receivers.margin, 1.0))
    near_m = NEAR_SHARE_OF_FAR * far_m

    corners = (casters.corners_ws - center) @ rotation.T
    limits = face.limits
    if searched_m is not None:
        depths = corners[..., 2]
        first_m = max(near_m, float(depths.min(axis=-1)[depths.max(axis=-1) > near_m].min(initial=np.inf)))
        points = _searched_places(points, box_corners(searched_m) @ light_axes(light) @ rotation.T, first_m)
        left, right, bottom, top = face.limits
        limits = (left - SEARCH_TANGENT, right + SEARCH_TANGENT, bottom - SEARCH_TANGENT, top + SEARCH_TANGENT)
    may_be_seen = _may_be_in_face(corners, hull_fs, near_m, limits)
    corners, caster_indices = corners[may_be_seen], casters.indices[may_be_seen]
    exact = len(centers_fs) * len(corners) <= MAX_PAIRS
    eyes = centers_fs if exact else hull_fs
    seen = np.zeros((len(eyes), len(corners)), bool)
    windows = np.zeros((4, len(eyes)))
    has_receivers = np.zeros(len(eyes), bool)
    nearest_m = np.inf
    # coordinate by coordinate: views times corners are what this function's time goes by
    outermost = points[_may_be_outermost(points, eyes, near_m, limits)]
    receiving, casting = np.ascontiguousarray(outermost.T)[:, None], np.ascontiguousarray(corners.transpose(2, 1, 0))
    for index, eye in enumerate(eyes):
        received = _to_seams(_union(_tangent_bounds(receiving - eye[:, None, None], near_m, limits)), goes_on, limits)
        received = _with_margin(received, receivers.margin, limits, receivers.gap_tangent)
        has_receivers[index] = not _is_empty(received)
        from_eye = casting - eye[:, None, None]
        shadowing = _intersect(_tangent_bounds(from_eye, near_m, limits), received[:, None])
        depth = from_eye[2].min(axis=0)
        shadowing[:, depth >= far_m] = NOTHING[:, None]
        seen[index] = ~_is_empty(shadowing)
        nearest_m = min(nearest_m, depth[seen[index]].min(initial=np.inf))
        windows[:, index] = _union(shadowing)
    needed = seen.any(axis=0)
    if not needed.any():
        return _face_without_casters(face, light, centers_fs, samples_m, near_m, far_m)
    if not exact:
        windows = np.tile(_union(windows)[:, None], len(centers_fs))
        seen = np.tile(needed, (len(centers_fs), 1))
        has_receivers = np.tile(has_receivers.any(), len(centers_fs))
    windows[:, _is_empty(windows)] = 0
    views = fit_windows(face, centers_fs, samples_m, windows.T, resolution_px, near_m, far_m, center, finest_tangent=finest)
    return FittedFace(views, caster_indices[needed], seen[:, needed], has_receivers, float(nearest_m))


def has_thin_walls(snapshot: SceneSnapshot, light: Light, bounds: SceneBounds, faces: Iterable[FittedFace]) -> bool:
    """Whether casters of some face may have receivers right behind their foot: they are not closed, and have triangles as large as
    walls, as far as those tell that predictions are made from (`Mesh.sampled_sizes`). Behind walls of what is closed lies what is in it."""
    perimeters_m = np.array([0.0 if mesh.is_closed else mesh.sampled_sizes[1].max(initial=0.0) for mesh in snapshot.meshes])
    for fitted in faces:
        indices, texel = fitted.caster_indices, max(fitted.views.texel_tangent)
        perimeter = perimeters_m[snapshot.instances.mesh_index[indices]]
        indices, perimeter = indices[perimeter > 0], perimeter[perimeter > 0]
        scale = np.linalg.norm(snapshot.instances.world_from_object[indices, :3, :3], axis=1).max(axis=1)
        texels = perimeter * scale / texel
        if light.shape is not LightShape.SUN:
            texels /= bounds.distances_m(indices, light.world_from_light[:3, 3])
        if (texels > WALL_PERIMETER_TEXELS).any():
            return True
    return False


def _goes_on_beyond(points: np.ndarray, limits: tuple[float, float, float, float]) -> np.ndarray:
    """(4,) bool: whether there are receivers, (n, 3) face space, right beyond the left, right, bottom and top limit."""
    before = points[points[:, 2] > 0]
    tangents = before[:, :2] / before[:, 2:]
    is_between = (tangents >= np.array(limits)[0::2]) & (tangents <= np.array(limits)[1::2])
    found = []
    for axis in (0, 1):
        own, other = tangents[:, axis], is_between[:, 1 - axis]
        low, high = limits[2 * axis], limits[2 * axis + 1]
        found += [(other & (own < low) & (own > low - SEAM_TANGENT)).any(), (other & (own > high) & (own < high + SEAM_TANGENT)).any()]
    return np.array(found)


def _to_seams(bounds: np.ndarray, goes_on: np.ndarray, limits: tuple[float, float, float, float]) -> np.ndarray:
    """Receivers are some of many pixels: where they go on beyond a limit, others lie between it and the last of them that is known."""
    is_near = np.abs(bounds - limits) < SEAM_TANGENT
    return np.where(goes_on & is_near & ~_is_empty(bounds), limits, bounds)


def _with_margin(bounds: np.ndarray, margin: float, limits: tuple[float, float, float, float], least: float = 0.0) -> np.ndarray:
    """Grown by the share `margin`, or by more, on every side, within the limits; empty bounds stay empty."""
    if _is_empty(bounds):
        return bounds
    x, y = max(margin * (bounds[1] - bounds[0]), least), max(margin * (bounds[3] - bounds[2]), least)
    return _intersect(bounds + np.array([-x, x, -y, y]), np.array(limits))


def _face_without_casters(
    face: Face, light: Light, centers_fs: np.ndarray, samples_m: np.ndarray, near_m: float, far_m: float
) -> FittedFace:
    count, is_sun = len(centers_fs), light.shape is LightShape.SUN
    origin_ws = light.world_from_light[:3, 3]
    views = FaceViews(
        face, centers_fs, samples_m, (1.0, 1.0), np.zeros((count, 2), np.int64), 0, 0, near_m, far_m, origin_ws, is_orthographic=is_sun
    )
    return FittedFace(views, np.zeros(0, np.int64), np.zeros((count, 0), bool), np.ones(count, bool), np.inf)


def _sheared_bounds(points: np.ndarray, shear: np.ndarray) -> np.ndarray:
    """(3, point, set) along the sun's axes -> (4, set) left, right, bottom, top where the map of a direction has them, metres"""
    x, y = (points[axis] - shear[axis] * points[2] for axis in (0, 1))
    return np.stack([x.min(axis=0), x.max(axis=0), y.min(axis=0), y.max(axis=0)])


def fit_sun(
    light: Light,
    samples_m: np.ndarray,
    casters: CasterSet,
    receivers: Receivers,
    resolution_px: int,
    bounds: SceneBounds,
    searched_m: np.ndarray | None = None,
) -> FittedFace:
    """Windows of all views of a sun: what casts, however far towards the sun, intersected with the receivers. The lattice hangs on
    `SceneBounds.yardstick_ws`, whatever depth is counted from."""
    axes, limits = light_axes(light), (-np.inf, np.inf, -np.inf, np.inf)
    face = Face("sun", 0, axes, limits)
    points, corners = ((places_ws - bounds.yardstick_ws) @ axes.T for places_ws in (receivers.points_ws, casters.corners_ws))
    farthest = float(points[:, 2].max())
    deepest_first = corners[..., 2].min(axis=-1)
    if searched_m is not None:
        before_m = np.maximum(points[:, 2] - deepest_first.min(initial=np.inf), 0)
        aside = points[:, None] - before_m[:, None, None] * (box_corners(searched_m) * [1, 1, 0])
        points = np.concatenate([points, aside.reshape(-1, 3)])
    seen = np.zeros((len(samples_m), len(corners)), bool)
    exact = len(samples_m) * len(corners) <= MAX_PAIRS
    shears = samples_m[:, :2] if exact else box_corners(samples_m)[:, :2]
    views_of = [np.array([index]) for index in range(len(samples_m))] if exact else [np.arange(len(samples_m))] * len(shears)
    found = []
    receiving, casting = np.ascontiguousarray(points.T)[..., None], np.ascontiguousarray(corners.transpose(2, 1, 0))
    for index, shear in enumerate(shears):
        received = _with_margin(_sheared_bounds(receiving, shear)[:, 0], receivers.margin, limits)
        shadowing = _intersect(_sheared_bounds(casting, shear), received[:, None])
        shadowing[:, deepest_first >= farthest] = NOTHING[:, None]
        seen[views_of[index]] |= ~_is_empty(shadowing)
        found.append(_union(shadowing))
    needed = seen.any(axis=0)
    if not needed.any():
        return _face_without_casters(face, light, np.zeros_like(samples_m), samples_m, NEAR_SHARE_OF_FAR, 1.0)
    windows = np.stack(found, axis=1) if exact else np.tile(_union(np.stack(found, axis=1))[:, None], len(samples_m))
    first = float(deepest_first[needed].min())
    depth_m = max(farthest - first, LEAST_WIDTH * bounds.yardstick_m) * (1 + min(receivers.margin, 1.0))
    near_m = float(NEAR_SHARE_OF_FAR * depth_m)
    start = first - 2 * near_m
    # moving the origin along the axis moves a sheared view: its centre moves back by as much
    centers_fs = samples_m * start
    # a view without casters looks where another does: wherever else that is, the lattice would have to reach there
    empty = _is_empty(windows)
    sides = centers_fs[:, [0, 0, 1, 1]].T
    windows[:, empty] = (windows + sides)[[0, 0, 2, 2]][:, ~empty][:, :1] - sides[:, empty]
    far_m, origin_ws = depth_m + 3 * near_m, bounds.yardstick_ws + start * axes[2]
    unit_m = bounds.yardstick_m
    views = fit_windows(face, centers_fs, samples_m, windows.T, resolution_px, near_m, far_m, origin_ws, shear_depth_m=depth_m, unit=unit_m)
    return FittedFace(views, casters.indices[needed], seen[:, needed], np.ones(len(samples_m), bool), near_m)


def fit_light(
    snapshot: SceneSnapshot,
    light: Light,
    samples_m: np.ndarray,
    bounds: SceneBounds,
    receivers: Receivers,
    resolution_px: int,
    pixels: EyePixels | None = None,
    searched_m: np.ndarray | None = None,
) -> tuple[list[FittedFace], bool]:
    """All faces of a light that hold receivers, and whether it took a cube.

    pixels: as of `fit_face`; not of suns. searched_m: (n, 3) points of the light, as `samples_m`, for views in which is searched for
    what is between them and the receivers.
    """
    if not len(receivers.points_ws):
        return [], False
    casters = shadowing_casters(snapshot, light, bounds, receivers.points_ws, samples_m if searched_m is None else searched_m)
    if light.shape is LightShape.SUN:
        return [fit_sun(light, samples_m, casters, receivers, resolution_px, bounds, searched_m)], False
    faces = choose_faces(light, receivers.points_ws, samples_m)
    if len(faces) > 1:
        receivers = replace(receivers, points_ws=np.concatenate([receivers.points_ws, receivers.beyond_ws]))
    fitted = (fit_face(face, light, samples_m, casters, receivers, resolution_px, pixels, searched_m) for face in faces)
    return [face for face in fitted if face is not None], len(faces) > 1
