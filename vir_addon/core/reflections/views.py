"""From where what reflectors show is drawn: cubes within them, or a mirrored eye."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..bounds import SceneBounds
from ..enclosure import distances_to_origin
from ..passes.reflection_maps import MAP_SIZE_STEP_PX, ReflectionMap
from ..scene import Camera, SceneSnapshot

MIN_MAP_PX, MAX_MAP_PX = 64, 1024
MAX_VIEW_PX = 4096
"""of a mirrored view"""
TEXELS_PER_PX = 2
"""of a mirrored view, each way: edges in it are edges in the picture"""
VIEW_MARGIN_PX = 4.0
"""filters reach beyond a pixel"""
INSCRIBED_SHARE = 0.9 / math.sqrt(3)
"""A face's near plane reaches as far as this share at its corners."""
TOWARDS_EYE_SHARE = 0.7
"""how far from the middle of a solid towards its side that the eye sees its map's centre lies"""
DIRECTION_STEPS = 4
"""of each coordinate of the direction that this is in, which so changes every fifteen degrees"""
NEAR_SHARE = 3e-3
"""of a reflector's size: so near to a map's centre nothing is looked for"""
NEAR_OF_NEAREST = 0.9
"""of the smallest depth of anything that a view is to show"""
ROOM_SHARE = 0.75
"""of all directions, in which a reflector around the eye is seen: five walls of a room are more"""
DIRECTION_CELLS, LARGE_AT_ONCE = 16, 1 << 10
"""a side of each face of a cube, whose centres are the directions; and triangles that are compared with all of these at once"""
ELSEWHERE_COUNT, ELSEWHERE_SHARE = 2, 0.8
"""cubes of a room besides that around the eye, and where they may be: at the corners and in the middles of a box as large a share of the
room's"""
MAX_INSCRIBED_TRIANGLES, TRIANGLES_AT_ONCE = 1 << 22, 1 << 18
"""by which it is found out how solid a reflector is: a second for every million"""
CONVEXITY_TRIANGLES, CONVEXITY_CORNERS = 512, 4096
CONVEXITY_SHARE = 1e-3
"""of a reflector's size: shallower hollows show nothing of themselves"""
FLAT_SHARE = 1e-4
"""of a reflector's size: by so much a flat one may be off its plane"""
MAIN_PLANE_SHARE = 0.5
"""of what the eye sees of a reflector: one plane that so much of it lies in has a mirrored view"""
MAX_PLANE_TRIANGLES = 1 << 17
"""of which such a plane is sought: a regular subset of more"""
NORMAL_STEPS, OFFSET_STEPS = 64, 256
"""of a normal's coordinates and of a reflector's size, by which triangles count as those of one plane until it is known exactly"""
MIN_EYE_HEIGHT_SHARE = 1e-3
"""of the distance: seen more edge-on, a plane shows next to nothing, and its mirrored view would be all depth"""


def eye_is_inside(snapshot: SceneSnapshot, own: np.ndarray, corners_ws: np.ndarray) -> bool:
    """Whether a reflector is nearly all around the eye: a room, but no arch, ring, row of columns or loose foliage. One that is too fine
    to find out counts as none. own: (n,) int64 its instances; corners_ws: (n, 3) of its boxes"""
    eye_ws = snapshot.camera.world_from_view[:3, 3]
    inside = (eye_ws > corners_ws.min(axis=0)) & (eye_ws < corners_ws.max(axis=0))
    if snapshot.camera.is_orthographic or not inside.all() or is_too_fine(snapshot, own):
        return False
    return _covers(snapshot, own, eye_ws, ROOM_SHARE)


def _reach(corners_ws: np.ndarray, center_ws: np.ndarray) -> float:
    return 1.01 * float(np.linalg.norm(corners_ws.reshape(-1, 3) - center_ws, axis=1).max())


def _shown(snapshot: SceneSnapshot) -> np.ndarray:
    """(n,) int64 what reflectors show of the scene's instances"""
    visible = snapshot.instances.visible_in_reflections
    return np.arange(len(snapshot.instances)) if visible is None else np.flatnonzero(visible)


