"""A render in steps, for front ends that must go on answering: no window, no operator in here.

With the device `moderngl` it runs on a thread of its own and a step only looks how far it is; Blender's own module belongs to the main
thread, where every step renders at most one batch of views, and of a long one a part.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace

from ..core.errors import SceneError, UsageError
from ..core.pass_set import PassSet
from ..core.plan import check_device
from ..core.render import Progress, render_in_steps
from ..device.failure import as_told
from . import devices
from .job import LayerJob

STEP_S = 0.1
"""after which a step on Blender's own thread ends, with what it is at"""


class CancelledError(Exception):
    """Ends a render that nobody waits for any more; reaches nobody."""


@dataclass(frozen=True)
class RenderState:
    """How far a render is; replaced as a whole, so that another thread may read it."""

    share_done: float = 0.0
    views_done: int = 0
    views_total: int = 0
    seconds_left: float | None = None
    error_estimate: float | None = None
    """None: not known yet"""
    stage: str = "preparing"
    light_name: str | None = None


_unfinished: set[SteppedRender] = set()
"""renders whose thread has not ended, also cancelled ones that are at their last stage"""


def stop_all() -> None:
    """Cancel what runs on threads and wait for it: afterwards nobody uses a device."""
    for each in list(_unfinished):
        each.cancel()
        each.join()


class SteppedRender:
    """Renders the jobs of a frame's view layers. Whoever makes one steps it until `is_done`, or cancels it."""

    def __init__(self, jobs: Mapping[str, LayerJob], device_name: str) -> None:
        """device_name: of an open device (`devices.device_name`)"""
        self.jobs = dict(jobs)
        self.device = devices.get_device(device_name)
        self.state = RenderState(views_total=sum(self._view_count(job) for job in self.jobs.values()))
        self.layers: dict[str, PassSet] = {}
        """view layer name -> passes; whole when `is_done` and there is no `error`"""
        self.error: BaseException | None = None
        self.is_done = False
        self.is_cancelled = False
        self._pauses = devices.is_bound_to_main_thread(device_name)
        self._is_within_batch = False
        self._steps = self._render()
        self._thread: threading.Thread | None = None
        if not self._pauses:
            _unfinished.add(self)
            self._thread = threading.Thread(target=self._run_through, name="vir-render", daemon=True)
            self._thread.start()

    @staticmethod
    def _view_count(job: LayerJob) -> int:
        return sum(planned.view_count for planned in job.plan.passes if planned.runs)

    @property
    def is_threaded(self) -> bool:
        return self._thread is not None

    def step(self) -> bool:
        """Go on for STEP_S, or until a batch ends, or look at the thread that does. True: done."""
        if self._thread is None and not self.is_done:
            start = time.perf_counter()
            self._advance()
            while self._is_within_batch and not self.is_done and time.perf_counter() - start < STEP_S:
                self._advance()
        return self.is_done

    def cancel(self) -> None:
        """Stop at the end of the current stage, and free what the device holds. Does not wait for a thread; `join` does."""
        self.is_cancelled = True
        if self._thread is None:
            with contextlib.suppress(CancelledError):  # on closing, the last picture would be read back
                self._steps.close()
            self.is_done = True

    def join(self) -> None:
        """Wait for the thread to end; for after `cancel`, before the device is closed."""
        if self._thread is not None:
            self._thread.join()

    def _run_through(self) -> None:
        while not self.is_done:
            self._advance()
        _unfinished.discard(self)

    def _advance(self) -> None:
        try:
            next(self._steps)
        except (StopIteration, CancelledError):
            self.is_done = True
        except BaseException as error:  # shown by whoever steps, on the main thread
            self.error = as_told(error)
            if isinstance(error, Exception) and not isinstance(error, UsageError | SceneError):  # a device that is lost stays so
                devices.drop_device(self.device)
            self.is_done = True

    def _render(self) -> Generator[None, None, None]:
        weight_total = sum(job.plan.predicted_ms + 1.0 for job in self.jobs.values())
        weight_done, views_done = 0.0, 0
        for layer_name, job in self.jobs.items():
            check_device(job.plan, self.device)
            weight = job.plan.predicted_ms + 1.0
            progress: Progress | None = None
            steps = render_in_steps(job.snapshot, job.plan, self.device, self._on_stage, pauses=self._pauses)
            with contextlib.closing(steps):
                for step in steps:
                    self._is_within_batch = step is None
                    if step is None:
                        yield
                        continue
                    progress = step
                    share = progress.batches_done / progress.batches_total
                    self.state = replace(
                        self.state,
                        share_done=(weight_done + weight * share) / weight_total,
                        views_done=views_done + progress.views_done,
                        seconds_left=progress.seconds_left * (1 + (weight_total - weight_done - weight) / weight),
                        error_estimate=progress.error_estimate,
                    )
                    if self.is_cancelled:
                        raise CancelledError
                    yield
            if progress is None:
                raise RuntimeError("the render ended before its first batch")
            self.layers[layer_name] = progress.pass_set
            weight_done += weight
            views_done += self._view_count(job)

    def _on_stage(self, stage: str, light_name: str | None) -> None:
        if self.is_cancelled:
            raise CancelledError
        self.state = replace(self.state, stage=stage, light_name=light_name)
