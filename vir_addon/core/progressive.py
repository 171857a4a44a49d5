"""A picture that follows a scene as it changes and gets better while nothing does, made slice by slice so that nobody has to wait."""

from __future__ import annotations

import time
from collections import deque
from concurrent.futures import Executor, Future, TimeoutError
from dataclasses import dataclass
from typing import Any

from ..device.interface import Device
from .picture import Choice, Picture
from .plan import RenderPlan, check_device, plan
from .render import Renderer
from .scene import SceneSnapshot
from .settings import Settings
from .steps import Steps, send_step

WATCHED_STEPS = 16
"""The longest of so many latest steps is what the next one is expected to take in the first batch."""
NEARBY_STEPS = 3
"""Batches are made in the same steps: in later ones it is the longest of so many before and after its place in the batch before. Which
steps pause may change by some."""
AIMED_SHARE = 1 / 2
"""of a slice, after which nothing more is begun: a step may take longer than those before it did"""
HOST_WAIT_SHARE = 1 / 3
"""of a slice: short work on another thread is worth waiting for, as the next slice would come later"""


@dataclass(frozen=True)
class Standing:
    """How far the picture is."""

    views_done: int = 0
    """light samples looked up so far, of all lights"""
    views_total: int = 0
    error_estimate: float = float("inf")
    """the largest of the lights; infinite before there are two rounds"""
    busy_ms: float = 0.0
    """that work took since the last change"""


