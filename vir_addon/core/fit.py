"""Fitting a light's views to what casts and what receives.

A map is needed only where something that casts lies before something visible: what lies outside every caster's
outline is lit. So a view's window is the bounds of (casters' outlines intersected with the receivers' bounds), casters that
cannot shadow a visible receiver left out. Receivers are the surfaces of the first eye G-buffer that the light can reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import Light, SceneSnapshot
from .views import MAX_SINGLE_FACE_TANGENT, NEAR_SHARE_OF_FAR, Face, FaceViews, area_light_faces, fit_windows, light_axes

MAX_RECEIVER_POINTS = 16384
RECEIVER_MARGIN = 0.02
"""Windows are wider than the receivers seen first by this share: later eye samples shift by parts of a pixel and see a little more."""
FLAT_TOLERANCE = 1e-5
"""thickness over extent below which a mesh counts as flat"""
MAX_PAIRS = 4_000_000
"""view-instance pairs evaluated exactly; beyond it all views share one window"""


@dataclass(frozen=True)
class CasterSet:
    """Instances that may cast, with what fitting needs of them."""

    indices: np.ndarray
    """(caster_count,) int64 instance numbers"""
    corners_ws: np.ndarray
    """(caster_count, 8, 3) float64 corners of their bounding boxes"""


@dataclass(frozen=True)
class FittedFace:
    views: FaceViews
    caster_indices: np.ndarray
    """(n,) int64 instances that some view needs"""
    seen_by_view: np.ndarray
    """(view_count, n) bool: which view needs which"""


def instance_corners(snapshot: SceneSnapshot) -> np.ndarray:
    """(instance_count, 8, 3) float64 world-space corners of every instance's bounding box"""
    bounds = np.array([mesh.compute_bounds_os() for mesh in snapshot.meshes], np.float64).reshape(-1, 2, 3)
    pick = np.array([[(i >> axis) & 1 for axis in range(3)] for i in range(8)])
    corners_os = bounds[:, pick, np.arange(3)][snapshot.instances.mesh_index]
    matrix = snapshot.instances.world_from_object.astype(np.float64)
    return np.einsum("nij,nkj->nki", matrix[:, :3, :3], corners_os) + matrix[:, None, :3, 3]


def light_casters(snapshot: SceneSnapshot, light: Light) -> np.ndarray:
    """(n,) int64 instances that may cast this light's shadow."""
    mask = snapshot.instances.casts_shadow if light.blockers is None else light.blockers
    return np.flatnonzero(mask)


