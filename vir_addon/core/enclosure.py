"""What closes around a light or the camera: then none of it reaches what is seen on the other side, and no map has to find that out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from .bounds import SceneBounds, stand_apart
from .mesh_topology import is_closed
from .passes.percentage_closer import light_radius_m
from .reach import casts_for
from .scene import Camera, Instances, Light, LightShape, Mesh, SceneSnapshot
from .views import light_axes

NO_AREA = 1e-9
"""of the square over a triangle's edge: less is rounding"""
RAYS = np.array([(0.1832, -0.2917, 1.0), (1.0, 0.2389, -0.1653)])
"""directions in which no scene's edges run; their opposites are looked along, too"""
LIGHT_MARGIN = 1e-4
"""of a light's extent: what is nearer to it may touch it"""
WINDOW_MARGIN = 0.1
"""of the camera's window: pixel filters reach beyond it"""
TOUCHING = 1e-5
"""of a box's size: what reaches into it by less stands beside it"""


def sealing_object(snapshot: SceneSnapshot, light: Light, bounds: SceneBounds) -> str | None:
    """The name of an object that casts this light's shadow, closes around all of the light and keeps it from what the camera sees: it has
    the camera outside or, where the camera does not see it, all that the camera may see. None if there is none, or none that this can be
    told of: of open meshes, and of cut-outs, the maps tell."""
    if light.shape is LightShape.SUN or not light.casts_shadow:
        return None
    instances, centre_ws = snapshot.instances, light.world_from_light[:3, 3]
    low_ws, high_ws = bounds.extents_ws
    is_around = ((low_ws < centre_ws[:, None]) & (high_ws > centre_ws[:, None])).all(axis=0)
    candidates = np.flatnonzero(is_around & casts_for(snapshot, light))
    # what the eye sees through hides nothing of what is within
    candidates = candidates[[snapshot.meshes[mesh].opacity_map is None for mesh in instances.mesh_index[candidates]]]
    is_seen = instances.visible_to_camera[candidates]
    has_eye_outside = stand_apart(snapshot, bounds, _places_of_eye(snapshot.camera), candidates)
    candidates = candidates[has_eye_outside | ~is_seen]
    found = next((index for index in candidates if _seals(snapshot, index, light, bounds)), None)
    return _object_name(instances, found)


def _places_of_eye(camera: Camera) -> np.ndarray:
    """(n, 3) world space: corners of the hull of all places from where the camera's rays start, and where clipping lets them begin"""
    left, right, bottom, top = camera.window
    x = np.array([left, right]) + WINDOW_MARGIN * (right - left) * np.array([-1, 1])
    y = np.array([bottom, top]) + WINDOW_MARGIN * (top - bottom) * np.array([-1, 1])
    corners = np.array([(u, v + camera.skew * u, -1.0) for u in x for v in y])
    if camera.is_orthographic:
        corners[:, 2] *= camera.clip_start_m
    else:
        corners = np.concatenate([corners * camera.clip_start_m, np.zeros((1, 3))])
    return corners @ camera.world_from_view[:3, :3].T + camera.world_from_view[:3, 3]


def _seals(snapshot: SceneSnapshot, instance: np.int64, light: Light, bounds: SceneBounds) -> bool:
    """instance: if the camera sees it, it has the camera outside"""
    is_empty = snapshot.instances.visible_to_camera[instance] or not _what_is_seen_enters(snapshot, instance, bounds)
    return is_empty and _closes_around(snapshot, instance, light)


def _what_is_seen_enters(snapshot: SceneSnapshot, instance: np.int64, bounds: SceneBounds) -> bool:
    """Whether anything that the camera may see comes into both an instance's box and the ball around its mesh."""
    instances = snapshot.instances
    mesh_index = instances.mesh_index[instance]
    low, high = bounds.mesh_bounds_os[mesh_index]
    half = (1 - TOUCHING) * (high - low) / 2
    box_from_world = np.linalg.inv(instances.world_from_object[instance].astype(np.float64))
    box_from_world[:3, 3] -= (low + high) / 2
    seen = np.flatnonzero(instances.visible_to_camera)
    corners = bounds.corners_ws[seen] @ box_from_world[:3, :3].T + box_from_world[:3, 3]
    is_beside = ((corners > half).all(axis=1) | (corners < -half).all(axis=1)).any(axis=1)
    if is_beside.all():
        return False
    radius = (1 - TOUCHING) * np.linalg.norm(snapshot.meshes[mesh_index].positions_os - (low + high) / 2, axis=1).max()
    return any(_enters(snapshot, other, box_from_world, half, radius) for other in seen[~is_beside])


