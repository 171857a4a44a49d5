"""How large a run is: the full sizes, which are what figures are quoted from, or `--quick`, which only shows that it works."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Options:
    output: Path
    device_name: str
    is_quick: bool
    rounds: int
    cycles_rounds: int

    def pick(self, full, quick):
        """The size for this run."""
        return quick if self.is_quick else full
