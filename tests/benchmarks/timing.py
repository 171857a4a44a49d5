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
    """Name -> what the job returned in every round."""
    results: dict[str, list[Result]] = {name: [] for name in jobs}
    names = list(jobs)
    for round_index in range(rounds):
        for place in turn_order(len(names), round_index):
            results[names[place]].append(jobs[names[place]]())
    return results


def turn_order(count: int, round_index: int) -> list[int]:
    """The jobs of a round, by number: in a row of so many rounds (of an odd number of jobs: two) each follows every other equally often.

    Whoever follows a job that leaves caches and memory in disorder is slower by a tenth. Williams 1949, "Experimental designs balanced for
    the estimation of residual effects of treatments".
    """
    zigzag = [(step + 1) // 2 if step % 2 else -step // 2 for step in range(count)]
    order = [(place + round_index) % count for place in zigzag]
    return order[::-1] if count % 2 and round_index // count % 2 else order


def median_ratio(numerators: Sequence[float], denominators: Sequence[float]) -> float:
    return statistics.median(round_ratios(numerators, denominators))


def round_ratios(numerators: Sequence[float], denominators: Sequence[float]) -> list[float]:
    return [a / b for a, b in zip(numerators, denominators, strict=True)]
