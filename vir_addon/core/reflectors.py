"""Which objects reflect and from where what they show is drawn: decided from materials and the picture before any GPU work."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from .bounds import SceneBounds
from .material import Material
from .material_program import typical_value
from .passes.reflection_maps import BYTES_PER_TEXEL, MAP_SIZE_STEP_PX, ReflectionMap
from .reflector_views import (
    MAX_MAP_PX,
    covered_size_px,
    cube_around,
    cube_around_eye,
    cube_size_px,
    eye_is_inside,
    eye_view,
    flat_plane,
    is_convex_to_eye,
    mirrored_view,
)
from .scene import SceneSnapshot
from .settings import Settings

DEFAULT_BOUNCES = 2
"""where several reflectors in the picture may show in each other"""
MAX_REFLECTORS = 64
"""Each draws the scene up to six times."""
MIN_PICTURE_SHARE = 0.001
"""of the picture, which the box around a reflector must cover for it to have a map"""
MAX_METAL_ROUGHNESS = 0.5
MAX_DIELECTRIC_ROUGHNESS = 0.3
"""Rougher surfaces show no shapes: what they reflect is a part of how they are lit, which other renderers' diffuse light stands for."""
MIN_REFLECTANCE = 0.02
"""Less than that straight on is not seen."""
UNSEEN_MAP_PX = 128
"""of reflectors that are in the picture only within other reflectors"""
SHRINKING = 0.9
"""of maps' sides, as often as it takes for all to fit; those of the smallest size stay"""
ASIDE_MAP_PX = 256
"""of cubes of flat reflectors, for what is not seen in their mirrored view"""


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
    aside: ReflectionMap | None = None
    """where rays go on that leave the view of `seen`, and rays of light that what it shows is lit by"""
    itself: ReflectionMap | None = None
    """what the eye sees of it, for what of itself it shows; of reflectors that are not convex"""
    covered_px: tuple[int, int] = (0, 0)
    """of its bounds in the picture"""

    @property
    def maps(self) -> list[ReflectionMap]:
        """each once"""
        return list({id(each): each for each in (self.seen, self.met, self.aside, self.itself) if each is not None}.values())


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


def choose_reflectors(snapshot: SceneSnapshot, bounds: SceneBounds, settings: Settings, in_picture: np.ndarray) -> PlannedReflections:
    """All reflectors of the scene with what is drawn for each. in_picture: (instance_count,) bool"""
    groups = _grouped(snapshot, np.flatnonzero(reflecting_instances(snapshot)))
    chosen, left_out = _with_own_maps(snapshot, bounds, groups, in_picture)
    seen_count = sum(in_picture[own].any() and _extent(bounds, own) > 0 for own in chosen)
    # a single one has nothing to see itself in
    bounces = settings.bounces or (DEFAULT_BOUNCES if seen_count > 1 else 1)
    found = []
    for own in chosen:
        name = snapshot.instances.object_names[snapshot.instances.object_index[own[0]]]
        found.append(_plan_reflector(snapshot, bounds, name, own, bool(in_picture[own].any()), bounces))
    if left_out:
        reason = f"skipped: each covers less than {MIN_PICTURE_SHARE:.1%} of the picture, or {MAX_REFLECTORS} others cover more"
        found.append(Reflector(f"{len(left_out)} small reflectors", np.concatenate(left_out), runs=False, reason=reason))
    return PlannedReflections(tuple(_within_memory(found, settings)), bounces)


