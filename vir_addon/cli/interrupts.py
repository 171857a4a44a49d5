"""Ctrl-C is remembered until it has had its way: Python that Blender calls (at its start, as an engine, drivers, handlers) swallows
KeyboardInterrupt, prints it before anyone can catch it, or crashes on it, and where the interpreter cleans up it is printed and dropped."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class _Asked:
    """Whether a Ctrl-C came since `remembered_interrupts` began."""

    was = False


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt if a Ctrl-C came, even if an earlier one raised for it got lost."""
    if _Asked.was:
        raise KeyboardInterrupt


def _note(number: int, frame: Any) -> None:
    _Asked.was = True


def _note_and_raise(number: int, frame: Any) -> None:
    _Asked.was = True
    raise KeyboardInterrupt


@contextmanager
def remembered_interrupts() -> Iterator[None]:
    """Around a command: a Ctrl-C raises KeyboardInterrupt at once, and once more wherever `stop_if_asked` is called.

    Does nothing where Ctrl-C is ignored, or belongs to the program that called.
    """
    _Asked.was = False
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _note_and_raise)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def held_interrupts() -> Iterator[None]:
    """A Ctrl-C in the block raises KeyboardInterrupt at its end, or where `stop_if_asked` is called.

    Does nothing where Ctrl-C is ignored, or belongs to the program that called.
    """
    before = signal.getsignal(signal.SIGINT)
    if before not in (signal.default_int_handler, _note_and_raise, _note):
        yield
        return
    if before is signal.default_int_handler:
        _Asked.was = False
    signal.signal(signal.SIGINT, _note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    stop_if_asked()
