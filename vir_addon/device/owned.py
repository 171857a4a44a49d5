"""Who releases what: everything that makes several things on a device holds them in one of these."""

from __future__ import annotations

import contextlib
from typing import Protocol, TypeVar


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
