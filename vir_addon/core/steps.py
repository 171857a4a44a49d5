"""Work in steps: whoever has something else to do, like a user interface to keep alive, does it between them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

HostWork = Callable[[], Any]
"""needs neither the device nor its thread"""
Steps = Generator[HostWork | None, Any, None]
"""Pauses where it yields: None, or a call whose result is to be sent in, so that it may run elsewhere meanwhile."""


def run_steps(steps: Steps) -> None:
    """To the end, at once and on this thread."""
    answer = None
    try:
        while True:
            host_work = steps.send(answer)
            answer = host_work() if host_work is not None else None
    except StopIteration:
        return
