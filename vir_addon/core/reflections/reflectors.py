"""Which objects reflect and from where what they show is drawn: decided from materials and the picture before any GPU work."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...device.interface import LINEAR_TEXTURE_WIDTH, Device
from ..bounds import SceneBounds
from ..material import Material
from ..material_program import typical_value
from ..passes.reflection_maps import BYTES_PER_TEXEL, FURTHER_MAPS, MAP_SIZE_STEP_PX, ReflectionMap
from ..passes.shaded_maps import SHADED_BYTES_PER_TEXEL
from ..scene import SceneSnapshot
from ..settings import Settings
from .map_methods import with_methods
from .seen_places import Candidate, SeenPlaces, near_each_other
from .views import (
    MAX_INSCRIBED_TRIANGLES,
    MAX_VIEW_PX,
    convexity,
    covered_size_px,
    cube_around,
    cube_around_eye,
    cube_size_px,
    cubes_elsewhere,
    cubes_of_itself,
    eye_is_inside,
    eye_view,
    flat_plane,
    is_too_fine,
    main_plane,
    mirrored_view,
)

DEFAULT_BOUNCES = 2
"""where several reflectors in the picture may show in each other"""
MAX_REFLECTORS, MAX_GROUPS = 64, 16
"""with maps of their own, and of others that share theirs: each draws the scene"""
MIN_PICTURE_SHARE, MIN_GROUP_SHARE = 0.001, 0.0001
"""of the picture, which must show a reflector, or its box cover, for it to have a map of its own; and all small ones together, for any
of them to have one"""
MIN_MAP_RAYS = 64
"""or so many pixels for a map of its own: in small pictures maps would cost more than all the rest"""
TOO_SMALL = "all such together show in next to no pixels"
WAITING = ": a map if enough of it shows within other reflectors"
"""what ends the reasons of those that it is not decided for yet"""
SMALLER = "; smaller for all maps to fit into memory"
SMALLER_BESIDES = "; cubes besides smaller for all maps to fit into memory"
WITHOUT_BESIDES = "; no memory is left for cubes besides"
FOR_MEMORY = SMALLER, SMALLER_BESIDES, WITHOUT_BESIDES
MET_SHARE = 0.25
"""of maps' memory, kept for reflectors that only others show"""
MAX_LINES_ALIKE = 3
"""of reflectors without maps for the same reason"""
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
"""of cubes of flat reflectors, for what is not seen in their mirrored view, and of cubes of reflectors alone"""


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
    """where rays go on that leave the mirrored view `seen`, and rays of light that what it shows is lit by"""
    itself: ReflectionMap | None = None
    """what the eye sees of it, for what of itself it shows; of reflectors whose hollows the eye sees"""
    own_cubes: tuple[ReflectionMap, ...] = ()
    """the reflector alone, for what it and others show of it that neither the eye nor others' cubes see; none or OWN_CUBES"""
    covered_px: tuple[int, int] = (0, 0)
    """of its bounds in the picture"""
    elsewhere: tuple[ReflectionMap, ...] = ()
    """from other places than the eye in a room around it, for what things in the room hide"""

    @property
    def cube(self) -> ReflectionMap | None:
        """what surrounds it, without it"""
        return next((each for each in (self.aside, self.seen, self.met) if each is not None), None)

    @property
    def maps(self) -> list[ReflectionMap]:
        """each once"""
        found = (self.seen, self.met, self.aside, self.itself, *self.own_cubes, *self.elsewhere)
        return list({id(each): each for each in found if each is not None}.values())


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
    snapshot: SceneSnapshot, bounds: SceneBounds, settings: Settings, in_picture: np.ndarray, seen: SeenPlaces | None = None
) -> PlannedReflections:
    """All reflectors of the scene with what is drawn for each.

    in_picture: (instance_count,) bool. seen: what the picture shows of them; without, it is what boxes around them cover.
    """
    lines, candidates, others = [], [], []
    for own in _grouped(snapshot, np.flatnonzero(reflecting_instances(snapshot))):
        name = snapshot.instances.object_names[snapshot.instances.object_index[own[0]]]
        corners = bounds.corners_ws[own].reshape(-1, 3)
        if not _extent(bounds, own) > 0:
            lines.append(Reflector(name, own, runs=False, reason="skipped: it has no size"))
        elif in_picture[own].any() and seen is None:
            place_ws = (corners.min(axis=0) + corners.max(axis=0)) / 2
            candidates.append(Candidate(name, own, math.prod(covered_size_px(snapshot, corners)), place_ws))
        elif in_picture[own].any() and seen is not None and seen.count(own):
            candidates.append(Candidate(name, own, seen.count(own), seen.mean(own), seen))
        else:
            others.append((name, own, bool(in_picture[own].any())))
    groups, left_out = _sharing_maps(snapshot, candidates)
    # a single one has nothing to see itself in
    most_bounces = 1 if settings.reflection_look_up.shades_texels else DEFAULT_BOUNCES
    bounces = settings.bounces or (most_bounces if len(groups) > 1 else 1)
    found = [
        _plan_group(snapshot, bounds, group, settings, is_measured=seen is not None)
        if len(group) > 1
        else _plan_reflector(snapshot, bounds, group[0], bounces, settings, is_measured=seen is not None)
        for group in groups
    ]
    unmapped = [(each.name, each.own, TOO_SMALL) for each in left_out]
    for name, own, is_hidden in others:
        unmapped.append((name, own, _where_hidden(snapshot, bounds, own) if is_hidden else "not in the picture"))
    kept_free = MET_SHARE if bounces > 1 and unmapped else 0.0
    lines += with_methods(_within_memory(found, settings.reflection_map_mib * (1 - kept_free), settings), snapshot, settings)
    for name, own, where in unmapped:
        lines.append(Reflector(name, own, runs=bounces > 1, reason=f"{where}{WAITING}" if bounces > 1 else f"skipped: {where}"))
    return PlannedReflections(tuple(lines), bounces)