def _cube(bounds: SceneBounds, center_ws: np.ndarray, near_m: float, side_px: int, instances: np.ndarray) -> ReflectionMap:
    return ReflectionMap(
        center_ws=center_ws,
        axes=np.eye(3),
        is_cube=True,
        width_px=side_px,
        height_px=side_px,
        window=(-1.0, 1.0, -1.0, 1.0),
        near_m=near_m,
        reach_m=_reach(bounds.corners_ws, center_ws),
        instances=instances,
    )


def _near(snapshot: SceneSnapshot, corners_ws: np.ndarray, center_ws: np.ndarray) -> float:
    """Metres around a place on or in a reflector, (n, 3) corners of its boxes, that nothing else is in, or nothing that the eye would see
    in it: less than a share of the reflector's size, or than half a pixel."""
    left, right = snapshot.camera.window[:2]
    pixel_m = abs(right - left) / snapshot.width_px
    if not snapshot.camera.is_orthographic:
        pixel_m *= float(np.linalg.norm(center_ws - snapshot.camera.world_from_view[:3, 3]))
    return max(NEAR_SHARE * float(np.ptp(corners_ws, axis=0).max()), pixel_m / 2)


def cube_around_eye(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray, side_px: int) -> ReflectionMap:
    """Of a room of mirrors, which it sees as well. own: (n,) int64 its instances"""
    eye_ws = snapshot.camera.world_from_view[:3, 3]
    return _cube(bounds, eye_ws, _near(snapshot, bounds.corners_ws[own].reshape(-1, 3), eye_ws), side_px, _shown(snapshot))


