"""What the scene calls for, decided before any GPU work: one line per light with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from .scene import SceneSnapshot
from .settings import Method, PointStorage, Settings


@dataclass(frozen=True)
class PlannedPass:
    light_name: str
    pass_name: str
    runs: bool
    """False: the pass is constant (`constant_value`) and costs nothing"""
    reason: str
    """why it runs as it does, or why it does not; one clause in plain words"""
    method: Method = Method.MVR
    """never AUTO: the plan has decided"""
    points: PointStorage | None = None
    view_count: int = 0
    map_resolution_px: int = 0
    constant_value: float = 1.0
    predicted_ms: float = 0.0


@dataclass(frozen=True)
class RenderPlan:
    settings: Settings
    passes: tuple[PlannedPass, ...]
    eye_sample_count: int
    """eye G-buffers with sub-pixel offsets that batches take turns with"""
    batch_view_count: int
    """views whose maps exist at the same time"""
    notes: tuple[str, ...] = ()
    predicted_ms: float = 0.0


def plan(snapshot: SceneSnapshot, settings: Settings) -> RenderPlan:
    """Decide per light. Raises UsageError for lights that the scene does not have."""
    raise NotImplementedError
