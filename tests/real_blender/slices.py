"""What slices of the preview take, and what those do that take long. Waited for is what artists notice; own is what the main thread
computes, which other programs do not lengthen; all threads' is what a slice takes that has one core to itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from previewing import blender_side

LIMIT_MS = 300.0
"""of a slice on a software rasterizer"""
TOLD_MS = 20.0
"""Parts of a long slice that take less are not worth a line."""

Times = tuple[float, float, float]
"""waited for, own, all threads': seconds"""


def now() -> Times:
    return time.perf_counter(), time.thread_time(), time.process_time()


def since(start: Times) -> Times:
    waited_s, own_s, process_s = (after - before for before, after in zip(start, now(), strict=True))
    return waited_s * 1e3, own_s * 1e3, process_s * 1e3


def told(times_ms: Times) -> str:
    return "{:.0f} ms, own {:.0f}, all threads' {:.0f}".format(*times_ms)


def place_in(steps: Any) -> str:
    """Where generators stand that wait for each other, innermost last."""
    places = []
    while (frame := getattr(steps, "gi_frame", None)) is not None:
        places.append(f"{frame.f_code.co_name}:{frame.f_lineno}")
        steps = steps.gi_yieldfrom
    return " > ".join(places[-3:]) or "nothing"


@dataclass
class SliceWatch:
    """Replaces what serves a viewport by the same with clocks around it; enabling the extension anew makes another one necessary."""

    slices_ms: list[Times] = field(default_factory=list)
    """since `tell` was asked last"""
    all_count: int = 0
    long_counts: list[int] = field(default_factory=lambda: [0, 0])
    """slices above the limit: waited for, own"""
    _parts: list[tuple[Times, str]] = field(default_factory=list)

    def begin(self) -> None:
        running, viewport = blender_side("preview.running"), blender_side("preview.viewport")
        render = viewport.ProgressiveRender
        serve = running._serve

        def serve_timed(*arguments: Any) -> None:
            self._parts.clear()
            start = now()
            serve(*arguments)
            self._note(since(start))

        running._serve = serve_timed
        self._time(render, "_step", lambda one: place_in(one._steps))
        self._time(render, "_stop", lambda one: f"stop at {place_in(one._steps)}")
        self._time(viewport._Reading, "advance", lambda one: f"reading, {place_in(one._steps)}")

    def _time(self, owner: type, name: str, where: Callable[[Any], str]) -> None:
        function = getattr(owner, name)

        def timed(one: Any, *arguments: Any) -> Any:
            before = where(one)
            with self._part(lambda: f"{before} -> {where(one)}"):
                return function(one, *arguments)

        setattr(owner, name, timed)

    @contextmanager
    def _part(self, what: Callable[[], str]) -> Iterator[None]:
        start = now()
        try:
            yield
        finally:
            self._parts.append((since(start), what()))

    def _note(self, times_ms: Times) -> None:
        self.slices_ms.append(times_ms)
        self.all_count += 1
        waited_ms, own_ms, _ = times_ms
        self.long_counts[0] += waited_ms > LIMIT_MS
        self.long_counts[1] += own_ms > LIMIT_MS
        if waited_ms > LIMIT_MS:
            print(f"slice of {told(times_ms)}:")
            for part_ms, what in self._parts:
                if part_ms[0] > TOLD_MS:
                    print(f"    {told(part_ms)}: {what}")
            print(end="", flush=True)

    def tell(self, what: str) -> None:
        """Of the slices since it was asked last."""
        if self.slices_ms:
            waited_ms, own_ms, process_ms = (sorted(each) for each in zip(*self.slices_ms, strict=True))
            longest = told((waited_ms[-1], own_ms[-1], process_ms[-1]))
            print(f"{what}: {len(waited_ms)} slices, median {waited_ms[len(waited_ms) // 2]:.0f} ms, longest {longest}", flush=True)
        self.slices_ms.clear()

    def tell_all(self) -> None:
        waited, own = self.long_counts
        print(f"{self.all_count} slices, {waited} of them waited for above {LIMIT_MS:.0f} ms, {own} of their own", flush=True)
