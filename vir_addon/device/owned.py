"""Who releases what: everything that makes several things on a device holds them in one of these."""

from __future__ import annotations

import abc
import contextlib
from typing import Protocol, Self, TypeVar


class Releasable(Protocol):
    def release(self) -> None: ...


Held = TypeVar("Held", bound=Releasable)


class Owned(contextlib.ExitStack):
    """Releases what it was handed, last first, once: when closed, or at the end of its `with` block.

    A constructor makes its parts within a block and ends it with `self._owned = owned.pop_all()`: should a part fail, those
    before it are released.
    """

    def own(self, thing: Held) -> Held:
        self.callback(thing.release)
        return thing


class Shared(abc.ABC):
    """Has several holders, and goes when the last of them releases it."""

    _holder_count = 1

    def share(self) -> Self:
        """For another holder, to be released as often as held."""
        self._holder_count += 1
        return self

    def release(self) -> None:
        self._holder_count -= 1
        if self._holder_count == 0:
            self._free()

    @abc.abstractmethod
    def _free(self) -> None:
        """Release everything."""