def _where_hidden(snapshot: SceneSnapshot, bounds: SceneBounds, own: np.ndarray) -> str:
    """Of a reflector in the picture that the eye does not see: within another, perhaps."""
    instances, corners = snapshot.instances, bounds.corners_ws[own].reshape(-1, 3)
    is_closed = np.array([mesh.is_closed for mesh in snapshot.meshes], bool)[instances.mesh_index]
    around = (bounds.corners_ws.min(axis=1) < corners.min(axis=0)).all(axis=1) & (bounds.corners_ws.max(axis=1) > corners.max(axis=0)).all(
        axis=1
    )
    around = np.flatnonzero(around & is_closed & reflecting_instances(snapshot))
    return f"within {instances.object_names[instances.object_index[around[0]]]!r}" if len(around) else "hidden behind others"


def _least_ray_count(snapshot: SceneSnapshot) -> float:
    """of a reflector with a map of its own"""
    return max(MIN_PICTURE_SHARE * snapshot.width_px * snapshot.height_px, MIN_MAP_RAYS)


def _sharing_maps(snapshot: SceneSnapshot, candidates: list[Candidate]) -> tuple[list[list[Candidate]], list[Candidate]]:
    """Those that share a map each: one that shows much alone, at most MAX_REFLECTORS such, others with those near them. And those that
    show next to nothing even together."""
    pixel_count = snapshot.width_px * snapshot.height_px
    least_ray_count = _least_ray_count(snapshot)
    ranked = sorted(candidates, key=lambda each: -each.ray_count)
    alone = [each for each in ranked[:MAX_REFLECTORS] if each.ray_count >= least_ray_count]
    shared = ranked[len(alone) :]
    ray_count = sum(each.ray_count for each in shared)
    if ray_count < MIN_GROUP_SHARE * pixel_count:
        return [[each] for each in alone], shared
    groups = near_each_other(shared, max(least_ray_count, ray_count / MAX_GROUPS))
    return [*([each] for each in alone), *groups], []


def with_met(
    planned: PlannedReflections, snapshot: SceneSnapshot, bounds: SceneBounds, settings: Settings, hits: SeenPlaces
) -> PlannedReflections:
    """With maps for reflectors that the eye does not see but enough of which shows in others. The same if there is none."""
    shown = [each for each in planned.waiting if hits.count(each.instances)]
    candidates = [Candidate(each.name, each.instances, hits.count(each.instances), hits.mean(each.instances), hits) for each in shown]
    reason = "shows enough only within other reflectors"

    def plan_one(each: Candidate) -> Reflector:
        cube = cube_around(snapshot, bounds, each.own, UNSEEN_MAP_PX, find_place=each.center_ws)
        return Reflector(each.name, each.own, runs=True, reason=reason, method_text="mvr", met=cube)

    def plan_group(group: list[Candidate]) -> Reflector:
        together = _together(group)
        cube = cube_around(snapshot, bounds, together.own, cube_size_px(0), find_place=together.center_ws)
        return Reflector(together.name, together.own, True, f"{reason}; near each other: one map", "mvr", met=cube)

    groups, _ = _sharing_maps(snapshot, candidates)
    if not groups:
        return planned
    found = [plan_group(group) if len(group) > 1 else plan_one(group[0]) for group in groups]
    used_mib = sum(each.texel_count for each in planned.maps) * bytes_per_texel(settings) / (1 << 20)
    found = with_methods(_within_memory(found, settings.reflection_map_mib - used_mib, settings), snapshot, settings)
    has_map = np.concatenate([each.instances for each in found])
    kept = tuple(each for each in planned.reflectors if each.maps or not np.isin(each.instances, has_map).any())
    return replace(planned, reflectors=(*kept, *found), maps=(*planned.maps, *(drawn for each in found for drawn in each.maps)))