def _with_own_maps(
    snapshot: SceneSnapshot, bounds: SceneBounds, groups: list[np.ndarray], in_picture: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Those that are worth maps of their own, in the scene's order, at most MAX_REFLECTORS; and the others. In the picture those that
    cover most of it come first, then the largest that may show in others."""
    least_px = MIN_PICTURE_SHARE * snapshot.width_px * snapshot.height_px
    ranks = []
    for number, own in enumerate(groups):
        corners = bounds.corners_ws[own].reshape(-1, 3)
        covered = math.prod(covered_size_px(snapshot, corners)) if in_picture[own].any() else 0
        if in_picture[own].any() and _extent(bounds, own) > 0 and covered < least_px:
            continue
        ranks.append((-covered, -_extent(bounds, own), number))
    chosen = sorted(number for *_, number in sorted(ranks)[:MAX_REFLECTORS])
    left_out = sorted(set(range(len(groups))) - set(chosen))
    return [groups[number] for number in chosen], [groups[number] for number in left_out]


def _extent(bounds: SceneBounds, own: np.ndarray) -> float:
    return float(np.ptp(bounds.corners_ws[own].reshape(-1, 3), axis=0).max())


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
    if not _extent(bounds, own) > 0:
        return Reflector(name, own, runs=False, reason="skipped: it has no size")
    if not is_in_picture and bounces < 2:
        return Reflector(name, own, runs=False, reason="skipped: not in the picture")
    if not is_in_picture:
        reason = "in the picture only within other reflectors"
        return Reflector(name, own, runs=True, reason=reason, method_text="mvr", met=cube_around(snapshot, bounds, own, UNSEEN_MAP_PX))
    covered_px = covered_size_px(snapshot, corners)
    reason = f"{covered_px[0]} x {covered_px[1]} px in the picture"
    side_px = cube_size_px(max(covered_px))
    plane = flat_plane(snapshot, own)
    if plane is not None and not snapshot.camera.is_orthographic:
        view = mirrored_view(snapshot, bounds, own, plane)
        if view is not None:
            # what the mirrored view does not show: rays from other reflectors, and what lights the surfaces that it shows
            aside = cube_around(snapshot, bounds, own, min(side_px, ASIDE_MAP_PX))
            return Reflector(name, own, True, f"{reason}; flat: one mirrored view", "planar", view, aside, aside, None, covered_px)
    if eye_is_inside(snapshot, corners):
        cube = cube_around_eye(snapshot, bounds, side_px)
        reason += "; the eye is inside, so its cube is around the eye"
        return Reflector(name, own, True, reason, "mvr", cube, cube, cube, None, covered_px)
    seen = cube_around(snapshot, bounds, own, side_px, nearer_to_eye=True)
    met = cube_around(snapshot, bounds, own, side_px) if bounces > 1 else None
    itself = None
    if not (snapshot.camera.is_orthographic or is_convex_to_eye(snapshot, own)):
        itself = eye_view(snapshot, bounds, own)
        reason += "; not convex: a view of itself besides"
    return Reflector(name, own, True, reason, "mvr", seen, met, None, itself, covered_px)


def _within_memory(reflectors: list[Reflector], settings: Settings) -> list[Reflector]:
    """Smaller maps where all together would take more than the settings allow."""
    budget = settings.reflection_map_mib * (1 << 20) // BYTES_PER_TEXEL
    fitting, share = reflectors, 1.0
    while sum(each.texel_count for reflector in fitting for each in reflector.maps) > budget and share > 1 / MAX_MAP_PX:
        share *= SHRINKING
        fitting = [_smaller(reflector, share) for reflector in reflectors]
    return fitting


def _smaller(reflector: Reflector, share: float) -> Reflector:
    def shrunk(drawn: ReflectionMap) -> ReflectionMap:
        size = [
            max(MAP_SIZE_STEP_PX, int(side * share) // MAP_SIZE_STEP_PX * MAP_SIZE_STEP_PX) for side in (drawn.width_px, drawn.height_px)
        ]
        return replace(drawn, width_px=size[0], height_px=size[1])

    smaller = {id(drawn): shrunk(drawn) for drawn in reflector.maps}
    seen, met, aside, itself = (smaller.get(id(drawn)) for drawn in (reflector.seen, reflector.met, reflector.aside, reflector.itself))
    reason = reflector.reason + "; smaller for all maps to fit into memory" * bool(smaller)
    return replace(reflector, seen=seen, met=met, aside=aside, itself=itself, reason=reason)


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

    def without_hidden(self, is_seen: np.ndarray) -> PlannedReflections:
        """Without the maps for what the eye sees of reflectors that it does not see. is_seen: (instance_count,) bool"""
        reflectors = []
        for reflector in self.reflectors:
            if reflector.seen is None or is_seen[reflector.instances].any():
                reflectors.append(reflector)
                continue
            met = reflector.met if self.bounces > 1 else None
            reason = "skipped: hidden behind others" if met is None else "hidden from the eye, in the picture only within other reflectors"
            reflectors.append(replace(reflector, runs=met is not None, reason=reason, seen=None, met=met, aside=None, itself=None))
        return replace(self, reflectors=tuple(reflectors))

    def instance_maps(self, instance_count: int) -> np.ndarray:
        """(instance_count, 4) float32: numbers of the maps `seen`, `met`, `aside` and `itself`, -1: none"""
        numbers = {id(each): number for number, each in enumerate(self.maps)}
        rows = np.full((instance_count, 4), -1, np.float32)
        for reflector in self.reflectors:
            rows[reflector.instances, 0] = numbers.get(id(reflector.seen), -1)
            rows[reflector.instances, 1] = numbers.get(id(reflector.met), -1)
            rows[reflector.instances, 2] = numbers.get(id(reflector.aside), -1)
            rows[reflector.instances, 3] = numbers.get(id(reflector.itself), -1)
        return rows
