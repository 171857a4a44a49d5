"""Finished (or so far accumulated) passes and how they were made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

COMBINED_PASS_NAME = "VIR Shadow"
REFLECTION_PASS_NAME = "VIR Reflection"
REFLECTION_COLOR_PASS_NAME = "VIR Reflection Color"

PASS_NAME_BYTES_MAX = 63
"""UTF-8 bytes that Blender keeps of a render pass's, a socket's and (4.5) an image's name; light names of 5.x may be longer"""

STAGES = (
    "extract",
    "upload",
    "eye G-buffer",
    "reflection maps",
    "reflect",
    "points",
    "splat or raster",
    "resolve",
    "light reflections",
    "read-back",
    "write",
)
"""the stages that statistics list, in the order in which they run"""


def shadow_pass_name(light_name: str) -> str:
    """'Key.001' -> 'VIR Shadow Key_001': EXR splits channel names at dots, so a pass name must not contain one."""
    return f"{COMBINED_PASS_NAME} {light_name.replace('.', '_')}"


def unique_pass_names(light_names: Iterable[str]) -> dict[str, str]:
    """Light name -> pass name, all different and none longer than PASS_NAME_BYTES_MAX.

    "Key.001" and "Key_001" would share a pass name, and so would long names that differ only at their ends: the later
    one in alphabetical order gets a number. A light whose own name survives unchanged always keeps it. Depends on the
    set of names only, not on their order; pass all lights of the scene, or a choice of lights changes their names.
    """
    names = sorted(set(light_names))
    unchanged = [name for name in names if shadow_pass_name(name) == _clip(f"{COMBINED_PASS_NAME} {name}")]
    taken = {COMBINED_PASS_NAME}
    pass_names = {}
    for light_name in [*unchanged, *(name for name in names if name not in set(unchanged))]:
        base = shadow_pass_name(light_name)
        pass_name, number = _clip(base), 2
        while pass_name in taken:
            pass_name = _clip(base, f"_{number}")
            number += 1
        taken.add(pass_name)
        pass_names[light_name] = pass_name
    return {name: pass_names[name] for name in names}


def reflector_pass_names(object_names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Object name -> names of its reflection pass and of that one's colour, all different, none longer than PASS_NAME_BYTES_MAX, whatever
    the order of the objects."""
    taken = {REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME}
    names = {}
    for object_name in sorted(set(object_names)):
        bases = [f"{name} {object_name.replace('.', '_')}" for name in (REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME)]
        pair, number = tuple(map(_clip, bases)), 2
        while taken.intersection(pair):
            pair, number = tuple(_clip(base, f"_{number}") for base in bases), number + 1
        taken.update(pair)
        names[object_name] = pair[0], pair[1]
    return names


def layer_pass_names(pass_names: Iterable[str], layer_name: str | None) -> dict[str, str]:
    """Pass name -> its name where passes of several view layers stand side by side: "VIR Shadow Key (Foreground)", within
    PASS_NAME_BYTES_MAX. `layer_name` None: unchanged, for the first layer, so that a second one changes no names."""
    if layer_name is None:
        return {name: name for name in pass_names}
    names: dict[str, str] = {}
    for name in pass_names:
        suffix, number = f" ({_clip(layer_name.replace('.', '_'), limit=20)})", 2
        candidate = _clip(name, suffix)
        while candidate in names.values():
            candidate = _clip(name, f"{suffix} {number}")
            number += 1
        names[name] = candidate
    return names


def _clip(name: str, suffix: str = "", limit: int = PASS_NAME_BYTES_MAX) -> str:
    """`name` with `suffix`, shortened before the suffix to `limit` bytes without cutting a character in two."""
    kept = name.encode()[: limit - len(suffix.encode())].decode(errors="ignore")
    return kept + suffix


@dataclass
class PassStatistics:
    """How one pass was made. Times of stages shared by all passes (extract, upload, eye G-buffer) stand in `SetStatistics`."""

    pass_name: str
    light_name: str
    method: str
    """the method's name, with 'buffered' or 'bufferless' if it has points and 'by rasterizer' if that makes them, or 'none' (no map was
    made; `reason` says why)"""
    reason: str
    view_count: int = 0
    blocker_sample_count: int = 0
    """of every look-up of the picture, one an eye sample; 0 but for pcss, and for its lights without size"""
    filter_sample_count: int = 0
    """likewise"""
    face_count: int = 0
    map_resolution_px: int = 0
    """0: no map was made"""
    point_count: int = 0
    """points generated for one replay of all views; 0 for methods without points"""
    kept_point_count: int = 0
    """points replayed after the first batch of views has found the others hidden; 0 when none were left out"""
    culled_triangle_count: int = 0
    """triangles so small that ivir, hybrid and epr culled them at random"""
    small_triangle_count: int = 0
    """triangles of a few texels that are replayed for all views; 0 but for micro"""
    kept_small_triangle_count: int = 0
    """of these, replayed after the first batch of views has found the others hidden; 0 when none were left out"""
    large_triangle_count: int = 0
    """triangles that the hardware rasterizer draws for all views; 0 but for micro and hybrid"""
    caster_triangle_count: int = 0
    portion_count: int = 1
    """more than 1: the buffer was too small for all points or triangles at once"""
    settled_share: float = 0.0
    """share of the picture's tiles that the last batch only probed: wholly lit or dark in the first ones, with all pixels around"""
    stage_ms: dict[str, float] = field(default_factory=dict)
    error_estimate: float = 0.0
    """RMS over lit pixels of the standard error of the pass; from the spread between batches, an upper estimate"""