def cubes_elsewhere(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray, side_px: int) -> tuple[ReflectionMap, ...]:
    """Of a room of mirrors, for what things in it hide from the eye: from up to ELSEWHERE_COUNT places far from the eye and each other,
    which lie in none of these things' boxes, and from which no wall stands before the eye. own: (n,) int64 its instances"""
    eye_ws = snapshot.camera.world_from_view[:3, 3]
    corners = bounds.corners_ws[own].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    steps = np.stack(np.meshgrid(*3 * [(-1.0, 0.0, 1.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    places = (low + high) / 2 + ELSEWHERE_SHARE * steps * (high - low) / 2
    shown = _shown(snapshot)
    low_ws, high_ws = (each[:, np.setdiff1d(shown, own)].T for each in bounds.extents_ws)
    places = places[~((places[:, None] > low_ws) & (places[:, None] < high_ws)).all(axis=2).any(axis=1)]
    near_m = _near(snapshot, corners, eye_ws)
    taken = [eye_ws]
    while len(places) and len(taken) <= ELSEWHERE_COUNT:
        farthest = np.min([((places - each) ** 2).sum(axis=1) for each in taken], axis=0).argmax()
        place_ws, places = places[farthest], np.delete(places, farthest, axis=0)
        if not _stands_between(snapshot, own, eye_ws, place_ws):
            taken.append(place_ws)
    return tuple(_cube(bounds, place_ws, near_m, side_px, shown) for place_ws in taken[1:])


def _stands_between(snapshot: SceneSnapshot, own: np.ndarray, start_ws: np.ndarray, end_ws: np.ndarray) -> bool:
    """Whether any of the instances' triangles meets the straight line from one place to another."""
    along = end_ws - start_ws
    for triangles in placed_triangles(snapshot, own, start_ws):
        a, b, c = np.moveaxis(triangles[_within(along[None, None], _sides(triangles))[:, 0]], 1, 0)
        normals = np.cross(b - a, c - a)
        if (np.abs((normals * a).sum(axis=1)) <= np.abs(normals @ along)).any():
            return True
    return False


def cube_around(
    snapshot: SceneSnapshot,
    bounds: SceneBounds,
    own: np.ndarray,
    side_px: int,
    *,
    find_place: Callable[[], np.ndarray],
    nearer_to_eye: bool = False,
) -> ReflectionMap:
    """All but the reflector itself: from the middle of one that is solid, otherwise from a place on it, which lies in nothing else.

    own: (n,) int64 its instances; find_place: asked for (3,) only where it is not solid. nearer_to_eye: from nearer to the places that
    the eye sees of a solid: rays from there meet less that is hidden from the map.
    """
    corners = bounds.corners_ws[own].reshape(-1, 3)
    center_ws = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius_m = _inscribed_radius(snapshot, own, center_ws)
    if not radius_m > 0:
        center_ws = find_place()
    elif nearer_to_eye:
        matrix = snapshot.camera.world_from_view
        toward = matrix[:3, 2] if snapshot.camera.is_orthographic else matrix[:3, 3] - center_ws
        # in steps: a centre that moves with the eye would have outlines flicker by a texel
        toward = np.round(DIRECTION_STEPS * toward / np.linalg.norm(toward))
        center_ws = center_ws + TOWARDS_EYE_SHARE * radius_m * toward / np.linalg.norm(toward)
        radius_m *= 1 - TOWARDS_EYE_SHARE
    near_m = max(INSCRIBED_SHARE * radius_m, _near(snapshot, corners, center_ws))
    return _cube(bounds, center_ws, near_m, side_px, np.setdiff1d(_shown(snapshot), own))


def flat_plane(snapshot: SceneSnapshot, own: np.ndarray) -> np.ndarray | None:
    """(4,) float64 unit normal and offset of the plane that all of a reflector lies in, shading normals too; None where there is none."""
    instances = snapshot.instances
    parts, normals = [], []
    for index in own:
        mesh = snapshot.meshes[instances.mesh_index[index]]
        matrix = instances.world_from_object[index].astype(np.float64)
        parts.append(mesh.positions_os[np.unique(mesh.triangles)] @ matrix[:3, :3].T + matrix[:3, 3])
        for given in (mesh.point_normals_os, mesh.corner_normals_os):
            if given is not None:
                normals.append(given.reshape(-1, 3) @ np.linalg.pinv(matrix[:3, :3]))
    points = np.concatenate(parts)
    center = points.mean(axis=0)
    axes = np.linalg.eigh((points - center).T @ (points - center))[1].T[::-1]
    normal = axes[2]
    size = np.ptp((points - center) @ axes.T, axis=0)
    if size[2] > FLAT_SHARE * size[0] or not size[1] > 0:
        return None
    for given in normals:
        if (np.abs(given @ normal) < (1 - FLAT_SHARE) * np.linalg.norm(given, axis=1)).any():
            return None
    return np.array([*normal, -normal @ center])


def main_plane(snapshot: SceneSnapshot, own: np.ndarray) -> np.ndarray | None:
    """(4,) float64 as of `flat_plane`: the one that most of what the eye sees of a reflector lies in, like a tray's within its rim. None
    where no plane has most; what others hide counts."""
    eye_ws = snapshot.camera.world_from_view[:3, 3]
    triangle_count = _triangle_count(snapshot, own)
    step = max(1, triangle_count // MAX_PLANE_TRIANGLES)
    corners = np.concatenate([positions[triangles[::step]] for positions, triangles in _placed_meshes(snapshot, own, eye_ws)])
    scaled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled_area = np.linalg.norm(scaled, axis=1)
    middles = corners.mean(axis=1)
    distance = np.linalg.norm(middles, axis=1)
    has_area = (doubled_area > 0) & (distance > 0)
    corners, scaled, doubled_area, middles, distance = (each[has_area] for each in (corners, scaled, doubled_area, middles, distance))
    toward = -(scaled * middles).sum(axis=1)
    seen = np.abs(toward) / distance**3
    if _are_closed(snapshot, own):
        seen *= toward > 0
    if not seen.sum() > 0:
        return None
    normals = scaled / doubled_area[:, None] * np.where(toward < 0, -1.0, 1.0)[:, None]
    offsets = -(normals * corners[:, 0]).sum(axis=1)
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    cells = np.round(np.column_stack([NORMAL_STEPS * normals, OFFSET_STEPS * offsets / size])).astype(np.int64)
    # one number each: rows of several take three times as long to tell apart
    steps = 2 * NORMAL_STEPS + 1
    keys = cells @ (steps**2, steps, 1, steps**3)
    _, numbers = np.unique(keys, return_inverse=True)
    fullest = np.bincount(numbers, seen).argmax()
    largest = np.argmax(np.where(numbers == fullest, seen, -1.0))
    normal, offset = normals[largest], offsets[largest]
    is_in = (np.abs(corners @ normal + offset) < FLAT_SHARE * size).all(axis=1)
    if seen[is_in].sum() < MAIN_PLANE_SHARE * seen.sum():
        return None
    return np.array([*normal, offset - normal @ eye_ws])


def mirrored_view(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray, plane: np.ndarray) -> ReflectionMap | None:
    """What a mirror shows, from the eye behind it; None where the eye sees it edge-on. plane: of `flat_plane`"""
    camera = snapshot.camera
    eye_ws = camera.world_from_view[:3, 3]
    corners = bounds.corners_ws[own].reshape(-1, 3)
    height = float(plane[:3] @ eye_ws + plane[3])
    if abs(height) < MIN_EYE_HEIGHT_SHARE * np.linalg.norm(corners - eye_ws, axis=1).max():
        return None
    facing = plane if height > 0 else -plane
    mirrored = np.eye(3) - 2 * np.outer(plane[:3], plane[:3])
    center_ws = eye_ws - 2 * height * plane[:3]
    right, up, backward = (mirrored @ camera.world_from_view[:3, :3]).T
    axes = np.stack([right, up, -backward])
    return _view(snapshot, bounds, own, center_ws, axes, np.setdiff1d(_shown(snapshot), own), abs(height), facing)


def eye_view(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray) -> ReflectionMap:
    """The reflector as the eye sees it, alone: surfaces of it that show in others of it are mostly those that the eye sees."""
    matrix = snapshot.camera.world_from_view
    axes = np.stack([matrix[:3, 0], matrix[:3, 1], -matrix[:3, 2]])
    depths = (bounds.corners_ws[own].reshape(-1, 3) - matrix[:3, 3]) @ axes[2]
    nearest_m = max(float(depths.min()), snapshot.camera.clip_start_m)
    return _view(snapshot, bounds, own, matrix[:3, 3], axes, np.intersect1d(_shown(snapshot), own), nearest_m)


def cubes_of_itself(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray, side_px: int) -> tuple[ReflectionMap, ...]:
    """The reflector alone, from its middle: the nearest of its surfaces in each direction, and the farthest; none of one that reflections
    do not show."""
    shown = np.intersect1d(_shown(snapshot), own)
    if not any(snapshot.meshes[snapshot.instances.mesh_index[index]].triangle_count for index in shown):
        return ()
    corners = bounds.corners_ws[own].reshape(-1, 3)
    center_ws = (corners.min(axis=0) + corners.max(axis=0)) / 2
    near_m = NEAR_SHARE * float(np.ptp(corners, axis=0).max())
    cube = _cube(bounds, center_ws, near_m, side_px, shown)
    nearest = replace(cube, reach_m=_reach(corners, center_ws))
    return nearest, replace(nearest, shows_farthest=True)


def _view(
    snapshot: SceneSnapshot,
    bounds: SceneBounds,
    own: np.ndarray,
    center_ws: np.ndarray,
    axes: np.ndarray,
    instances: np.ndarray,
    nearest_m: float,
    clipped_by: np.ndarray | None = None,
) -> ReflectionMap:
    """Through the part of the camera's window that a reflector covers, from the eye or its mirror image. nearest_m: no place that it is
    to show lies nearer to its centre"""
    camera = snapshot.camera
    low_x, high_x, low_y, high_y = covered_window(camera, bounds.corners_ws[own].reshape(-1, 3))
    left, right, bottom, top = camera.window
    steps = abs(right - left) / snapshot.width_px / TEXELS_PER_PX, abs(top - bottom) / snapshot.height_px / TEXELS_PER_PX
    margin = VIEW_MARGIN_PX * TEXELS_PER_PX
    sizes, widths = [], []
    for extent, step in ((high_x - low_x, steps[0]), (high_y - low_y, steps[1])):
        sizes.append(min(math.ceil((extent / step + 2 * margin) / MAP_SIZE_STEP_PX) * MAP_SIZE_STEP_PX, MAX_VIEW_PX))
        # whole steps wide; one that would be too large has larger texels
        widths.append(max(sizes[-1] * step, extent + 2 * margin * step))
    x, y = low_x - margin * steps[0], low_y - margin * steps[1]
    window = (x, x + widths[0], y, y + widths[1])
    # depth is along the axis
    least_cosine = 1 / math.sqrt(1 + max(map(abs, window[:2])) ** 2 + max(map(abs, window[2:])) ** 2)
    return ReflectionMap(
        center_ws=center_ws,
        axes=axes,
        is_cube=False,
        width_px=sizes[0],
        height_px=sizes[1],
        window=window,
        near_m=NEAR_OF_NEAREST * nearest_m * least_cosine,
        reach_m=_reach(bounds.corners_ws[instances], center_ws) if len(instances) else nearest_m,
        instances=instances,
        clipped_by=clipped_by,
    )


def convexity(snapshot: SceneSnapshot, own: np.ndarray) -> tuple[bool, bool]:
    """Whether no corner of a reflector lies before any of its surfaces, and whether none lies before any that the eye sees, both on a
    regular subset. Of what is open both sides are surfaces. own: (n,) int64 its instances"""
    triangle_count = _triangle_count(snapshot, own)
    corner_step, triangle_step = max(1, 3 * triangle_count // CONVEXITY_CORNERS), max(1, triangle_count // CONVEXITY_TRIANGLES)
    placed = list(_placed_meshes(snapshot, own, np.zeros(3)))
    # a corner of several triangles once
    corners = np.concatenate([positions[np.unique(triangles.reshape(-1)[::corner_step])] for positions, triangles in placed])
    tested = np.concatenate([positions[triangles[::triangle_step]] for positions, triangles in placed])
    # from its middle, not from the eye: short floats are enough there, and what it is from everywhere changes in no bit with the eye
    middle_ws = corners.mean(axis=0)
    corners, tested = corners - middle_ws, tested - middle_ws
    normals = np.cross(tested[:, 1] - tested[:, 0], tested[:, 2] - tested[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    tested, normals = tested[lengths > 0], normals[lengths > 0] / lengths[lengths > 0, None]
    offsets = (tested[:, 0] * normals).sum(axis=1)
    # no matrix product: its threads wait in a loop, which takes processors more than twice as long; nor rows of three: eight times as long
    columns = [np.ascontiguousarray(each.T, np.float32) for each in (corners, normals)]
    heights = np.einsum("ji,jk->ki", *columns)
    deepest = CONVEXITY_SHARE * np.ptp(corners, axis=0).max()
    rises = heights.max(axis=1, initial=-math.inf) - offsets >= deepest
    matrix = snapshot.camera.world_from_view
    is_parallel = snapshot.camera.is_orthographic
    faces_eye = normals @ matrix[:3, 2] > 0 if is_parallel else normals @ (matrix[:3, 3] - middle_ws) > offsets
    if _are_closed(snapshot, own):
        return not rises.any(), not rises[faces_eye].any()
    sinks = heights.min(axis=1, initial=math.inf) - offsets <= -deepest
    return not (rises | sinks).any(), not np.where(faces_eye, rises, sinks).any()


def cube_size_px(pixels: float) -> int:
    return int(np.clip(-(-pixels // MAP_SIZE_STEP_PX) * MAP_SIZE_STEP_PX, MIN_MAP_PX, MAX_MAP_PX))


def covered_size_px(snapshot: SceneSnapshot, corners_ws: np.ndarray) -> tuple[int, int]:
    """Width and height in the picture of the box around some corners, (n, 3); all of it where they reach behind the eye."""
    window = covered_window(snapshot.camera, corners_ws)
    left, right, bottom, top = snapshot.camera.window
    width = snapshot.width_px * abs(window[1] - window[0]) / abs(right - left)
    height = snapshot.height_px * abs(window[3] - window[2]) / abs(top - bottom)
    return math.ceil(width), math.ceil(height)


def covered_window(camera: Camera, corners_ws: np.ndarray) -> tuple[float, float, float, float]:
    """Bounds of some places, (n, 3), in the camera's window: smaller x, larger x, smaller y, larger y."""
    low_x, high_x = sorted(camera.window[:2])
    low_y, high_y = sorted(camera.window[2:])
    higher = sorted((camera.skew * low_x, camera.skew * high_x))
    low_y, high_y = low_y + higher[0], high_y + higher[1]
    view_from_world = np.linalg.inv(camera.world_from_view)
    p = corners_ws @ view_from_world[:3, :3].T + view_from_world[:3, 3]
    depth = np.ones(len(p)) if camera.is_orthographic else -p[:, 2]
    if (depth <= camera.clip_start_m).any() and not camera.is_orthographic:
        return low_x, high_x, low_y, high_y
    x, y = p[:, 0] / depth, p[:, 1] / depth
    return (
        float(np.clip(x.min(), low_x, high_x)),
        float(np.clip(x.max(), low_x, high_x)),
        float(np.clip(y.min(), low_y, high_y)),
        float(np.clip(y.max(), low_y, high_y)),
    )


def placed_triangles(snapshot: SceneSnapshot, own: np.ndarray, origin_ws: np.ndarray) -> Iterator[np.ndarray]:
    """Of the instances, some after the others, (n, 3, 3) float64 corners from an origin, counter-clockwise seen from the front."""
    for positions, triangles in _placed_meshes(snapshot, own, origin_ws):
        for first in range(0, len(triangles), TRIANGLES_AT_ONCE):
            yield positions[triangles[first : first + TRIANGLES_AT_ONCE]]


def _placed_meshes(snapshot: SceneSnapshot, own: np.ndarray, origin_ws: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of the instances, (n, 3) float64 positions from an origin, and (m, 3) triangles of them, counter-clockwise seen from the front."""
    instances = snapshot.instances
    for index in own:
        mesh, matrix = snapshot.meshes[instances.mesh_index[index]], instances.world_from_object[index].astype(np.float64)
        placed = mesh.positions_os.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3] - origin_ws
        yield placed, mesh.triangles if np.linalg.det(matrix[:3, :3]) > 0 else mesh.triangles[:, ::-1]


def is_too_fine(snapshot: SceneSnapshot, own: np.ndarray) -> bool:
    """Whether it would take too long to find out how solid a reflector is."""
    return _triangle_count(snapshot, own) > MAX_INSCRIBED_TRIANGLES


def _triangle_count(snapshot: SceneSnapshot, own: np.ndarray) -> int:
    return sum(snapshot.meshes[snapshot.instances.mesh_index[index]].triangle_count for index in own)


def _are_closed(snapshot: SceneSnapshot, own: np.ndarray) -> bool:
    return all(snapshot.meshes[snapshot.instances.mesh_index[index]].is_closed for index in own)


def _solid_angles(snapshot: SceneSnapshot, own: np.ndarray, place_ws: np.ndarray) -> tuple[float, float]:
    """Steradians, sums over triangles, hidden ones included, that turn their fronts to a place, and of those that turn their backs."""
    front = back = 0.0
    for triangles in placed_triangles(snapshot, own, place_ws):
        # Van Oosterom & Strackee 1983
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        angles = 2 * np.arctan2(volume, dots)
        front -= float(angles[angles < 0].sum())
        back += float(angles[angles > 0].sum())
    return front, back


def _covers(snapshot: SceneSnapshot, own: np.ndarray, place_ws: np.ndarray, share: float) -> bool:
    """Whether a reflector lies in more than a share of all directions from a place, however often in each."""
    tangents = (np.arange(DIRECTION_CELLS) + 0.5) / DIRECTION_CELLS * 2 - 1
    y, x = np.meshgrid(tangents, tangents, indexing="ij")
    faces = [np.roll(np.stack([x, y, np.full_like(x, side)], axis=-1), axis + 1, axis=-1) for axis in range(3) for side in (1.0, -1.0)]
    directions = np.concatenate([face.reshape(-1, 3) for face in faces])
    weights = np.tile(((1 + x**2 + y**2) ** -1.5).ravel(), 6)
    covered = np.zeros(len(directions), bool)

    def is_enough() -> bool:
        return bool(weights[covered].sum() > share * weights.sum())

    for triangles in placed_triangles(snapshot, own, place_ws):
        # what is smaller than half a cell has one cell's centre within it or none
        is_small = np.zeros(len(triangles), bool)
        longest = np.abs(triangles[:, 0]).argmax(axis=1)
        for face in range(6):
            axis, side = face // 2, 1 - 2 * (face % 2)
            here = np.flatnonzero((longest == axis) & (side * triangles[:, 0, axis] > 0))
            ahead = side * triangles[here, :, axis]
            at = triangles[here][:, :, [(axis + 1) % 3, (axis + 2) % 3]] / np.where(ahead > 0, ahead, np.inf)[..., None]
            low, high = (combine.reduce([at[:, 0], at[:, 1], at[:, 2]]) for combine in (np.minimum, np.maximum))
            fits = (ahead.min(axis=1) > 0) & ((high - low).max(axis=1) < 1 / DIRECTION_CELLS) & (np.maximum(high, -low).max(axis=1) < 1)
            is_small[here[fits]] = True
            cells = ((at[fits].mean(axis=1) + 1) / 2 * DIRECTION_CELLS).astype(np.int64)
            numbers = (face * DIRECTION_CELLS + cells[:, 1]) * DIRECTION_CELLS + cells[:, 0]
            is_open = ~covered[numbers]
            numbers, small = numbers[is_open], triangles[here[fits][is_open]]
            covered[numbers[_within(directions[numbers][:, None], _sides(small))[:, 0]]] = True
        large = triangles[~is_small]
        for first in range(0, len(large), LARGE_AT_ONCE):
            left = np.flatnonzero(~covered)
            part = large[first : first + LARGE_AT_ONCE]
            covered[left[_within(directions[None, left], _sides(part)).any(axis=0)]] = True
            if is_enough():
                return True
    return is_enough()


def _sides(triangles: np.ndarray) -> np.ndarray:
    """(n, 3, 3): normals of the planes through the origin and the triangles' sides, towards the triangles; 0 where these have none"""
    a, b, c = np.moveaxis(triangles, 1, 0)
    sides = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)], axis=1)
    return sides * np.sign((sides[:, 0] * c).sum(axis=1))[:, None, None]


def _within(directions: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(n, m) bool whether directions, (n or 1, m, 3), lie on the right side of all of the n triangles'"""
    heights = directions @ np.swapaxes(sides, 1, 2)
    return (heights >= 0).all(axis=2) & (heights > 0).any(axis=2)


def _inscribed_radius(snapshot: SceneSnapshot, own: np.ndarray, center_ws: np.ndarray) -> float:
    """Metres from a place to the nearest triangle of a closed surface around it; 0 where it is not inside of one. What is nearer is within
    the reflector, and nothing reflects it."""
    if is_too_fine(snapshot, own):
        return 0.0
    front, back = _solid_angles(snapshot, own, center_ws)
    if abs(front - back) < 3.9 * np.pi:
        return 0.0
    nearest_m = math.inf
    for triangles in placed_triangles(snapshot, own, center_ws):
        corners_m = np.linalg.norm(triangles, axis=2)
        nearest_m = min(nearest_m, float(corners_m.min()))
        # a triangle is nowhere nearer than its longest edge brings it
        longest_m = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        a, b, c = np.moveaxis(triangles[corners_m[:, 0] - longest_m < nearest_m], 1, 0)
        nearest_m = min(nearest_m, float(distances_to_origin(a, b, c).min(initial=math.inf)))
    return nearest_m
