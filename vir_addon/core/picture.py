"""A picture of passes that never leaves the device, for who draws it himself: the preview."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..device.interface import Device, Texture, TextureFormat
from ..device.owned import Owned
from .settings import Effect

if TYPE_CHECKING:
    from .render import Renderer


class Shown(enum.Enum):
    """Which passes a picture is of."""

    ALL = "all"
    """shadows and, where there are reflections, what they add"""
    SHADOW = "shadow"
    REFLECTION = "reflection"
    REFLECTION_COLOR = "reflection color"
    REFLECTED = "reflected"
    """what reflectors add to a picture: the former two multiplied"""

    @property
    def has_shadows(self) -> bool:
        return self in (Shown.ALL, Shown.SHADOW)

    @property
    def has_reflections(self) -> bool:
        return self is not Shown.SHADOW

    def effects_of(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Those among `effects` that have to be rendered for it; none if what it shows is not among them. Reflections take most of the
        time, and with them shadows cost little, so one may go from one of the others to the next without rendering anew."""
        if self is Shown.SHADOW:
            return tuple(effect for effect in effects if effect is Effect.SHADOW)
        return effects if self is Shown.ALL or Effect.REFLECTION in effects else ()


@dataclass(frozen=True)
class Choice:
    shown: Shown = Shown.ALL
    light_name: str | None = None
    """whose shadows; None: those of all lights together"""


class Picture:
    """Textures of the same size."""

    def __init__(self, device: Device, width_px: int, height_px: int) -> None:
        self.size = width_px, height_px
        self.has_shadows = self.has_reflections = False
        """what of it is there"""
        with Owned() as owned:
            self.shadows: Texture = owned.own(device.create_texture(width_px, height_px, TextureFormat.RGBA32F))
            """as of `COMBINE_PASSES`"""
            self.reflections: Texture = owned.own(device.create_texture(width_px, height_px, TextureFormat.RGBA32F))
            """as of `SHOW_REFLECTIONS`"""
            self._owned = owned.pop_all()

    def draw(self, renderer: Renderer, choice: Choice) -> bool:
        """Without reading anything back. False if there is nothing to show."""
        shown = choice.shown
        self.has_shadows = shown.has_shadows and renderer.draw_shadows(self.shadows, choice.light_name)
        self.has_reflections = shown.has_reflections and renderer.draw_reflections(self.reflections, shown)
        return self.has_shadows or self.has_reflections

    def release(self) -> None:
        self._owned.close()
