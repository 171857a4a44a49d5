"""How large a run is: the full sizes, which are what figures are quoted from, or `--quick`, which only shows that it works."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Size = TypeVar("Size")


@dataclass(frozen=True)
class Options:
    output: Path
    device_name: str
    is_quick: bool = False
    rounds: int | None = None
    """None: as many as the bench thinks fit"""
    model: Path | None = None
    """a file to measure with instead of the scene that a script makes"""

    def pick(self, full: Size, quick: Size) -> Size:
        """The size for this run."""
        return quick if self.is_quick else full

    def round_count(self, full: int = 5, quick: int = 2) -> int:
        return self.rounds or self.pick(full, quick)
