"""Shadow passes by brute force in float64: every pixel, every light sample, every triangle. Shares no code with what it checks
but the light samples themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vir_addon.core.fit import FittedFace
from vir_addon.core.sampling import sample_patch_m
from vir_addon.core.scene import Light, LightShape, SceneSnapshot

RAYS_AT_ONCE = 4096
"""times some hundred triangles still fits into a cache"""


@dataclass(frozen=True)
class Triangles:
    corners: np.ndarray
    """(n, 3, 3) float64 world space"""
    normals: np.ndarray
    """(n, 3, 3) float64 world space, of the corners, for shading"""
    instance: np.ndarray
    """(n,) int64"""


def world_triangles(scene: SceneSnapshot) -> Triangles:
    """Meshes with normals per point or none."""
    corners, normals, owners = [], [], []
    for index, mesh_index in enumerate(scene.instances.mesh_index):
        mesh, matrix = scene.meshes[mesh_index], scene.instances.world_from_object[index].astype(np.float64)
        placed = mesh.positions_os.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        own = placed[mesh.triangles]
        flat = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]) * np.sign(np.linalg.det(matrix[:3, :3]))
        if mesh.point_normals_os is None:
            own_normals = np.repeat(flat[:, None], 3, axis=1)
        else:
            own_normals = (mesh.point_normals_os.astype(np.float64) @ np.linalg.inv(matrix[:3, :3]))[mesh.triangles]
        kept = np.linalg.norm(flat, axis=1) > 0
        corners.append(own[kept])
        normals.append(own_normals[kept])
        owners.append(np.full(kept.sum(), index))
    return Triangles(np.concatenate(corners), np.concatenate(normals), np.concatenate(owners))


def intersect(origins: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r, 3) rays and (n, 3, 3) triangles -> (r, n) distance in units of the direction, infinite for a miss, and (r, n, 2)
    barycentric coordinates. Rays go to the space in which a triangle is the unit triangle (Woop 2004): two matrix products."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to_unit = np.linalg.inv(np.stack([edge_1, edge_2, np.cross(edge_1, edge_2)], axis=-1))
    shift = np.einsum("nij,nj->ni", to_unit, corners[:, 0])
    o = [origins @ to_unit[:, axis].T - shift[:, axis] for axis in range(3)]
    d = [directions @ to_unit[:, axis].T for axis in range(3)]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -o[2] / d[2]
        u, v = o[0] + t * d[0], o[1] + t * d[1]
        hit = np.isfinite(t) & (u >= 0) & (v >= 0) & (u + v <= 1)
    return np.where(hit, t, np.inf), np.stack([u, v], axis=-1)


@dataclass(frozen=True)
class Surfaces:
    """What pixel centres see; arrays over the pixels that see a surface."""

    pixel: np.ndarray
    """(n, 2) row from the bottom, column"""
    position: np.ndarray
    geometric: np.ndarray
    """towards the eye"""
    shading: np.ndarray
    triangle: np.ndarray


def primary_surfaces(scene: SceneSnapshot, triangles: Triangles) -> Surfaces:
    """What the camera sees at the pixels' centres."""
    camera = scene.camera
    rows, columns = np.mgrid[: scene.height_px, : scene.width_px]
    left, right, bottom, top = camera.window
    x = left + (columns.ravel() + 0.5) / scene.width_px * (right - left)
    y = bottom + (rows.ravel() + 0.5) / scene.height_px * (top - bottom)
    rotation, eye = camera.world_from_view[:3, :3], camera.world_from_view[:3, 3]
    if camera.is_orthographic:
        origins = eye + np.stack([x, y, 0 * x], axis=1) @ rotation.T
        directions = np.broadcast_to(-rotation[:, 2], origins.shape)
    else:
        origins = np.broadcast_to(eye, (len(x), 3))
        directions = np.stack([x, y, -np.ones_like(x)], axis=1) @ rotation.T
    seen = np.flatnonzero(scene.instances.visible_to_camera[triangles.instance])
    distance, barycentric = intersect(origins, directions, triangles.corners[seen])
    distance = np.where((distance >= camera.clip_start_m) & (distance <= camera.clip_end_m), distance, np.inf)
    nearest = distance.argmin(axis=1)
    hit = np.isfinite(distance.min(axis=1))
    ray = np.flatnonzero(hit)
    chosen = seen[nearest[hit]]
    u, v = barycentric[ray, nearest[hit]].T
    weights = np.stack([1 - u - v, u, v], axis=1)
    position = np.einsum("nk,nkj->nj", weights, triangles.corners[chosen])
    pixel = np.stack([rows.ravel()[hit], columns.ravel()[hit]], axis=1)
    return _surfaces(pixel, position, weights, directions[ray], chosen, triangles)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def spot_fade(light: Light, d: np.ndarray) -> np.ndarray:
    """(..., 3) directions from the light -> (...) what the spot's cone leaves of it"""
    scale = np.array([*light.cone_scale, 1.0])
    local = d @ (light.world_from_light[:3, :3] * [1, 1, -1]) / scale
    cosine, edge = local[..., 2] / np.linalg.norm(local, axis=-1), np.cos(light.cone_rad / 2)
    with np.errstate(divide="ignore"):
        t = np.clip((cosine - edge) / ((1 - edge) * light.cone_blend), 0, 1) if light.cone_blend else (cosine > edge).astype(float)
    return 3 * t**2 - 2 * t**3


