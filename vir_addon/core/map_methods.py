"""How reflectors' cubes are made: one by one by the rasterizer, or all from one cloud."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from . import cost
from .passes.reflection_maps import ReflectionMap
from .scene import SceneSnapshot
from .settings import ReflectionMethod, Settings

if TYPE_CHECKING:
    from .reflectors import Reflector


def with_methods(reflectors: list[Reflector], snapshot: SceneSnapshot, settings: Settings) -> list[Reflector]:
    """The same with what makes their cubes. Single views stay the rasterizer's."""
    cubes = list({id(each): each for reflector in reflectors for each in reflector.maps if each.is_cube}.values())
    method, reason = _choice(cubes, snapshot, settings)
    if method is ReflectionMethod.MVR:
        return [_explained(each, reason) for each in reflectors]
    splatted = {id(each): replace(each, method=method) for each in cubes}

    def changed(drawn: ReflectionMap | None) -> ReflectionMap | None:
        return splatted.get(id(drawn), drawn)

    return [
        _explained(
            replace(
                each,
                seen=changed(each.seen),
                met=changed(each.met),
                aside=changed(each.aside),
                itself=changed(each.itself),
                method_text=method.value if each.method_text == ReflectionMethod.MVR.value else each.method_text,
            ),
            reason,
        )
        for each in reflectors
    ]


def _explained(reflector: Reflector, reason: str) -> Reflector:
    has_cube = any(each.is_cube for each in reflector.maps)
    return replace(reflector, reason=f"{reflector.reason}; {reason}") if has_cube and reason else reflector


def _choice(cubes: list[ReflectionMap], snapshot: SceneSnapshot, settings: Settings) -> tuple[ReflectionMethod, str]:
    """The method, never AUTO, and why."""
    if settings.reflection_method is not ReflectionMethod.AUTO:
        return settings.reflection_method, f"{settings.reflection_method.value} as asked"
    times_ms = {method: cost.cubes_ms(snapshot, settings, cubes, method) for method in (ReflectionMethod.MVR, ReflectionMethod.EPR)}
    method, other = sorted(times_ms, key=lambda each: times_ms[each])
    ratio = times_ms[other] / max(times_ms[method], 1e-9)
    return method, f"{method.value} about {ratio:.1f} times faster than {other.value} for {len(cubes)} cubes here" if cubes else ""
