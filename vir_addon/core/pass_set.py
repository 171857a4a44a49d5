"""Finished (or so far accumulated) passes and how they were made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

COMBINED_PASS_NAME = "VIR Shadow"

STAGES = ("extract", "upload", "eye G-buffer", "points", "splat or raster", "resolve", "read-back", "write")
"""the stages that statistics list, in the order in which they run"""


def shadow_pass_name(light_name: str) -> str:
    """'Key.001' -> 'VIR Shadow Key_001': EXR splits channel names at dots, so a pass name must not contain one."""
    return f"{COMBINED_PASS_NAME} {light_name.replace('.', '_')}"


@dataclass
class PassStatistics:
    """How one pass was made. Times of stages shared by all passes (extract, upload, eye G-buffer) stand in `SetStatistics`."""

    pass_name: str
    light_name: str
    method: str
    """'mvr', 'ivir buffered', 'ivir bufferless' or 'none' (nothing to do; `reason` says why)"""
    reason: str
    view_count: int = 0
    face_count: int = 0
    map_resolution_px: int = 0
    point_count: int = 0
    """points generated for one replay of all views; 0 for mvr"""
    caster_triangle_count: int = 0
    portion_count: int = 1
    """more than 1: the point buffer was too small for all points at once"""
    stage_ms: dict[str, float] = field(default_factory=dict)
    error_estimate: float = 0.0
    """RMS over lit pixels of the standard error of the pass; from the spread between batches, an upper estimate"""


@dataclass
class SetStatistics:
    device: str = ""
    object_count: int = 0
    instance_count: int = 0
    unique_triangle_count: int = 0
    instanced_triangle_count: int = 0
    eye_sample_count: int = 0
    stage_ms: dict[str, float] = field(default_factory=dict)
    """stages shared by all passes"""
    passes: list[PassStatistics] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """one sentence an object: what is missing from the picture and why"""
    notes: list[str] = field(default_factory=list)


@dataclass
class PassSet:
    """Named images. Row 0 is the bottom row."""

    images: dict[str, np.ndarray]
    """pass name -> (height, width) float32, linear, 0 fully shadowed .. 1 lit"""
    statistics: SetStatistics
