"""In how many batches reflections are traced, and how many bounces' hits there is memory for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from ..scene import SceneSnapshot
from ..settings import ReflectionFilter, ReflectionLookUp, Settings

MAX_ROUNDS_PER_BATCH = 4
"""Each keeps a G-buffer for every bounce until the batch's lights are through."""
MAX_HITS_MIB = 4096
"""for these and all else that has the picture's size"""
_TEXEL_BYTES = 16
_TEXTURES, _TEXTURES_PER_ROUND, _TEXTURES_PER_HIT = 6, 5, 5
"""of the picture's size: rays and sums; of the eye and of what a round brings; of what a bounce meets"""


class ReflectionRounds(NamedTuple):
    batch_count: int
    rounds_per_batch: int
    """rays of every pixel in a batch"""
    bounces: int
    note: str | None
    """of what there was no memory for"""


def hits_mib(snapshot: SceneSnapshot, rounds_per_batch: int, bounces: int) -> float:
    textures = _TEXTURES + rounds_per_batch * (_TEXTURES_PER_ROUND + bounces * _TEXTURES_PER_HIT)
    return textures * snapshot.width_px * snapshot.height_px * _TEXEL_BYTES / (1 << 20)


def plan_rounds(
    snapshot: SceneSnapshot,
    settings: Settings,
    bounces: int,
    batch_count: int,
    view_counts: Iterable[int],
    eye_samples_of: Callable[[int], int] = lambda batch_count: 1,
) -> ReflectionRounds:
    """More rays are more rounds of a batch first, so that lights' maps serve as many as there is memory for.

    batch_count: what the lights call for; view_counts: of the lights; eye_samples_of: how many of each of so many batches shadows call for,
    which are rounds as well, if there is memory for them, and if a batch may have several
    """
    wanted_count = wanted_rounds(settings)
    rounds, kept_bounces = min(math.ceil(wanted_count / batch_count), _most_rounds(settings)), bounces
    while rounds > 1 and hits_mib(snapshot, rounds, bounces) > MAX_HITS_MIB:
        rounds -= 1
    wanted = math.ceil(wanted_count / rounds)
    batch_count = _even_batch_count(max(wanted, batch_count), tuple(view_counts))
    # what is shaded is of one eye sample, whatever shadows would have
    eye_samples = 1 if settings.reflection_look_up.shades_texels else eye_samples_of(batch_count)
    while rounds < eye_samples and hits_mib(snapshot, rounds + 1, bounces) <= MAX_HITS_MIB:
        rounds += 1
    while kept_bounces > 1 and hits_mib(snapshot, rounds, kept_bounces) > MAX_HITS_MIB:
        kept_bounces -= 1
    note = None
    needed_mib = hits_mib(snapshot, rounds, kept_bounces)
    if kept_bounces < bounces:
        wanted_mib = hits_mib(snapshot, rounds, bounces)
        note = f"reflections bounce {kept_bounces} times, not {bounces}: what rays meet would take {wanted_mib:.0f} MiB at this resolution"
    elif needed_mib > MAX_HITS_MIB:
        note = f"what rays of reflections meet takes {needed_mib:.0f} MiB at this resolution"
    return ReflectionRounds(batch_count, rounds, kept_bounces, note)


def wanted_rounds(settings: Settings) -> int:
    """of all batches together, by what rays call for"""
    return 1 if settings.reflection_look_up is ReflectionLookUp.LAZY else settings.reflection_sample_count


def samples_per_round(settings: Settings, round_count: int) -> int:
    """Rays of a pixel from an eye sample."""
    is_lazy = settings.reflection_look_up is ReflectionLookUp.LAZY
    return math.ceil(settings.reflection_sample_count / round_count) if is_lazy else 1


def _most_rounds(settings: Settings) -> int:
    """of a batch"""
    count = settings.reflection_sample_count
    if settings.reflection_look_up.shades_texels:
        return 1  # what is shaded is looked up when all lights are in
    if settings.reflection_filter is ReflectionFilter.POISSON and count % MAX_ROUNDS_PER_BATCH and count % (MAX_ROUNDS_PER_BATCH + 1) == 0:
        return MAX_ROUNDS_PER_BATCH + 1  # 25 as published, not 28
    return MAX_ROUNDS_PER_BATCH


def least_ray_batches(sample_count: int, batch_count: int) -> int:
    """Batches that rays call for where lights call for so many, as far as memory goes."""
    return max(batch_count, math.ceil(sample_count / min(math.ceil(sample_count / batch_count), MAX_ROUNDS_PER_BATCH)))


def _even_batch_count(wanted: int, view_counts: tuple[int, ...]) -> int:
    """So many batches or some more, if that lets every light show each of its views equally often."""
    for count in range(wanted, 2 * wanted):
        if all(views >= count or count % max(views, 1) == 0 for views in view_counts):
            return count
    return wanted
