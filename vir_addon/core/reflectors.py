"""Which objects reflect and from where what they show is drawn: decided from materials and the picture before any GPU work."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from .bounds import SceneBounds
from .material import Combination, Constant, CornerValue, ImageSample, Material, MaterialInput
from .passes.reflection_maps import BYTES_PER_TEXEL, MAP_SIZE_STEP_PX, ReflectionMap
from .scene import Camera, SceneSnapshot
from .settings import Settings

MAX_METAL_ROUGHNESS = 0.5
MAX_DIELECTRIC_ROUGHNESS = 0.3
"""Rougher surfaces show no shapes: what they reflect is a part of how they are lit, which other renderers' diffuse light stands for."""
MIN_REFLECTANCE = 0.02
"""Less than that straight on is not seen."""
MIN_MAP_PX, MAX_MAP_PX = 64, 1024
UNSEEN_MAP_PX = 128
"""of reflectors that are in the picture only within other reflectors"""
INSCRIBED_SHARE = 0.9 / math.sqrt(3)
"""A face's near plane reaches as far as this share at its corners."""
TOWARDS_EYE_SHARE = 0.7
"""how far from the middle of a solid towards its side that the eye sees its map's centre lies"""
MIN_NEAR_SHARE = 1e-4
"""of the reach: depth that the rasterizer still tells apart"""
MAX_INSCRIBED_TRIANGLES = 1 << 18


@dataclass(frozen=True, eq=False)
class Reflector:
    """An object that reflects, or would."""

    name: str
    instances: np.ndarray
    """(n,) int64 its parts, one a material"""
    runs: bool
    reason: str
    """why it is drawn as it is, or why it is not; one clause in plain words"""
    method_text: str = ""
    seen: ReflectionMap | None = None
    """for what the eye sees of it"""
    met: ReflectionMap | None = None
    """for rays from other reflectors"""
    covered_px: tuple[int, int] = (0, 0)
    """of its bounds in the picture"""

    @property
    def maps(self) -> list[ReflectionMap]:
        """each once"""
        found = [each for each in (self.seen, self.met) if each is not None]
        return found[:1] if len(found) == 2 and found[0] is found[1] else found