def delivered_by_sphere(light: Light, samples_ws: np.ndarray, position: np.ndarray, shading: np.ndarray) -> np.ndarray:
    """As `delivered`, of points and spots, whose samples are on the sphere (all of one weight)."""
    center = light.world_from_light[:3, 3]
    d = position[:, None] - samples_ws[None]
    distance = np.linalg.norm(d, axis=-1)
    receiver = np.maximum(-np.einsum("nj,nmj->nm", shading, d) / distance, 0)
    weight = receiver / distance**2
    away = np.linalg.norm(position - center, axis=1)[:, None]
    inside = away < light.radius_m
    if len(samples_ws) > 1:
        cosine = np.einsum("mj,nmj->nm", (samples_ws - center) / light.radius_m, d) / distance
        if light.has_soft_falloff:
            towards = np.einsum("nmj,nj->nm", d, position - center) / (distance * away)
            weight = weight * np.abs(cosine) * (towards > away / np.hypot(away, light.radius_m))
        else:
            weight = weight * np.maximum(np.where(inside, -cosine, cosine), 0)
    if light.shape is LightShape.SPOT:
        weight = weight * np.where(inside & (not light.has_soft_falloff), 1, spot_fade(light, d))
    return weight


def delivered(light: Light, samples_ws: np.ndarray, position: np.ndarray, shading: np.ndarray) -> np.ndarray:
    """(n points, m samples) what the light would deliver without anything in the way."""
    if light.shape.is_omni:
        return delivered_by_sphere(light, samples_ws, position, shading)
    axis = -light.world_from_light[:3, 2]
    d = position[:, None] - samples_ws[None]
    distance = np.linalg.norm(d, axis=-1)
    receiver = np.maximum(-np.einsum("nj,nmj->nm", shading, d) / distance, 0)
    emitter = np.maximum(d @ axis / distance, 0)
    weight = receiver * emitter / distance**2
    if light.spread_rad < np.pi - 1e-4:
        with np.errstate(divide="ignore"):
            tangent = np.where(emitter > 0, np.sqrt(np.maximum(1 - emitter**2, 0)) / np.maximum(emitter, 1e-300), np.inf)
        limit = np.tan(light.spread_rad / 2)
        # where no sample counts the nearest ones decide, if the light may have places between them that do
        between = (tangent > limit) & ((tangent - limit) * emitter * distance <= sample_patch_m(light, len(samples_ws)))
        faint = np.where(between, 1e-4 * (limit / np.maximum(tangent, limit)) ** 8, 0)
        weight = weight * np.maximum(1 - tangent / limit, faint)
    return weight


def samples_in_world(light: Light, samples_m: np.ndarray) -> np.ndarray:
    return light.world_from_light[:3, 3] + samples_m @ (light.world_from_light[:3, :3] * [1, 1, -1]).T