def _enters(snapshot: SceneSnapshot, instance: np.int64, box_from_world: np.ndarray, half: np.ndarray, radius: float) -> bool:
    """Whether an instance's triangles may come into both the box between -half and half, (3,), and a ball around its middle: none does
    where each has the box beside it or on one side of its plane, or keeps away from the middle."""
    mesh = snapshot.meshes[snapshot.instances.mesh_index[instance]]
    box_from_object = box_from_world @ snapshot.instances.world_from_object[instance].astype(np.float64)
    positions = mesh.positions_os @ box_from_object[:3, :3].T + box_from_object[:3, 3]
    a, b, c = np.moveaxis(positions[mesh.triangles[_near(positions, mesh.triangles, np.zeros(3), half)]], 1, 0)
    normal = np.cross(b - a, c - a)
    crosses_box = np.abs((normal * a).sum(axis=1)) <= np.abs(normal) @ half
    return bool((crosses_box & (distances_to_origin(a, b, c) <= radius)).any())


def _closes_around(snapshot: SceneSnapshot, instance: np.int64, light: Light) -> bool:
    """Whether a closed part of an instance's mesh is all around the light."""
    reach_m = light_radius_m(light) * (1 + LIGHT_MARGIN)
    around = _parts_around(snapshot, instance, light.world_from_light[:3, 3], reach_m)
    return any(not _meet_light(corners_m, light) for _, corners_m in around)


def _parts_around(snapshot: SceneSnapshot, instance: np.int64, centre_ws: np.ndarray, reach_m: float) -> Iterator[tuple[int, np.ndarray]]:
    """Closed parts of an instance's mesh around a place, and of each the triangles that may come as near to it as `reach_m`, (n, 3, 3) from
    there along the world's axes."""
    mesh = snapshot.meshes[snapshot.instances.mesh_index[instance]]
    crossings = _all_crossings(snapshot, instance, centre_ws)
    if not all(len(crossed) for crossed, _ in crossings):
        return  # a way out
    windings = _windings(mesh, crossings)
    for part in np.flatnonzero((windings[0] != 0) & (windings == windings[0]).all(axis=0)):
        if is_closed(mesh.welded_triangles[mesh.part_of_triangle == part], mesh.vertex_count):
            yield int(part), _near_of_part(snapshot, instance, int(part), centre_ws, reach_m)


