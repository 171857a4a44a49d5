"""How reflectors' cubes are made: each by the rasterizer, or with others from one cloud."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from .. import cost
from ..passes.reflection_maps import ReflectionMap
from ..scene import SceneSnapshot
from ..settings import ReflectionMethod, Settings

if TYPE_CHECKING:
    from .reflectors import Reflector


def with_methods(reflectors: list[Reflector], snapshot: SceneSnapshot, settings: Settings) -> list[Reflector]:
    """The same with what makes their cubes. Single views, cubes of reflectors alone and a room's from elsewhere stay the
    rasterizer's."""
    cubes = list({id(each): each for reflector in reflectors for each in _around(reflector)}.values())
    choices = dict(zip(map(id, cubes), _choices(cubes, snapshot, settings), strict=True))
    made = {id(each): replace(each, method=choices[id(each)][0]) for each in cubes}

    def changed(drawn: ReflectionMap | None) -> ReflectionMap | None:
        return made.get(id(drawn), drawn)

    found = []
    for each in reflectors:
        own = [choices[id(drawn)] for drawn in _around(each)]
        if not own:
            found.append(each)
            continue
        # a reflector has one cube
        method, reason = own[0]
        found.append(
            replace(
                each,
                seen=changed(each.seen),
                met=changed(each.met),
                aside=changed(each.aside),
                reason=f"{each.reason}; {reason}",
                method_text=method.value if each.method_text == ReflectionMethod.MVR.value else each.method_text,
            )
        )
    return found


def _around(reflector: Reflector) -> list[ReflectionMap]:
    return [each for each in (reflector.seen, reflector.met, reflector.aside) if each is not None and each.is_cube]


def _choices(cubes: list[ReflectionMap], snapshot: SceneSnapshot, settings: Settings) -> list[tuple[ReflectionMethod, str]]:
    """Of each cube the method, never AUTO, and why."""
    if settings.reflection_method is not ReflectionMethod.AUTO:
        return [(settings.reflection_method, f"{settings.reflection_method.value} as asked")] * len(cubes)
    mvr_ms, epr_ms = (cost.each_cube_ms(snapshot, settings, cubes, each) for each in (ReflectionMethod.MVR, ReflectionMethod.EPR))
    # the cloud takes its time once: those that are quicker splatted are so if they are together
    gains = epr_ms < mvr_ms
    drawn_ms = float(mvr_ms[gains].sum())
    splatted_ms = float(epr_ms[gains].sum()) + cost.cloud_ms(snapshot, settings, ReflectionMethod.EPR)
    together = _choice(drawn_ms, splatted_ms, f"{int(gains.sum())} cubes here")
    return [
        together if gains_by_it else _choice(own_mvr_ms, own_epr_ms, "its cube")
        for gains_by_it, own_mvr_ms, own_epr_ms in zip(gains, mvr_ms, epr_ms, strict=True)
    ]


def _choice(mvr_ms: float, epr_ms: float, what: str) -> tuple[ReflectionMethod, str]:
    times_ms = {ReflectionMethod.MVR: mvr_ms, ReflectionMethod.EPR: epr_ms}
    method, other = sorted(times_ms, key=lambda each: times_ms[each])
    return method, f"{method.value} about {times_ms[other] / max(times_ms[method], 1e-9):.1f} times faster than {other.value} for {what}"