@dataclass
class ReflectionStatistics:
    """How the reflection passes were made."""

    bounces: int = 0
    map_count: int = 0
    map_texel_count: int = 0
    """of all levels"""
    map_bytes: int = 0
    """that these take, with what is kept of every texel that is shaded"""
    look_up: str = ""
    """how rays look maps up, the name of a ReflectionLookUp"""
    splatted_map_count: int = 0
    """of these, those splatted from the cloud that all share, not drawn one by one"""
    cloud_triangle_count: int = 0
    """triangles in the cloud; others were far smaller than a sample"""
    point_count: int = 0
    """points in it, of ivir"""
    reflectors: list[str] = field(default_factory=list)
    """one sentence each: name, how it is drawn and why, or why not"""
    ray_count: int = 0
    """rays of an eye sample's first bounce"""
    found_share: float = 0.0
    """of these, those that met a surface of the map"""
    by_direction_share: float = 0.0
    """those that show what lies in their direction: their surface was hidden from the map's centre, or none are followed at all"""
    behind_share: float = 0.0
    """those that met a surface, but passed behind others: something that maps do not show may be nearer"""
    left_share: float = 0.0
    """those that left the scene and show the world"""
    shaded_count: int = 0
    """surfaces that are shaded for an eye sample: those that its rays met, all that whole shaded cubes see, or those of their texels
    that samples need"""
    rays_per_pixel: float = 0.0
    """that shows a reflector, of the first bounce; fewer than asked for where their number adapts"""
    error_estimate: float = 0.0
    """RMS over pixels of reflectors of the standard error of what reflections add to the picture, luminance"""


@dataclass
class SetStatistics:
    device: str = ""
    object_count: int = 0
    instance_count: int = 0
    unique_triangle_count: int = 0
    instanced_triangle_count: int = 0
    flat_triangle_count: int = 0
    """of the unique ones, those without area, which no picture shows"""
    left_out_object_count: int = 0
    left_out_instance_count: int = 0
    dropped_vertex_count: int = 0
    """of objects that are there"""
    dropped_triangle_count: int = 0
    eye_sample_count: int = 0
    stage_ms: dict[str, float] = field(default_factory=dict)
    """stages shared by all passes"""
    passes: list[PassStatistics] = field(default_factory=list)
    reflections: ReflectionStatistics | None = None
    left_out: list[str] = field(default_factory=list)
    """one sentence an object: what is missing from the picture, why, and how much where that is counted"""
    notes: list[str] = field(default_factory=list)


@dataclass
class PassSet:
    """Named images. Row 0 is the bottom row."""

    images: dict[str, np.ndarray]
    """pass name -> (height, width) float32, linear, 0 fully shadowed .. 1 lit; reflections (height, width, 3), linear RGB"""
    statistics: SetStatistics
