"""Milliseconds per stage. The device is waited for on both sides of a stage: work is queued, and would be billed to whoever waits."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from ..device.interface import Device


class Stopwatch:
    def __init__(self, device: Device) -> None:
        self.device = device
        self.shared_ms: dict[str, float] = {}
        self._current = self.shared_ms

    @contextmanager
    def billed_to(self, stage_ms: dict[str, float]) -> Iterator[None]:
        """Stages inside count for these statistics instead of the shared ones."""
        before, self._current = self._current, stage_ms
        try:
            yield
        finally:
            self._current = before

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.device.finish()
        start = time.perf_counter()
        yield
        self.device.finish()
        self._current[name] = self._current.get(name, 0.0) + (time.perf_counter() - start) * 1e3
