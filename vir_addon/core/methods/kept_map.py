"""The map of a light without size: every batch would show the same view, so it is made once, whatever the method, and kept.

What its method needs for making it is let go of as soon as the map is there.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

from ..passes.shadow_maps import BYTES_PER_TEXEL, DepthMaps
from .base import DepthMapMethod, FaceJob, ReplayMethod


class KeptMap(ReplayMethod):
    def __init__(self, job: FaceJob, maker: DepthMapMethod) -> None:
        """maker: for the same face; no cut-outs may cast, because each batch has other thresholds of theirs"""
        super().__init__(job)
        self._maker = maker
        self._kept: DepthMaps | None = None

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_TEXEL * self.fitted.views.map_width_px * self.fitted.views.map_height_px

    def _making(self) -> Generator[None, None, None]:
        kept = self._kept = DepthMaps(self.device, self.fitted.views.map_width_px, self.fitted.views.map_height_px, 1)
        self._is_held = True
        try:
            yield from self._maker.preparing()
            yield
            yield from self._maker.getting_ready(range(1))
            self._maker.fill(kept, range(1))
            self.portion_count = self._maker.portion_count
        finally:
            self._maker.release()
        kept.release_target()

    def _free(self) -> None:
        if self._kept is not None:
            self._kept.release()
        self._kept = None

    def getting_ready(self, selected: range) -> Generator[None, None, None]:
        if not self.has_cut_outs:
            yield from self._holding()

    def maps_of(self, selected: range, lend: Callable[[], DepthMaps]) -> DepthMaps:
        """Its own: none are asked for."""
        self.device.run(self._hold)
        assert self._kept is not None
        return self._kept

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        self._maker.fill(maps, range(1))

    def counts(self) -> dict[str, int]:
        return self._maker.counts()
