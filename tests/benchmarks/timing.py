"""Times that can be compared: competitors take turns within one run, and ratios are taken round by round.

A machine that grows slower in the middle of a run slows all competitors of a round alike, so the median of the rounds' ratios moves
far less than the ratio of two medians.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

Result = TypeVar("Result")


def take_turns(jobs: Mapping[str, Callable[[], Result]], rounds: int) -> dict[str, list[Result]]:
    """Name -> what the job returned in every round. Every other round runs backwards, so that nobody always follows the same one."""
    results: dict[str, list[Result]] = {name: [] for name in jobs}
    for round_index in range(rounds):
        for name in list(jobs) if round_index % 2 == 0 else reversed(jobs):
            results[name].append(jobs[name]())
    return results


def median_ratio(numerators: Sequence[float], denominators: Sequence[float]) -> float:
    return statistics.median(round_ratios(numerators, denominators))


def round_ratios(numerators: Sequence[float], denominators: Sequence[float]) -> list[float]:
    return [a / b for a, b in zip(numerators, denominators, strict=True)]