def nearest_blocker(points: np.ndarray, targets: np.ndarray, corners: np.ndarray, ignore_share: float = 1e-7) -> np.ndarray:
    """(n,) how far from the point to its target the first thing in the way is, 0 to 1; infinite if nothing is. What touches the
    point or the target is not in the way."""
    found = np.full(len(points), np.inf)
    for start in range(0, len(points), RAYS_AT_ONCE):
        part = slice(start, start + RAYS_AT_ONCE)
        t, _ = intersect(points[part], targets[part] - points[part], corners)
        found[part] = np.where((t > ignore_share) & (t < 1), t, np.inf).min(axis=1, initial=np.inf)
    return found


@dataclass(frozen=True)
class Brackets:
    """Bounds (height, width) of a pass made with maps of finite resolution; `exact` is the pass itself."""

    exact: np.ndarray
    low: np.ndarray
    high: np.ndarray
    surface: np.ndarray
    """(height, width) bool"""


def surfaces_at(positions: np.ndarray, scene: SceneSnapshot, triangles: Triangles) -> Surfaces:
    """The exact surfaces at the points of an eye G-buffer, (height, width, 4) world space and instance number. Fails where a point
    lies on no triangle of its instance."""
    rows, columns = np.nonzero(positions[..., 3] >= 0)
    given = positions[rows, columns].astype(np.float64)
    corners = triangles.corners
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to_unit = np.linalg.inv(np.stack([edge_1, edge_2, _unit(np.cross(edge_1, edge_2))], axis=-1))
    local = np.einsum("nij,rnj->rni", to_unit, given[:, None, :3] - corners[None, :, 0])
    weights = np.concatenate([1 - local[..., :2].sum(axis=-1, keepdims=True), local[..., :2]], axis=-1)
    size = np.abs(corners).max()
    off = np.maximum(np.abs(local[..., 2]) / size, np.maximum(-weights.min(axis=-1), 0) * 1e-2)
    off[triangles.instance[None] != given[:, 3:]] = np.inf
    chosen = off.argmin(axis=1)
    ray = np.arange(len(given))
    assert off[ray, chosen].max() < 1e-5
    weight = np.clip(weights[ray, chosen], 0, 1)
    weight /= weight.sum(axis=1, keepdims=True)
    position = np.einsum("nk,nkj->nj", weight, corners[chosen])
    view = scene.camera.world_from_view
    directions = np.broadcast_to(-view[:3, 2], position.shape) if scene.camera.is_orthographic else position - view[:3, 3]
    return _surfaces(np.stack([rows, columns], axis=1), position, weight, directions, chosen, triangles)


def _surfaces(
    pixel: np.ndarray, position: np.ndarray, weights: np.ndarray, directions: np.ndarray, chosen: np.ndarray, triangles: Triangles
) -> Surfaces:
    corners = triangles.corners[chosen]
    geometric = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    shading = _unit(np.einsum("nk,nkj->nj", weights, _unit(triangles.normals[chosen])))
    # whichever way the corners run, the geometric normal of a mirrored or ordinary instance is where its shading normals are
    geometric *= np.where(np.einsum("nj,nj->n", geometric, _unit(triangles.normals[chosen].sum(axis=1))) < 0, -1, 1)[:, None]
    away = np.einsum("nj,nj->n", geometric, directions) > 0
    geometric[away] *= -1
    shading[away] *= -1
    return Surfaces(pixel, position, geometric, shading, chosen)