def _together(group: list[Candidate]) -> Candidate:
    """Seen where that one is which is nearest to the middle of all."""
    weights = np.array([each.ray_count for each in group], np.float64)
    places = np.array([each.place_ws for each in group])
    middle = np.average(places, axis=0, weights=weights)
    place_ws = group[np.argmin(((places - middle) ** 2).sum(axis=1))].center_ws()
    name = f"{group[0].name} and {len(group) - 1} more"
    return Candidate(name, np.concatenate([each.own for each in group]), int(weights.sum()), place_ws)


def _plan_group(
    snapshot: SceneSnapshot, bounds: SceneBounds, group: list[Candidate], settings: Settings, *, is_measured: bool
) -> Reflector:
    together = _together(group)
    covered_px = max(max(covered_size_px(snapshot, bounds.corners_ws[each.own].reshape(-1, 3))) for each in group)
    side_px = settings.reflection_cube_px or cube_size_px(covered_px)
    cube = cube_around(snapshot, bounds, together.own, side_px, find_place=together.center_ws)
    is_small = max(each.ray_count for each in group) < _least_ray_count(snapshot)
    why = "small and near each other" if is_small else f"more than {MAX_REFLECTORS} reflectors, these near each other"
    reason = f"{'' if is_measured else 'up to '}{together.ray_count} px in the picture; {why}: one map"
    return Reflector(together.name, together.own, True, reason, "mvr", cube, cube, covered_px=(together.ray_count, 1))


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
    snapshot: SceneSnapshot, bounds: SceneBounds, candidate: Candidate, bounces: int, settings: Settings, *, is_measured: bool
) -> Reflector:
    """Of one that the eye sees. is_measured: not only a guess by its box"""
    name, own = candidate.name, candidate.own
    corners = bounds.corners_ws[own].reshape(-1, 3)
    covered_px = covered_size_px(snapshot, corners)
    reason = f"{candidate.ray_count} px in the picture" if is_measured else f"{covered_px[0]} x {covered_px[1]} px in the picture"
    side_px = settings.reflection_cube_px or cube_size_px(max(covered_px))
    plane = flat_plane(snapshot, own) if settings.has_mirrored_views else None
    if snapshot.camera.is_orthographic:
        reason += "; a parallel camera has neither mirrored views nor views of reflectors themselves"
    if plane is not None and not snapshot.camera.is_orthographic:
        view = mirrored_view(snapshot, bounds, own, plane)
        if view is not None:
            # what the mirrored view does not show: rays from other reflectors, and what lights the surfaces that it shows
            aside = cube_around(snapshot, bounds, own, min(side_px, ASIDE_MAP_PX), find_place=candidate.center_ws)
            return Reflector(name, own, True, f"{reason}; flat: one mirrored view", "planar", view, aside, aside, covered_px=covered_px)
    if eye_is_inside(snapshot, own, corners):
        cube = cube_around_eye(snapshot, bounds, own, side_px)
        reason += "; the eye is inside, so its cube is around the eye"
        elsewhere: tuple[ReflectionMap, ...] = ()
        if not settings.reflection_look_up.shades_texels:
            elsewhere = cubes_elsewhere(snapshot, bounds, own, min(side_px, ASIDE_MAP_PX))
            reason += f", {len(elsewhere)} more elsewhere in it" if elsewhere else ""
        return Reflector(name, own, True, reason, "mvr", cube, cube, elsewhere=elsewhere, covered_px=covered_px)
    seen = cube_around(snapshot, bounds, own, side_px, nearer_to_eye=True, find_place=candidate.center_ws)
    if is_too_fine(snapshot, own):
        reason += f"; more than {MAX_INSCRIBED_TRIANGLES} triangles: its cube is around a place on it"
    itself: ReflectionMap | None = None
    own_cubes: tuple[ReflectionMap, ...] = ()
    # cubes of itself serve rays from everywhere, so they do not come and go with the eye
    is_convex, is_convex_to_eye = convexity(snapshot, own)
    if not is_convex and not settings.reflection_look_up.shades_texels:
        own_cubes = cubes_of_itself(snapshot, bounds, own, min(side_px, ASIDE_MAP_PX))
        if own_cubes and not is_convex_to_eye and not snapshot.camera.is_orthographic:
            itself = eye_view(snapshot, bounds, own)
        if own_cubes:
            reason += f"; not convex: {'' if itself is None else 'a view and '}cubes of itself besides"
    met = seen if bounces > 1 else None
    plane = main_plane(snapshot, own) if settings.has_mirrored_views and not snapshot.camera.is_orthographic else None
    view = None if plane is None else mirrored_view(snapshot, bounds, own, plane)
    if view is not None:
        reason += "; mostly flat: a mirrored view besides"
        return Reflector(name, own, True, reason, "mvr", view, met, seen, itself, own_cubes, covered_px)
    return Reflector(name, own, True, reason, "mvr", seen, met, None, itself, own_cubes, covered_px)


