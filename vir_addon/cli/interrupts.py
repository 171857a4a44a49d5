"""Ctrl-C while Blender is at work: scripts that Blender runs (at its start, drivers, handlers) swallow KeyboardInterrupt or crash on it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def kept_interrupts(*, held_back: bool = False) -> Iterator[None]:
    """A Ctrl-C in the block that did not get through raises KeyboardInterrupt at its end. Held back: none gets through before.

    Does nothing where Ctrl-C is ignored, or belongs to the program that called.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    was_asked = False

    def note(number: int, frame: Any) -> None:
        nonlocal was_asked
        was_asked = True
        if not held_back:
            signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if was_asked:
        raise KeyboardInterrupt