def select_receivers(positions: np.ndarray, normals: np.ndarray, light: Light) -> np.ndarray:
    """Visible points that the light can reach: before its plane and (by either normal) turned towards some of it.

    positions, normals: the G-buffer's textures, (height, width, 4). Returns (n, 3) float64 world space: a regular subset
    and, in slices of depth, the outermost points, which decide the windows.
    """
    surface = positions[..., 3] >= 0
    if light.receivers is not None:
        surface &= light.receivers[np.maximum(positions[..., 3], 0).astype(np.int64)]
    points = positions[surface][:, :3].astype(np.float64)
    normal = normals[surface][:, :3]
    axes, center = light_axes(light), light.world_from_light[:3, 3]
    half = np.hypot(light.size_x_m, light.size_y_m) / 2
    p = (points - center) @ axes.T
    # the light's nearest point to the plane of the surface decides whether any of it is above the horizon; the shading normal
    # may lean towards the light by as much again, so surfaces turned away by a little are kept
    turned = np.einsum("ij,ij->i", normal @ axes.T, -p) > -half - 0.5 * np.linalg.norm(p, axis=1)
    reach = (p[:, 2] > 0) & turned
    points, p = points[reach], p[reach]
    if len(points) <= MAX_RECEIVER_POINTS:
        return points
    chosen = [np.arange(0, len(points), -(-len(points) // MAX_RECEIVER_POINTS))]
    tangents = p[:, :2] / p[:, 2:]
    slices = np.argsort(p[:, 2], kind="stable")
    for part in np.array_split(slices, 32):
        chosen += [part[tangents[part].argmin(axis=0)], part[tangents[part].argmax(axis=0)], part[[0, -1]]]
    return points[np.unique(np.concatenate(chosen))]


def needs_cube(light: Light, receivers_ws: np.ndarray, samples_m: np.ndarray) -> bool:
    """Whether one frustum of at most 100 degrees leaves out a receiver, seen from any light sample."""
    p = (receivers_ws - light.world_from_light[:3, 3]) @ light_axes(light).T
    reach = np.abs(p[:, :2]) + np.abs(samples_m).max(axis=0)
    return bool((reach > MAX_SINGLE_FACE_TANGENT * (1 - RECEIVER_MARGIN) * p[:, 2:]).any())


def _is_lit_side_plane(snapshot: SceneSnapshot, instance: int, light_corners_ws: np.ndarray, receivers_ws: np.ndarray) -> bool:
    """Whether a caster is flat with the light and every receiver on the same side: then it shadows nothing, itself included."""
    mesh = snapshot.meshes[int(snapshot.instances.mesh_index[instance])]
    extent = np.ptp(mesh.compute_bounds_os().astype(np.float64), axis=0)
    axis = int(extent.argmin())
    if extent[axis] > FLAT_TOLERANCE * extent.max():
        return False
    matrix = snapshot.instances.world_from_object[instance].astype(np.float64)
    normal = np.linalg.inv(matrix[:3, :3])[axis]
    length = np.linalg.norm(normal)
    origin = matrix[:3, :3] @ mesh.positions_os[mesh.triangles[0, 0]].astype(np.float64) + matrix[:3, 3]
    light_side = (light_corners_ws - origin) @ normal / length
    receiver_side = (receivers_ws - origin) @ normal / length
    if light_side.min() < 0:
        light_side, receiver_side = -light_side, -receiver_side
    size = np.linalg.norm(matrix[:3, :3] @ extent)
    return bool(light_side.min() > 0 and receiver_side.min() > -10 * FLAT_TOLERANCE * size)


def shadowing_casters(snapshot: SceneSnapshot, light: Light, corners_ws: np.ndarray, receivers_ws: np.ndarray, samples_m: np.ndarray) -> CasterSet:
    """Casters of the light without flat ones that shadow nothing visible."""
    light_corners_ws = light_hull(light, samples_m)
    kept = [i for i in light_casters(snapshot, light) if not _is_lit_side_plane(snapshot, i, light_corners_ws, receivers_ws)]
    indices = np.array(kept, np.int64)
    return CasterSet(indices, corners_ws[indices])


def light_hull(light: Light, samples_m: np.ndarray) -> np.ndarray:
    """(1 or 4, 3) float64 world-space corners of a rectangle around all light samples"""
    low, high = samples_m.min(axis=0), samples_m.max(axis=0)
    corners = np.unique(np.array([[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], [high[0], high[1]]]), axis=0)
    rotation, center = light.world_from_light[:3, :3], light.world_from_light[:3, 3]
    return center + corners @ rotation[:, :2].T


def _tangent_bounds(points: np.ndarray, near_m: float, limits: tuple[float, float, float, float]) -> np.ndarray:
    """Bounds of point sets seen from views: points (view, set, point, 3) -> (view, set, 4) left, right, bottom, top clipped to the limits.

    A set that reaches behind the near depth fills the limits. Sets without a visible point have left > right.
    """
    z = points[..., 2]
    crossing = (z <= near_m).any(axis=-1)
    safe = np.maximum(z, near_m)
    bounds = []
    for axis in (0, 1):
        tangent = points[..., axis] / safe
        low, high = limits[2 * axis], limits[2 * axis + 1]
        bounds += [np.where(crossing, low, np.maximum(tangent.min(axis=-1), low)), np.where(crossing, high, np.minimum(tangent.max(axis=-1), high))]
    bounds = np.stack(bounds, axis=-1)
    bounds[(z <= near_m).all(axis=-1)] = np.array([1.0, -1.0, 1.0, -1.0])
    return bounds


def fit_face(
    face: Face, light: Light, samples_m: np.ndarray, casters: CasterSet, receivers_ws: np.ndarray, resolution_px: int
) -> FittedFace | None:
    """Windows of all views of a face. None when the face holds no receiver; without casters when nothing in it is shadowed."""
    rotation = face.face_from_world
    center = light.world_from_light[:3, 3]
    offsets_ws = samples_m @ light.world_from_light[:3, :2].T
    centers_fs = offsets_ws @ rotation.T
    receivers = (receivers_ws - center) @ rotation.T
    hull_fs = (light_hull(light, samples_m) - center) @ rotation.T
    exact = len(samples_m) * max(len(casters.indices), 1) <= MAX_PAIRS
    eyes = centers_fs if exact else hull_fs

    far_m = float(receivers[:, 2].max() - hull_fs[:, 2].min())
    near_m = NEAR_SHARE_OF_FAR * max(far_m, 0.0)
    relative = receivers[None] - hull_fs[:, None]
    bounds = _tangent_bounds(relative[:, :, None], near_m, face.limits)
    inside = (bounds[..., 0] <= bounds[..., 1]) & (bounds[..., 2] <= bounds[..., 3])
    in_face = inside.any(axis=0)
    if far_m <= 0 or not in_face.any():
        return None
    if not len(casters.indices):
        return _face_without_casters(face, centers_fs, near_m, far_m)
    receivers = receivers[in_face]
    far_m = float(receivers[:, 2].max() - hull_fs[:, 2].min()) * (1 + RECEIVER_MARGIN)
    near_m = NEAR_SHARE_OF_FAR * far_m

    received = np.concatenate([_received_bounds(receivers - eye, near_m, face.limits) for eye in eyes])
    corners = (casters.corners_ws - center) @ rotation.T
    cast = np.concatenate([_tangent_bounds((corners - eye)[None], near_m, face.limits) for eye in eyes])
    both = np.stack(
        [
            np.maximum(cast[..., 0], received[:, None, 0]),
            np.minimum(cast[..., 1], received[:, None, 1]),
            np.maximum(cast[..., 2], received[:, None, 2]),
            np.minimum(cast[..., 3], received[:, None, 3]),
        ],
        axis=-1,
    )
    nearest = np.stack([(corners[..., 2] - eye[2]).min(axis=-1) for eye in eyes])
    seen = (both[..., 0] <= both[..., 1]) & (both[..., 2] <= both[..., 3]) & (nearest < far_m)
    needed = seen.any(axis=0)
    if not needed.any():
        return _face_without_casters(face, centers_fs, near_m, far_m)
    low = np.where(seen[..., None], both, np.inf).min(axis=1)
    high = np.where(seen[..., None], both, -np.inf).max(axis=1)
    windows = np.stack([low[:, 0], high[:, 1], low[:, 2], high[:, 3]], axis=-1)
    empty = ~seen.any(axis=1)
    windows[empty] = [0, 0, 0, 0]
    if not exact:
        union = [windows[~empty, 0].min(), windows[~empty, 1].max(), windows[~empty, 2].min(), windows[~empty, 3].max()]
        windows = np.tile(union, (len(samples_m), 1))
        seen = np.tile(needed, (len(samples_m), 1))
    views = fit_windows(face, centers_fs, windows, resolution_px, near_m, far_m)
    return FittedFace(views, casters.indices[needed], seen[:, needed])


def _face_without_casters(face: Face, centers_fs: np.ndarray, near_m: float, far_m: float) -> FittedFace:
    count = len(centers_fs)
    views = FaceViews(face, centers_fs, (1.0, 1.0), np.zeros((count, 2), np.int64), 0, 0, near_m, far_m)
    return FittedFace(views, np.zeros(0, np.int64), np.zeros((count, 0), bool))


def _received_bounds(relative: np.ndarray, near_m: float, limits: tuple[float, float, float, float]) -> np.ndarray:
    """(1, 4) bounds of all receivers from one view, with the margin"""
    bounds = _tangent_bounds(relative[None, :, None], near_m, limits)[0]
    valid = bounds[(bounds[:, 0] <= bounds[:, 1]) & (bounds[:, 2] <= bounds[:, 3])]
    if not len(valid):
        return np.array([[1.0, -1.0, 1.0, -1.0]])
    left, right, bottom, top = valid[:, 0].min(), valid[:, 1].max(), valid[:, 2].min(), valid[:, 3].max()
    grow_x, grow_y = RECEIVER_MARGIN * (right - left), RECEIVER_MARGIN * (top - bottom)
    return np.array([[max(left - grow_x, limits[0]), min(right + grow_x, limits[1]), max(bottom - grow_y, limits[2]), min(top + grow_y, limits[3])]])


def fit_light(
    snapshot: SceneSnapshot, light: Light, samples_m: np.ndarray, corners_ws: np.ndarray, receivers_ws: np.ndarray, resolution_px: int
) -> tuple[list[FittedFace], bool]:
    """All faces of a light that hold receivers, and whether it took a cube."""
    if not len(receivers_ws):
        return [], False
    cube = needs_cube(light, receivers_ws, samples_m)
    casters = shadowing_casters(snapshot, light, corners_ws, receivers_ws, samples_m)
    faces = (fit_face(face, light, samples_m, casters, receivers_ws, resolution_px) for face in area_light_faces(light, cube))
    return [face for face in faces if face is not None], cube