def typical_value(value: MaterialInput) -> np.ndarray:
    """(3,) float64: of a constant its value, of an image its mean, of what is computed from others what comes of theirs; 0.5 where
    nothing is known before a place on the surface is."""
    if isinstance(value, Constant):
        return np.array(value.value, np.float64)
    if isinstance(value, ImageSample):
        texels = value.image.texels
        step = max(1, math.isqrt(texels.shape[0] * texels.shape[1] // 4096))
        mean = texels[::step, ::step].reshape(-1, texels.shape[2]).mean(axis=0) / (255 if texels.dtype == np.uint8 else 1)
        return np.resize(mean[:3] if len(mean) > 2 else mean[:1], 3).astype(np.float64)
    if isinstance(value, CornerValue):
        return np.full(3, 0.5)
    operands = [typical_value(operand) for operand in (value.operands if isinstance(value, Combination) else (value.operand,))]
    return np.clip(np.mean(operands, axis=0), 0, 1)


def reflects(material: Material) -> bool:
    """Whether its surface mirrors enough, and sharply enough, for reflections to show in it."""
    roughness = typical_value(material.roughness).mean()
    metal = (typical_value(material.metal_weight) * typical_value(material.metal)).max()
    ior = typical_value(material.ior).mean()
    straight_on = ((ior - 1) / (ior + 1)) ** 2
    dielectric = (typical_value(material.dielectric_weight) * typical_value(material.specular_tint)).max() * straight_on
    coat = typical_value(material.coat_weight).mean() * ((typical_value(material.coat_ior).mean() - 1) / 2.5) ** 2
    return bool(
        (metal > MIN_REFLECTANCE and roughness <= MAX_METAL_ROUGHNESS)
        or (dielectric > MIN_REFLECTANCE and roughness <= MAX_DIELECTRIC_ROUGHNESS)
        or (coat > MIN_REFLECTANCE and typical_value(material.coat_roughness).mean() <= MAX_DIELECTRIC_ROUGHNESS)
    )


def reflecting_instances(snapshot: SceneSnapshot) -> np.ndarray:
    """(instance_count,) bool: what the artist marked, and otherwise what has a material that reflects."""
    instances = snapshot.instances
    if instances.material_set is None:
        return np.zeros(len(instances), bool)
    by_material = np.array([reflects(material) for material in snapshot.materials], bool)
    by_set = np.array([any(by_material[index] for index in entries) for entries in snapshot.material_sets], bool)
    found = by_set[instances.material_set]
    if instances.reflector_mark is not None:
        found = np.where(instances.reflector_mark < 0, found, instances.reflector_mark > 0)
    return found


def choose_reflectors(
    snapshot: SceneSnapshot, bounds: SceneBounds, settings: Settings, in_picture: np.ndarray, bounces: int
) -> list[Reflector]:
    """All reflectors of the scene with what is drawn for each. in_picture: (instance_count,) bool"""
    is_reflecting = reflecting_instances(snapshot)
    found = []
    for own in _grouped(snapshot, np.flatnonzero(is_reflecting)):
        name = snapshot.instances.object_names[snapshot.instances.object_index[own[0]]]
        found.append(_plan_reflector(snapshot, bounds, name, own, bool(in_picture[own].any()), bounces))
    return _within_memory(found, settings)


def _grouped(snapshot: SceneSnapshot, indices: np.ndarray) -> list[np.ndarray]:
    """Instances of one object at one place: parts of it that have different materials."""
    groups: dict[tuple[int, bytes], list[int]] = {}
    for index in indices.tolist():
        key = (int(snapshot.instances.object_index[index]), snapshot.instances.world_from_object[index].tobytes())
        groups.setdefault(key, []).append(index)
    return [np.array(group, np.int64) for group in groups.values()]


def _plan_reflector(
    snapshot: SceneSnapshot, bounds: SceneBounds, name: str, own: np.ndarray, is_in_picture: bool, bounces: int
) -> Reflector:
    corners = bounds.corners_ws[own].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if not (high - low).max() > 0:
        return Reflector(name, own, runs=False, reason="skipped: it has no size")
    if not is_in_picture and bounces < 2:
        return Reflector(name, own, runs=False, reason="skipped: not in the picture")
    eye_ws = snapshot.camera.world_from_view[:3, 3]
    center_ws = (low + high) / 2
    others = np.setdiff1d(np.arange(len(snapshot.instances)), own)
    surrounds_eye = bool(((eye_ws > low) & (eye_ws < high)).all()) and not snapshot.camera.is_orthographic
    if surrounds_eye:
        # a room of mirrors: seen from where the eye is, with itself
        center_ws, others = eye_ws, np.arange(len(snapshot.instances))
    reach_m = 1.01 * float(np.linalg.norm(bounds.corners_ws.reshape(-1, 3) - center_ws, axis=1).max())
    radius_m = 0.0 if surrounds_eye else _inscribed_radius(snapshot, own, center_ws)
    if is_in_picture and bounces < 2:
        # nearer to the places that are seen, it sees more of what rays from there meet
        toward = eye_ws - center_ws
        center_ws = center_ws + TOWARDS_EYE_SHARE * radius_m * toward / np.linalg.norm(toward)
        radius_m *= 1 - TOWARDS_EYE_SHARE
    near_m = INSCRIBED_SHARE * radius_m
    covered_px = _covered_px(snapshot, corners) if is_in_picture else (0, 0)
    side_px = _map_size(max(covered_px)) if is_in_picture else UNSEEN_MAP_PX
    cube = ReflectionMap(
        center_ws=center_ws,
        axes=np.eye(3),
        is_cube=True,
        width_px=side_px,
        height_px=side_px,
        window=(-1.0, 1.0, -1.0, 1.0),
        near_m=max(near_m, MIN_NEAR_SHARE * reach_m),
        reach_m=reach_m,
        instances=others,
    )
    reason = f"{covered_px[0]} x {covered_px[1]} px in the picture" if is_in_picture else "in the picture only within other reflectors"
    if surrounds_eye:
        reason += "; the eye is inside, so its cube is around the eye"
    return Reflector(
        name,
        own,
        runs=True,
        reason=reason,
        method_text="mvr",
        seen=cube if is_in_picture else None,
        met=cube if bounces > 1 else None,
        covered_px=covered_px,
    )


def _map_size(pixels: float) -> int:
    return int(np.clip(-(-pixels // MAP_SIZE_STEP_PX) * MAP_SIZE_STEP_PX, MIN_MAP_PX, MAX_MAP_PX))


def _covered_px(snapshot: SceneSnapshot, corners_ws: np.ndarray) -> tuple[int, int]:
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


def _inscribed_radius(snapshot: SceneSnapshot, own: np.ndarray, center_ws: np.ndarray) -> float:
    """Metres from a place to the nearest triangle of a closed surface around it; 0 where it is not inside of one. What is nearer is within
    the reflector, and nothing reflects it."""
    instances = snapshot.instances
    meshes = [snapshot.meshes[instances.mesh_index[index]] for index in own]
    if sum(mesh.triangle_count for mesh in meshes) > MAX_INSCRIBED_TRIANGLES:
        return 0.0
    parts = []
    for index, mesh in zip(own, meshes, strict=True):
        matrix = instances.world_from_object[index].astype(np.float64)
        placed = mesh.positions_os.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3] - center_ws
        parts.append(placed[mesh.triangles])
    triangles = np.concatenate(parts)
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    # solid angles (Van Oosterom & Strackee 1983) sum to 4 pi inside
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    solid_angle = abs(float(2 * np.arctan2(volume, dots).sum()))
    return float(_distances_to_origin(a, b, c).min()) if solid_angle > 3.9 * np.pi else 0.0


def _distances_to_origin(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(n,) from the origin to triangles with (n, 3) corners"""

    def to_segment(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        along = end - start
        share = np.clip(-(start * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30), 0, 1)
        return np.linalg.norm(start + share[:, None] * along, axis=1)

    normal = np.cross(b - a, c - a)
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    sides = [np.einsum("ij,ij->i", np.cross(end - start, -start), normal) for start, end in ((a, b), (b, c), (c, a))]
    over = np.all(np.array(sides) >= 0, axis=0)
    plane = np.abs((a * normal).sum(axis=1)) / length
    edges = np.minimum(np.minimum(to_segment(a, b), to_segment(b, c)), to_segment(c, a))
    return np.where(over, plane, edges)


def _within_memory(reflectors: list[Reflector], settings: Settings) -> list[Reflector]:
    """Smaller maps where all together would take more than the settings allow."""
    total = sum(each.texel_count for reflector in reflectors for each in reflector.maps)
    budget = settings.reflection_map_mib * (1 << 20) // BYTES_PER_TEXEL
    if total <= budget:
        return reflectors
    share = math.sqrt(budget / total)
    return [_smaller(reflector, share) for reflector in reflectors]


def _smaller(reflector: Reflector, share: float) -> Reflector:
    def shrunk(drawn: ReflectionMap | None) -> ReflectionMap | None:
        if drawn is None:
            return None
        size = [
            max(MAP_SIZE_STEP_PX, int(side * share) // MAP_SIZE_STEP_PX * MAP_SIZE_STEP_PX) for side in (drawn.width_px, drawn.height_px)
        ]
        return replace(drawn, width_px=size[0], height_px=size[1])

    seen = shrunk(reflector.seen)
    met = seen if reflector.met is reflector.seen else shrunk(reflector.met)
    return replace(reflector, seen=seen, met=met, reason=reflector.reason + "; smaller for all maps to fit into memory" * reflector.runs)


@dataclass(frozen=True, eq=False)
class PlannedReflections:
    """What becomes of the reflections of a frame."""

    reflectors: tuple[Reflector, ...]
    bounces: int
    predicted_ms: float = 0.0
    maps: tuple[ReflectionMap, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "maps", tuple(each for reflector in self.reflectors for each in reflector.maps))

    @property
    def runs(self) -> bool:
        return any(reflector.seen is not None for reflector in self.reflectors)

    def instance_maps(self, instance_count: int) -> np.ndarray:
        """(instance_count, 4) float32: numbers of the maps for what the eye sees and for rays from other reflectors, -1: none"""
        numbers = {id(each): number for number, each in enumerate(self.maps)}
        rows = np.full((instance_count, 4), -1, np.float32)
        for reflector in self.reflectors:
            rows[reflector.instances, 0] = numbers.get(id(reflector.seen), -1)
            rows[reflector.instances, 1] = numbers.get(id(reflector.met), -1)
        return rows