class ProgressiveRender:
    """Ask it to `show` a snapshot, again whenever anything changes, and to `advance` as often as there is time.

    What a new snapshot leaves as it was is not made again (`Renderer`, `previous`). Planning and fitting views are numpy's business and
    happen in `executor`, so they take no time of the caller's; the device is only used within `advance`.
    """

    def __init__(self, device: Device, executor: Executor) -> None:
        self.device, self.executor = device, executor
        self.snapshot: SceneSnapshot | None = None
        self.settings = Settings()
        self.picture: Picture | None = None
        """of `choice`; the scene that it shows is `picture_of`"""
        self.picture_of: SceneSnapshot | None = None
        self.choice = Choice()
        """what is drawn of what the settings' effects make"""
        self.plan: RenderPlan | None = None
        self.standing = Standing()
        self.compiled_count = 0
        """kernels since the last change"""
        self.slowest_step_ms = 0.0
        """of batches since the last change; steps in which a kernel was translated do not count"""
        self._renderer: Renderer | None = None
        self._steps: Steps | None = None
        self._pending: Future[Any] | None = None
        self._answer: Any = None
        """what has come of it"""
        self._recent_s: deque[float] = deque(maxlen=WATCHED_STEPS)
        self._batch_s: list[float] = []
        """steps of the batch so far"""
        self._batch_before_s: list[float] = []
        self._drawn: tuple[Choice, int] | None = None
        """what is in the picture, and after how many batches"""
        self._batches_done = 0
        self._is_rendering = self._is_between_batches = False

    @property
    def is_done(self) -> bool:
        """Nothing to do until something else is to be shown."""
        return self._steps is None and self._is_drawn

    @property
    def _is_compiling(self) -> bool:
        """The next step may meet a kernel that has not been compiled, too, which takes long: each gets a slice of its own."""
        return self.compiled_count > 0 and self._batches_done == 0

    @property
    def is_waiting(self) -> bool:
        """For what happens in the executor."""
        return self._pending is not None and not self._pending.done()

    def show(self, snapshot: SceneSnapshot, settings: Settings) -> None:
        """From now on. What was under way for another snapshot ends here."""
        self._stop()
        self.snapshot, self.settings = snapshot, settings
        self.standing = Standing()
        self.slowest_step_ms, self._batches_done, self._is_between_batches, self._drawn = 0.0, 0, False, None
        self._is_rendering, self.compiled_count = False, 0
        self._batch_s, self._batch_before_s = [], []
        self._steps = self._working(snapshot, settings)

    def advance(self, budget_s: float) -> bool:
        """Work for no longer unless a step takes longer: one at least, and no more where kernels are being compiled. Whether the picture
        has changed.

        Raises VirError if what is to be shown cannot be: then nothing happens before `show` is called again.
        """
        start, translation_count = time.perf_counter(), self.device.translation_count
        has_changed = has_waited = False
        try:
            while not (self.is_done or has_waited):
                if self._pending is not None:
                    has_waited = not self._wait(min(budget_s * HOST_WAIT_SHARE, budget_s - (time.perf_counter() - start)))
                else:
                    has_changed |= self._step()
                if self._is_compiling or self.device.translation_count > translation_count:
                    break
                if time.perf_counter() - start + self._expected_s > AIMED_SHARE * budget_s:
                    break
        except BaseException:
            self._stop()
            raise
        finally:
            busy_ms = self.standing.busy_ms + (time.perf_counter() - start) * 1e3
            self.standing = Standing(self.standing.views_done, self.standing.views_total, self.standing.error_estimate, busy_ms)
        return has_changed

    @property
    def _expected_s(self) -> float:
        """What the next step will take."""
        place = len(self._batch_s)
        nearby_s = self._batch_before_s[max(place - NEARBY_STEPS, 0) : place + NEARBY_STEPS + 1]
        return max(nearby_s or self._recent_s, default=0.0)

    def _wait(self, limit_s: float) -> bool:
        """For what happens in the executor; whether it is there."""
        assert self._pending is not None
        try:
            self._answer = self._pending.result(timeout=max(limit_s, 0.0))
        except TimeoutError:
            return False
        self._pending = None
        return True

    def _step(self) -> bool:
        if self._steps is None or (self._is_between_batches and not self._is_drawn):
            return self._draw()
        answer, self._answer = self._answer, None
        start, kernel_count, translation_count = time.perf_counter(), self.device.kernel_count, self.device.translation_count
        host_work, has_ended = self.device.run(send_step, self._steps, answer)
        took_s = time.perf_counter() - start
        self.compiled_count += self.device.kernel_count - kernel_count
        if self.device.translation_count == translation_count:
            self._recent_s.append(took_s)
            if self._is_rendering:
                self.slowest_step_ms = max(self.slowest_step_ms, took_s * 1e3)
        if self._is_rendering:
            self._batch_s.append(took_s)
        if has_ended:
            self._steps = None
        elif host_work is not None:
            self._pending = self.executor.submit(host_work)
        return False

    def _working(self, snapshot: SceneSnapshot, settings: Settings) -> Steps:
        previous = self._renderer
        before = None if previous is None else (previous.snapshot, previous.plan)
        render_plan: RenderPlan = yield lambda: plan(snapshot, settings, before)
        check_device(render_plan, self.device)
        renderer = Renderer(snapshot, render_plan, self.device, previous=previous)
        self._renderer, self.plan = renderer, render_plan
        if previous is not None:
            previous.close()
        yield None
        yield from renderer.preparing()
        # lights that are shared may be through with all batches but the last, which has to be drawn
        self._is_rendering = True
        first = min((work.batches_done for work in renderer.works), default=0)
        for batch in range(min(first, render_plan.batch_count - 1), render_plan.batch_count):
            self._is_between_batches = False
            yield from renderer.rendering(batch)
            yield None
            self._batches_done, self._is_between_batches = batch + 1, True
            self._batch_s, self._batch_before_s = [], self._batch_s
            self.standing = Standing(
                views_done=renderer.views_done(batch + 1),
                views_total=renderer.views_total,
                error_estimate=renderer.update_errors(),
                busy_ms=self.standing.busy_ms,
            )
            yield None

    @property
    def _is_drawn(self) -> bool:
        return self._drawn == (self.choice, self._batches_done)

    def _draw(self) -> bool:
        self._drawn = self.choice, self._batches_done
        if self._renderer is None or self.snapshot is None or not self._batches_done:
            return False
        self.device.run(self._draw_picture, self._renderer, self.snapshot)
        return True

    def _draw_picture(self, renderer: Renderer, snapshot: SceneSnapshot) -> None:
        size = snapshot.width_px, snapshot.height_px
        if self.picture is not None and self.picture.size != size:
            self._release_picture()
        if self.picture is None:
            self.picture = Picture(self.device, *size)
        if self.picture.draw(renderer, self.choice):
            self.picture_of = snapshot
        else:
            self._release_picture()

    def copy_picture(self) -> Picture | None:
        """One of the caller's with what is in `picture`, once that is done."""
        if self.picture is None or self._renderer is None or not self.is_done:
            return None
        copy = Picture(self.device, *self.picture.size)
        self.device.run(copy.draw, self._renderer, self.choice)
        return copy

    def _release_picture(self) -> None:
        if self.picture is not None:
            self.picture.release()
        self.picture = self.picture_of = None

    def _stop(self) -> None:
        if self._steps is not None:
            self.device.run(self._steps.close)
        if self._pending is not None:
            # what has not begun would hold up what is wanted now
            self._pending.cancel()
        self._steps = self._pending = self._answer = None

    def close(self) -> None:
        """Free what the device holds."""
        self._stop()
        self._release_picture()
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None
