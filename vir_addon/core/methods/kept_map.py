"""The map of a light without size: every batch would show the same view, so it is made once, whatever the method, and kept.

What its method needs for making it is let go of as soon as the map is there.
"""

from __future__ import annotations

from ..passes.shadow_maps import BYTES_PER_TEXEL, DepthMaps
from .base import DepthMapMethod, FaceJob, ReplayMethod


class KeptMap(ReplayMethod):
    def __init__(self, job: FaceJob, maker: DepthMapMethod) -> None:
        """maker: for the same face; no cut-outs may cast, because each batch has other thresholds of theirs"""
        super().__init__(job)
        self._maker = maker

    @property
    def held_bytes(self) -> int:
        return BYTES_PER_TEXEL * self.fitted.views.map_width_px * self.fitted.views.map_height_px

    def _make(self) -> None:
        self.kept_maps = DepthMaps(self.device, self.fitted.views.map_width_px, self.fitted.views.map_height_px, 1)
        self._is_held = True
        try:
            self._maker.prepare()
            self._maker.fill(self.kept_maps, range(1))
            self.portion_count = self._maker.portion_count
        finally:
            self._maker.release()
        self.kept_maps.release_target()

    def _free(self) -> None:
        if self.kept_maps is not None:
            self.kept_maps.release()
        self.kept_maps = None

    def _fill(self, maps: DepthMaps, selected: range) -> None:
        self._hold()

    def counts(self) -> dict[str, int]:
        return self._maker.counts()
