"""Ctrl-C while Blender is at work: Python that Blender calls (at its start, as an engine, drivers, handlers) swallows KeyboardInterrupt,
prints it before anyone can catch it, or crashes on it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def held_interrupts() -> Iterator[Callable[[], None]]:
    """A Ctrl-C in the block raises KeyboardInterrupt at its end, or where the function that this yields is called.

    Does nothing where Ctrl-C is ignored, or belongs to the program that called.
    """
    was_asked = False

    def stop_if_asked() -> None:
        if was_asked:
            raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stop_if_asked
        return

    def note(number: int, frame: Any) -> None:
        nonlocal was_asked
        was_asked = True

    signal.signal(signal.SIGINT, note)
    try:
        yield stop_if_asked
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    stop_if_asked()