def bytes_per_texel(settings: Settings) -> int:
    """of maps, and of what is kept of each texel where they are shaded whole"""
    return BYTES_PER_TEXEL + SHADED_BYTES_PER_TEXEL * settings.reflection_look_up.shades_texels


def _within_memory(reflectors: list[Reflector], memory_mib: float, settings: Settings) -> list[Reflector]:
    """Smaller maps where all together would take more than the settings allow: cubes of reflectors alone and a room's from elsewhere
    first, then without these the others, and none of the last reflectors where that is not enough."""
    budget = memory_mib * (1 << 20) // bytes_per_texel(settings)
    fitting, share = reflectors, 1.0
    while _texel_count(fitting) > budget and share > 1 / ASIDE_MAP_PX:
        share *= SHRINKING
        fitting = [_smaller(reflector, 1.0, share) for reflector in reflectors]
    if _texel_count(fitting) > budget:
        fitting = reflectors = [_without_besides(reflector) for reflector in reflectors]
        share = 1.0
    while _texel_count(fitting) > budget and share > 1 / MAX_VIEW_PX:
        share *= SHRINKING
        fitting = [_smaller(reflector, share) for reflector in reflectors]
    reached = np.cumsum([0, *(_texel_count([each]) for each in fitting)])[1:]
    reason = "skipped: no memory is left for its map"
    return [
        each if end <= budget else Reflector(each.name, each.instances, runs=False, reason=reason)
        for each, end in zip(fitting, reached, strict=True)
    ]


def _without_besides(reflector: Reflector) -> Reflector:
    has_any = reflector.own_cubes or reflector.elsewhere
    return replace(reflector, own_cubes=(), elsewhere=(), reason=reflector.reason + WITHOUT_BESIDES) if has_any else reflector


def _texel_count(reflectors: list[Reflector]) -> int:
    return sum(each.texel_count for reflector in reflectors for each in reflector.maps)


def memory_for_maps(device: Device, settings: Settings) -> Settings:
    """The same settings with no more memory for reflectors' maps than the device's largest texture holds."""
    largest_mib = LINEAR_TEXTURE_WIDTH * device.max_texture_size_px * bytes_per_texel(settings) >> 20
    return replace(settings, reflection_map_mib=min(settings.reflection_map_mib, largest_mib))