def _all_crossings(snapshot: SceneSnapshot, instance: np.int64, centre_ws: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """As of `_crossings`, along RAYS and their opposites, until one crosses nothing"""
    mesh, centre_os = snapshot.meshes[snapshot.instances.mesh_index[instance]], _in_object(snapshot, instance, centre_ws)
    crossings: list[tuple[np.ndarray, np.ndarray]] = []
    for ray in RAYS:
        crossings += _crossings(mesh.positions_os, mesh.triangles, centre_os, ray)
        if not all(len(crossed) for crossed, _ in crossings):
            break
    return crossings


def _windings(mesh: Mesh, crossings: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(rays, parts) how often each part of the mesh winds around where the rays start"""
    part = mesh.part_of_triangle
    return np.array([np.bincount(part[crossed], signs, minlength=mesh.vertex_count) for crossed, signs in crossings])


def _in_object(snapshot: SceneSnapshot, instance: np.int64, place_ws: np.ndarray) -> np.ndarray:
    object_from_world = np.linalg.inv(snapshot.instances.world_from_object[instance].astype(np.float64))
    return object_from_world[:3, :3] @ place_ws + object_from_world[:3, 3]


def _near_of_part(snapshot: SceneSnapshot, instance: np.int64, part: int, centre_ws: np.ndarray, reach_m: float) -> np.ndarray:
    mesh = snapshot.meshes[snapshot.instances.mesh_index[instance]]
    matrix = snapshot.instances.world_from_object[instance, :3, :3].astype(np.float64)
    centre_os, reach_os = _in_object(snapshot, instance, centre_ws), reach_m * np.linalg.norm(np.linalg.inv(matrix), axis=1)
    near = _near(mesh.positions_os, mesh.triangles, centre_os, reach_os)
    return (mesh.positions_os[mesh.triangles[near[mesh.part_of_triangle[near] == part]]] - centre_os) @ matrix.T


class CameraShell(NamedTuple):
    """Something closed that all of what the camera sees is in, its own inner side included."""

    instance: np.int64
    part: int
    """of its mesh, as of `Mesh.part_of_triangle`"""


def camera_shells(snapshot: SceneSnapshot, bounds: SceneBounds) -> list[CameraShell]:
    """What the camera sees, and cannot see through, all around where its rays start. 20 ms for a million triangles around it, and once
    what `Mesh.part_of_triangle` takes."""
    instances = snapshot.instances
    places_ws = _places_of_eye(snapshot.camera)
    centre_ws = (places_ws.min(axis=0) + places_ws.max(axis=0)) / 2
    radius_m = float(np.linalg.norm(places_ws - centre_ws, axis=1).max())
    low_ws, high_ws = bounds.extents_ws
    is_around = ((low_ws < (centre_ws - radius_m)[:, None]) & (high_ws > (centre_ws + radius_m)[:, None])).all(axis=0)
    candidates = np.flatnonzero(is_around & instances.visible_to_camera)
    return [
        CameraShell(index, part)
        for index in candidates
        if snapshot.meshes[instances.mesh_index[index]].opacity_map is None
        for part, corners_m in _parts_around(snapshot, index, centre_ws, radius_m)
        if (distances_to_origin(*np.moveaxis(corners_m, 1, 0)) > radius_m).all()
    ]


def shell_against(snapshot: SceneSnapshot, light: Light, shells: Sequence[CameraShell]) -> str | None:
    """The name of one of the camera's shells that casts this light's shadow and has all of the light outside."""
    if not light.casts_shadow:
        return None
    instances, casts = snapshot.instances, casts_for(snapshot, light)
    found = next((shell.instance for shell in shells if casts[shell.instance] and _is_outside(snapshot, shell, light)), None)
    return _object_name(instances, found)


def _object_name(instances: Instances, index: np.int64 | None) -> str | None:
    return None if index is None else instances.object_names[instances.object_index[index]]


def _is_outside(snapshot: SceneSnapshot, shell: CameraShell, light: Light) -> bool:
    if light.shape is LightShape.SUN:
        return True
    centre_ws = light.world_from_light[:3, 3]
    mesh = snapshot.meshes[snapshot.instances.mesh_index[shell.instance]]
    crossings = _all_crossings(snapshot, shell.instance, centre_ws)
    if _windings(mesh, crossings)[:, shell.part].any():
        return False
    near_m = _near_of_part(snapshot, shell.instance, shell.part, centre_ws, light_radius_m(light) * (1 + LIGHT_MARGIN))
    return not _meet_light(near_m, light)


def _crossings(positions: np.ndarray, triangles: np.ndarray, origin: np.ndarray, ray: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Which triangles a ray crosses, and its opposite: (n,) int64 indices and (n,) float64, 1 where it comes from behind and -1 where it
    comes from the front. positions: (vertex_count, 3) float32; ray: (3,), its longest component is 1. 20 ms for a million triangles.

    Summed over a closed surface the signs are how often it winds around the origin, along any ray (its winding number)."""
    main = int(np.argmax(ray))
    axes = (main + 1) % 3, (main + 2) % 3  # right-handed with the ray

    def across(axis: int) -> np.ndarray:
        return positions[:, axis] - origin[axis] - ray[axis] * (positions[:, main] - origin[main])

    x, y = across(axes[0]), across(axes[1])
    # most lie wholly to one side of it
    side = (x > 0).view(np.uint8) | (y > 0).view(np.uint8) << 1
    a, b, c = side[triangles].T
    near = np.flatnonzero((a | b | c) & ~(a & b & c) == 3)
    corners = triangles[near]
    x, y, along = x[corners], y[corners], positions[:, main][corners] - origin[main]
    # twice the areas of the triangles that the origin makes with the sides, opposite of the corners
    areas = np.stack([x[:, i] * y[:, j] - x[:, j] * y[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    is_crossed = (areas > 0).all(axis=1) | (areas < 0).all(axis=1)
    near, areas, along = near[is_crossed], areas[is_crossed], along[is_crossed]
    signs = np.sign(areas[:, 0])
    distance = (areas * along).sum(axis=1) * signs
    return [(near[distance > 0], signs[distance > 0]), (near[distance < 0], -signs[distance < 0])]


def _near(positions: np.ndarray, triangles: np.ndarray, centre: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(n,) int64 triangles but for those that lie wholly beyond one side of a box."""
    beyond = np.zeros(len(positions), np.uint8)
    for axis in range(3):
        offset = positions[:, axis] - centre[axis]
        beyond |= (offset > reach[axis]).view(np.uint8) << 2 * axis | (offset < -reach[axis]).view(np.uint8) << 2 * axis + 1
    a, b, c = beyond[triangles].T
    return np.flatnonzero(a & b & c == 0)


def _meet_light(corners_m: np.ndarray, light: Light) -> bool:
    """Whether any of (n, 3, 3) triangles, from the light's centre along the world's axes, comes as near to the light as it reaches."""
    near = corners_m[distances_to_origin(*np.moveaxis(corners_m, 1, 0)) <= light_radius_m(light) * (1 + LIGHT_MARGIN)]
    if light.shape.is_omni or not len(near):
        return len(near) > 0
    half_m = np.array([light.size_x_m, light.size_y_m]) / 2 * (1 + LIGHT_MARGIN)
    return _meet_rectangle(near @ light_axes(light).T, half_m)


def _meet_rectangle(triangles: np.ndarray, half: np.ndarray) -> bool:
    """Whether any of (n, 3, 3) triangles meets the rectangle |x| <= half[0], |y| <= half[1] of the plane z = 0."""
    following = np.roll(triangles, -1, axis=1)
    z, z_after = triangles[..., 2], following[..., 2]
    crosses = (z <= 0) != (z_after <= 0)  # two sides of what lies on both sides of the plane
    if ((z == 0).any(axis=1) & ~crosses.any(axis=1)).any():
        return True  # touches the plane from below: it is not worth finding out where
    after = crosses.any(axis=1)
    share = np.divide(z, z - z_after, out=np.zeros_like(z), where=crosses)[..., None]
    ends = (triangles + share * (following - triangles))[after][crosses[after]][:, :2].reshape(-1, 2, 2)
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.stack([(-half - start) / along, (half - start) / along])
    is_between = np.abs(start) <= half
    # a segment along one side's direction is between its two lines all the way or nowhere
    enters = np.where(along == 0, np.where(is_between, -np.inf, np.inf), bounds.min(axis=0)).max(axis=1)
    leaves = np.where(along == 0, np.inf, bounds.max(axis=0)).min(axis=1)
    return bool((np.maximum(enters, 0) <= np.minimum(leaves, 1)).any())


def distances_to_origin(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(n,) from the origin to triangles with (n, 3) corners"""

    def to_segment(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        along = end - start
        share = np.clip(-(start * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30), 0, 1)
        return np.linalg.norm(start + share[:, None] * along, axis=1)

    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    sides = [np.einsum("ij,ij->i", np.cross(end - start, -start), normal) for start, end in ((a, b), (b, c), (c, a))]
    # what has no area, as at a sphere's poles, has no plane
    has_plane = length > NO_AREA * np.maximum(((b - a) ** 2).sum(axis=1), ((c - a) ** 2).sum(axis=1))
    over = np.all(np.array(sides) >= 0, axis=0) & has_plane
    plane = np.abs((a * normal).sum(axis=1)) / np.maximum(length, 1e-30)
    edges = np.minimum(np.minimum(to_segment(a, b), to_segment(b, c)), to_segment(c, a))
    return np.where(over, plane, edges)