def bracket_pass(
    scene: SceneSnapshot,
    light: Light,
    samples_m: np.ndarray,
    weights: np.ndarray,
    faces: list[FittedFace],
    positions: np.ndarray,
    tolerance_texels: float = 1.5,
) -> Brackets:
    """Of the points of an eye G-buffer, (height, width, 4) world space and instance number. samples_m, weights: of a fitted light, and
    what each of them counts

    A light sample counts as certainly seen or hidden where that holds for the point and for its neighbours a few texels away in
    its tangent plane, blockers nearer than the depth bias left out; the others may go either way."""
    triangles = world_triangles(scene)
    surfaces = surfaces_at(positions, scene, triangles)
    samples_ws = samples_in_world(light, samples_m)
    linked = np.ones(len(scene.instances), bool) if light.receivers is None else light.receivers
    weight = delivered(light, samples_ws, surfaces.position, surfaces.shading) * weights
    weight = weight * linked[triangles.instance[surfaces.triangle]][:, None]
    casts = scene.instances.casts_shadow if light.blockers is None else light.blockers
    corners = triangles.corners[casts[triangles.instance]]

    point, sample = np.nonzero(weight > 0)
    p, s, n = surfaces.position[point], samples_ws[sample], surfaces.geometric[point]
    d = p - s
    toward = np.einsum("rj,rj->r", n, d) < 0
    basis, texel_m, known = _footprints(light, faces, d)
    exact = toward & ~np.isfinite(nearest_blocker(p, s, corners))
    always_seen, never_seen = exact.copy(), ~exact
    distance = np.linalg.norm(d, axis=1)
    cosine = np.maximum(-np.einsum("rj,rj->r", n, d) / distance, 1e-9)
    bias = texel_m.max(axis=1) * (1.0 + np.minimum(np.sqrt(1 - np.minimum(cosine, 1) ** 2) / cosine, 16.0))
    bias_share = np.minimum(4 * bias / distance, 0.5)
    shallow = nearest_blocker(p, s, corners, 1e-7)
    # a blocker within the bias may be missed
    beyond = nearest_blocker_beyond(p, s, corners, bias_share)
    never_seen &= ~toward | ~np.isfinite(shallow) | np.isfinite(beyond)
    for a in (-1, 1):
        for b in (-1, 1):
            aside = p + tolerance_texels * (a * texel_m[:, :1] * basis[:, 0] + b * texel_m[:, 1:] * basis[:, 1])
            # along the ray to the sample until it meets the tangent plane
            ray = aside - s
            facing = np.einsum("rj,rj->r", n, ray)
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.einsum("rj,rj->r", n, d) / facing
            reachable = (facing < 0) & (np.abs(share - 1) * distance < 8 * texel_m.max(axis=1))
            neighbour = s + ray * np.where(reachable, share, 1.0)[:, None]
            lifted = neighbour + n * (1e-9 * distance[:, None])
            seen = ~np.isfinite(nearest_blocker(lifted, s, corners))
            hidden = np.isfinite(nearest_blocker_beyond(lifted, s, corners, bias_share))
            always_seen &= seen & reachable & known
            never_seen &= (hidden & reachable & known) | ~toward
    shape = (scene.height_px, scene.width_px)
    result = {}
    total = weight.sum(axis=1)
    for name, flag in (("exact", exact), ("low", always_seen), ("high", ~never_seen)):
        summed = np.bincount(point, weights=weight[point, sample] * flag, minlength=len(total))
        image = np.ones(shape)
        image[tuple(surfaces.pixel.T)] = np.where(total > 0, summed / np.where(total > 0, total, 1), 0)
        result[name] = image
    surface = np.zeros(shape, bool)
    surface[tuple(surfaces.pixel.T)] = True
    return Brackets(**result, surface=surface)


def nearest_blocker_beyond(points: np.ndarray, targets: np.ndarray, corners: np.ndarray, ignore_shares: np.ndarray) -> np.ndarray:
    """As nearest_blocker, with a share of its own for each point."""
    return nearest_blocker(points + (targets - points) * ignore_shares[:, None], targets, corners, 0.0)


def _footprints(light: Light, faces: list[FittedFace], d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For directions (r, 3) from light samples: the map's axes (r, 2, 3), a texel's sides there in metres (r, 2), and whether the
    direction's face has a map or nothing that casts at all."""
    basis = np.zeros((len(d), 2, 3))
    texel_m = np.full((len(d), 2), 1e-12)
    known = np.zeros(len(d), bool)
    right, up, back = light.world_from_light[:3, :3].T
    x, y, z = d @ right, d @ up, -(d @ back)
    side = np.maximum(np.abs(x), np.abs(y))
    beside = np.where(np.abs(x) >= np.abs(y), np.where(x > 0, 1, 2), np.where(y > 0, 3, 4))
    index = np.where(np.abs(z) >= side, np.where(z > 0, 0, 5), beside)
    if len(faces) == 1 and faces[0].views.face.index == 0 and faces[0].views.face.limits[1] > 1:
        index[:] = 0
    for face in faces:
        own = index == face.views.face.index
        rotation = face.views.face.face_from_world
        basis[own] = rotation[:2]
        known[own] = True
        if len(face.caster_indices):
            texel_m[own] = (d[own] @ rotation[2])[:, None] * np.array(face.views.texel_tangent)
    return basis, texel_m, known