def _smaller(reflector: Reflector, share: float, share_besides: float = 1.0) -> Reflector:
    """share_besides: of the sides of cubes of it alone, and of a room's from elsewhere"""

    def shrunk(drawn: ReflectionMap, by: float) -> ReflectionMap:
        width, height = (
            max(MAP_SIZE_STEP_PX, int(side * by) // MAP_SIZE_STEP_PX * MAP_SIZE_STEP_PX) for side in (drawn.width_px, drawn.height_px)
        )
        return drawn if (width, height) == (drawn.width_px, drawn.height_px) else replace(drawn, width_px=width, height_px=height)

    own_cubes, elsewhere = (
        tuple(shrunk(drawn, share_besides) for drawn in besides) for besides in (reflector.own_cubes, reflector.elsewhere)
    )
    smaller = {id(drawn): shrunk(drawn, share) for drawn in reflector.maps}
    seen, met, aside, itself = (smaller.get(id(drawn)) for drawn in (reflector.seen, reflector.met, reflector.aside, reflector.itself))
    reason = reflector.reason
    if any(smaller[id(drawn)] is not drawn for drawn in (reflector.seen, reflector.met, reflector.aside, reflector.itself) if drawn):
        reason += SMALLER
    besides_before = (*reflector.own_cubes, *reflector.elsewhere)
    if any(each is not drawn for each, drawn in zip((*own_cubes, *elsewhere), besides_before, strict=True)):
        reason += SMALLER_BESIDES
    return replace(reflector, seen=seen, met=met, aside=aside, itself=itself, own_cubes=own_cubes, elsewhere=elsewhere, reason=reason)


@dataclass(frozen=True, eq=False)
class PlannedReflections:
    """What becomes of the reflections of a frame."""

    reflectors: tuple[Reflector, ...]
    bounces: int
    predicted_ms: float = 0.0
    maps: tuple[ReflectionMap, ...] = ()
    """of all reflectors; those that were drawn first come first"""

    def __post_init__(self) -> None:
        if not self.maps:
            object.__setattr__(self, "maps", tuple(each for reflector in self.reflectors for each in reflector.maps))

    @property
    def runs(self) -> bool:
        return any(reflector.seen is not None for reflector in self.reflectors)

    @property
    def waiting(self) -> list[Reflector]:
        """for others to show enough of them to have maps"""
        return [each for each in self.reflectors if each.runs and not each.maps]

    def settled(self) -> PlannedReflections:
        """The same when no further maps are to come."""
        why = ", and next to nothing of it shows within other reflectors" if self.bounces > 1 and self.runs else ""
        waiting = {id(each) for each in self.waiting}
        told = (
            replace(each, runs=False, reason=f"skipped: {each.reason.removesuffix(WAITING)}{why}") if id(each) in waiting else each
            for each in self.reflectors
        )
        return replace(self, reflectors=tuple(told))

    @property
    def texts(self) -> list[str]:
        """What became of each."""
        return [f"{each.name}: {' '.join(filter(None, [each.method_text, each.reason]))}" for each in self.reflectors]

    @property
    def lines(self) -> list[Reflector]:
        """What is to be told of the reflectors: where many without maps have the same reason, one for all of them."""
        mapless: dict[tuple[bool, str], list[Reflector]] = {}
        for each in self.reflectors:
            if not each.maps:
                mapless.setdefault((each.runs, each.reason), []).append(each)
        told = [each for each in self.reflectors if each.maps]
        for (runs, reason), alike in mapless.items():
            if len(alike) > MAX_LINES_ALIKE:
                instances = np.concatenate([each.instances for each in alike])
                told.append(Reflector(f"{len(alike)} reflectors", instances, runs, reason))
            else:
                told += alike
        return told

    def other_maps(self) -> tuple[np.ndarray, np.ndarray]:
        """(map_count, FURTHER_MAPS) numbers of the cubes of other reflectors that are nearest, each of which is asked for what maps of its
        reflector do not know, and (map_count,) those of the first of its reflector's own cubes; -1: none"""
        numbers = {id(each): number for number, each in enumerate(self.maps)}
        further, first_own = np.full((len(self.maps), FURTHER_MAPS), -1, np.int64), np.full(len(self.maps), -1, np.int64)
        cubes = [each.cube for each in self.reflectors]
        own = [(each, cube) for each, cube in zip(self.reflectors, cubes, strict=True) if cube is not None]
        centers_ws = np.array([cube.center_ws for _, cube in own])
        for k, (reflector, cube) in enumerate(own):
            nearest = np.argsort(((centers_ws - cube.center_ws) ** 2).sum(axis=1), kind="stable")
            others = [*reflector.elsewhere, *(own[other][1] for other in nearest if other != k)][:FURTHER_MAPS]
            for each in reflector.maps:
                further[numbers[id(each)], : len(others)] = [numbers[id(other)] for other in others]
                if reflector.own_cubes:
                    first_own[numbers[id(each)]] = numbers[id(reflector.own_cubes[0])]
        return further, first_own

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

    def maps_without(self, instance_count: int) -> np.ndarray:
        """(instance_count, 2) float32: numbers of the maps that leave an instance out, of those that are asked for what lights others: for
        what the eye sees, and for rays from other reflectors; -1: none"""
        numbers = {id(each): number for number, each in enumerate(self.maps)}
        rows = np.full((instance_count, 2), -1, np.float32)
        for reflector in self.reflectors:
            for column, each in enumerate((reflector.aside or reflector.seen, reflector.met)):
                if each is not None:
                    rows[np.setdiff1d(reflector.instances, each.instances), column] = numbers.get(id(each), -1)
        return rows
