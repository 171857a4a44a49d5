"""Where rays meet reflectors, and which reflectors are near enough to each other to share a map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

MAX_CANDIDATES, MAX_OTHERS = 64, 4096
"""for the middle of a reflector, and places around it that are asked how near they are"""


class SeenPlaces:
    """What G-buffers show of some instances."""

    def __init__(self, positions: Sequence[np.ndarray], wanted: np.ndarray, sample_count: int) -> None:
        """positions: (height, width, 4) each, instance numbers last, negative where nothing is; wanted: (instance_count,) bool;
        sample_count: of a pixel, that the G-buffers are of"""
        flat = np.concatenate([each.reshape(-1, 4) for each in positions])
        shown = flat[flat[:, 3] >= 0]
        self._others = shown[:: max(1, len(shown) // MAX_OTHERS)].astype(np.float64)
        shown = shown[wanted[shown[:, 3].astype(np.int64)]]
        shown = shown[np.argsort(shown[:, 3], kind="stable")]
        self._places_ws = shown[:, :3].astype(np.float64)
        self._starts = np.searchsorted(shown[:, 3], np.arange(len(wanted) + 1))
        self._sample_count = sample_count

    def count(self, own: np.ndarray) -> int:
        """Rays of a sample of every pixel that meet these instances, (n,) int64; at least 1 where any does."""
        return -(-int((self._starts[own + 1] - self._starts[own]).sum()) // self._sample_count)

    def mean(self, own: np.ndarray) -> np.ndarray:
        """(3,) of the places on these instances; there is one where `count` is not 0."""
        return self._places_of(own).mean(axis=0)

    def middle(self, own: np.ndarray) -> np.ndarray:
        """(3,) the one of the places on these instances from which most is seen: near to the mean of all, and not close to other things,
        which would hide the rest from there. There is one where `count` is not 0."""
        places = self._places_of(own)
        from_mean = ((places - places.mean(axis=0)) ** 2).sum(axis=1)
        size = from_mean.mean()
        order = np.argsort(from_mean, kind="stable")[:: max(1, len(places) // MAX_CANDIDATES)]
        others = self._others[~np.isin(self._others[:, 3], own), :3]
        if len(others) == 0 or not size > 0:
            return places[order[0]]
        squared = ((places[order][:, None] - others[None]) ** 2).sum(axis=2)
        crowd = (1 / (squared + 1e-4 * size)).mean(axis=1)
        return places[order[np.argmin(crowd / np.median(crowd) + from_mean[order] / size)]]

    def _places_of(self, own: np.ndarray) -> np.ndarray:
        return np.concatenate([self._places_ws[self._starts[index] : self._starts[index + 1]] for index in own])


class Candidate(NamedTuple):
    """A reflector that may get a map."""

    name: str
    own: np.ndarray
    """(n,) int64 its instances"""
    ray_count: int
    """of a sample of every pixel, or what the picture lets expect"""
    place_ws: np.ndarray
    """(3,) about where it is seen, or its map's centre where that is known"""
    seen: SeenPlaces | None = None
    """that tell where in what is seen of it a map's centre is best"""

    def center_ws(self) -> np.ndarray:
        """(3,) Takes milliseconds: to be asked for only where a map needs it."""
        return self.place_ws if self.seen is None else self.seen.middle(self.own)


def near_each_other(candidates: list[Candidate], least_ray_count: float) -> list[list[Candidate]]:
    """Groups, halved along their longest sides for as long as every half has enough rays."""
    if len(candidates) < 2:
        return [candidates]
    places = np.array([each.place_ws for each in candidates])
    order = np.argsort(places[:, np.ptp(places, axis=0).argmax()], kind="stable")
    reached = np.cumsum([candidates[index].ray_count for index in order])
    cut = int(np.argmin(np.abs(reached[:-1] - reached[-1] / 2))) + 1
    if min(reached[cut - 1], reached[-1] - reached[cut - 1]) < least_ray_count:
        return [candidates]
    halves = ([candidates[index] for index in part] for part in (order[:cut], order[cut:]))
    return [group for half in halves for group in near_each_other(half, least_ray_count)]
