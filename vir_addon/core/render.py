"""The streamed loop: a generator that can be stopped after any batch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .pass_set import PassSet, SetStatistics
from .plan import RenderPlan
from .scene import SceneSnapshot


@dataclass
class Progress:
    """The state after a batch of views. `passes` is complete and valid at every step; it only gets better."""

    views_done: int
    views_total: int
    elapsed_s: float
    seconds_left: float
    """predicted from the batches so far"""
    error_estimate: float
    """the largest error estimate of the passes so far"""
    statistics: SetStatistics

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """pass name -> (height, width) float32; read back from the device on first access of this step"""
        raise NotImplementedError

    @property
    def pass_set(self) -> PassSet:
        raise NotImplementedError


def render(snapshot: SceneSnapshot, plan: RenderPlan, device) -> Iterator[Progress]:
    """Yield after every batch. Closing the generator releases the device's memory."""
    raise NotImplementedError
