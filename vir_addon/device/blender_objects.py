"""Objects of Blender's gpu module, freed on the thread whose context they are of, whichever thread drops them.

They are freed with their last reference. What an error on the device leaves behind is held in a circle by its traceback, and
Python's collector breaks circles on whatever thread asks for memory next: on a render's, where no context is current, or on that of
the device moderngl, where another is. Blender hands textures and framebuffers back to their context from there; shaders it deletes
at once, by a number that may be another shader's.
"""

from __future__ import annotations

import abc
import contextlib
import threading
from collections import deque
from collections.abc import Iterable
from typing import Any, Self

_put_by: deque[tuple[int, list[Any]]] = deque()
"""thread to free them on, objects"""


class ObjectHolder(abc.ABC):
    """Made on the thread whose context its objects are of."""

    _thread_id: int

    def __new__(cls, *_: Any, **__: Any) -> Self:
        holder = super().__new__(cls)
        holder._thread_id = threading.get_ident()
        return holder

    @abc.abstractmethod
    def held_objects(self) -> Iterable[Any]:
        """Of Blender, those that are there: the constructor may have failed on the way."""

    def __del__(self) -> None:
        if threading.get_ident() != self._thread_id:
            _put_by.append((self._thread_id, list(self.held_objects())))


def free_put_by() -> None:
    """What other threads left of this one's."""
    thread_id, others = threading.get_ident(), []
    with contextlib.suppress(IndexError):
        while True:
            owner, objects = _put_by.popleft()
            if owner != thread_id:
                others.append((owner, objects))
            del objects
    _put_by.extend(others)
