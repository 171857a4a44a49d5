"""What is being done to a frame: one line that changes on a terminal, a line for each large step in a file or a farm's log."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from ..core.render import Progress
from .interrupts import stop_if_asked
from .report import error_text, milliseconds

STAGE_TEXTS = {
    "upload": "uploading the scene",
    "eye G-buffer": "finding what the camera sees",
    "read-back": "finding what the camera sees",
    "fit": "choosing what reflectors see",
    "reflection maps": "drawing what reflectors see",
    "reflect": "following reflections",
    "light reflections": "lighting reflections",
    "points": "preparing",
    "splat or raster": "making maps",
    "resolve": "looking up",
}
"""stages of `render` -> what is shown before the first batch is done; a light's name follows where there is one"""

LOG_INTERVAL_S = 30.0
"""between lines about batches in a file or log, so that whoever watches a farm sees that long frames go on"""


class ShownProgress:
    """Use it as a context manager around reading a frame, or rendering one view layer of it."""

    def __init__(self, console: Console, title: str) -> None:
        self.console, self.title = console, title
        self._start_s = time.perf_counter()
        self._logged_s = self._start_s
        self._latest: Progress | None = None
        self._predicted = ""
        # no markup: users name their lights as they like
        title_column, status_column = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[status]},"))
        columns = (title_column, BarColumn(), status_column, TimeElapsedColumn())
        self._bar = Bar(*columns, console=console, disable=not console.is_terminal)
        self._task = self._bar.add_task(title, total=None, status="starting")

    def __enter__(self) -> ShownProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None or self._latest is None:
            # nothing is finished that a full bar could stand for
            self._bar.remove_task(self._task)
        self._bar.stop()
        if kind is None and self._latest is not None:
            self._log(f"{self._views_text(self._latest)}, {time.perf_counter() - self._start_s:.1f} s")

    def large_step(self, text: str) -> None:
        """Something that takes a while begins."""
        self._bar.update(self._task, status=text)
        self._log(text)

    def preparing(self, light_count: int, predicted_ms: float) -> None:
        """A render begins. Until its first batch is done, only the plan can tell how long it will take."""
        self._predicted = f", about {milliseconds(predicted_ms)} in all"
        self.large_step(f"preparing {light_count} light{'s' * (light_count != 1)}{self._predicted}")

    def stage(self, name: str, light_name: str | None) -> None:
        """A stage of the render begins; may be called from any thread. A Ctrl-C raises KeyboardInterrupt there, and ends the work."""
        stop_if_asked()
        if self._latest is None:
            self._bar.update(self._task, status=" ".join(filter(None, (STAGE_TEXTS[name], light_name))) + self._predicted)

    def batch(self, progress: Progress) -> None:
        stop_if_asked()
        self._latest = progress
        # a bar of nothing to do is full
        views = (max(progress.views_total, 1), progress.views_done if progress.views_total else 1)
        status = f"{self._views_text(progress)}, {progress.seconds_left:.0f} s left"
        self._bar.update(self._task, total=views[0], completed=views[1], status=status)
        if time.perf_counter() - self._logged_s >= LOG_INTERVAL_S and progress.batches_done < progress.batches_total:
            self._log(status)

    @staticmethod
    def _views_text(progress: Progress) -> str:
        return f"{progress.views_done}/{progress.views_total} views, error {error_text(progress.error_estimate)}"

    def _log(self, text: str) -> None:
        self._logged_s = time.perf_counter()
        if not self.console.is_terminal:
            self.console.print(f"{self.title}: {text}", highlight=False, markup=False, soft_wrap=True)
