"""Milliseconds per stage. The device is waited for on both sides of a stage: work is queued, and would be billed to whoever waits.

Stages are also what a front end shows while it waits, and where work ends that nobody waits for any more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from typing import Any

from ..device.interface import Device
from .steps import HostWork, Result

OnStage = Callable[[str, str | None], None]
"""called when a stage begins, with its name (`pass_set.STAGES`) and that of the light that it is for, or None; on the device's thread"""


class StoppedError(Exception):
    """Ends work on the device's thread after `Stopwatch.stop`; reaches nobody."""


class Stopwatch:
    def __init__(self, device: Device, on_stage: OnStage | None = None) -> None:
        self.device = device
        self.shared_ms: dict[str, float] = {}
        self._current = self.shared_ms
        self._light_name: str | None = None
        self._on_stage = on_stage
        self._is_stopped = False

    def stop(self) -> None:
        """Let no further stage begin. May be called from any thread."""
        self._is_stopped = True

    @contextmanager
    def billed_to(self, stage_ms: dict[str, float], light_name: str) -> Iterator[None]:
        """Stages inside count for this light's pass instead of for all together."""
        before = self._current, self._light_name
        self._current, self._light_name = stage_ms, light_name
        try:
            yield
        finally:
            self._current, self._light_name = before

    def host_work(self, name: str, function: Callable[..., Any], *arguments: Any) -> HostWork:
        """A stage, billed as of now, that leaves the device alone: returns what to call for it, on any thread."""
        if self._is_stopped:
            raise StoppedError
        if self._on_stage is not None:
            self._on_stage(name, self._light_name)
        billed = self._current

        def call() -> Any:
            start = time.perf_counter()
            result = function(*arguments)
            billed[name] = billed.get(name, 0.0) + (time.perf_counter() - start) * 1e3
            return result

        return call

    def stages(self, name: str, parts: Generator[None, None, Result]) -> Generator[None, None, Result]:
        """A stage with pauses: time counts between `parts`' own. Returns what these do."""
        with closing(parts):
            result: list[Result] = []
            while not result:
                with self.stage(name):
                    try:
                        next(parts)
                    except StopIteration as end:
                        result.append(end.value)
                yield None
            return result[0]

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self._is_stopped:
            raise StoppedError
        if self._on_stage is not None:
            self._on_stage(name, self._light_name)
        self.device.finish()
        start = time.perf_counter()
        yield
        self.device.finish()
        self._current[name] = self._current.get(name, 0.0) + (time.perf_counter() - start) * 1e3
