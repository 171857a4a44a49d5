"""Presets of how passes are made: those of the folder `presets/`, and those that users add."""

from __future__ import annotations

import ast
import functools
import math
from pathlib import Path
from typing import Any

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..resources import preset_folder

SUBFOLDER = "vir"
PRESET_PROPERTIES = (
    "view_count", "map_resolution_px", "method", "points", "point_generation", "resolve", "stochastic_culling", "culling_area_texels",
    "cull_hidden", "watertight", "small_triangle_points", "back_faces", "views_per_thread", "blocker_sample_count", "filter_sample_count",
    "bounces", "reflection_method", "planar", "points_per_eye_pixel", "reflection_look_up",
)  # fmt: skip
"""Of `properties.VIR_SceneSettings`. Not what depends on the scene or on the machine: switches of effects, the device, memory."""


class VIR_PT_presets(PresetPanel, bpy.types.Panel):
    """How well and how passes are made"""

    bl_label = "Presets"
    preset_subdir = SUBFOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "vir.preset_add"


class VIR_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Keep the current settings as a preset of your own, or remove one"""

    bl_idname = "vir.preset_add"
    bl_label = "Add VIR Preset"
    preset_menu = "VIR_PT_presets"
    preset_subdir = SUBFOLDER
    preset_defines = ["vir = bpy.context.scene.vir"]
    preset_values = [f"vir.{name}" for name in PRESET_PROPERTIES]


CLASSES = (VIR_PT_presets, VIR_OT_preset_add)


def search_path() -> str:
    """The folder that Blender looks into for a folder `presets`."""
    return str(Path(preset_folder()).parent)


def matching_preset(settings: Any) -> str:
    """The name of the preset that the scene's settings agree with; empty: none. What Blender chose last may have been changed since."""
    for folder in bpy.utils.preset_paths(SUBFOLDER):
        for path in sorted(Path(folder).glob("*.py")):
            values = _preset_values(path, path.stat().st_mtime_ns)
            if values and all(_is_same(getattr(settings, name, None), value) for name, value in values.items()):
                return str(bpy.path.display_name(path.name, title_case=False))
    return ""


@functools.lru_cache(maxsize=64)
def _preset_values(path: Path, _: int) -> dict[str, Any]:
    """By property; empty if it is not one of ours. Looked at again when its time has changed."""
    try:
        lines: list[Any] = ast.parse(path.read_text(encoding="utf-8")).body
        return {line.targets[0].attr: ast.literal_eval(line.value) for line in lines if _is_of_settings(line)}
    except (OSError, SyntaxError, ValueError):
        return {}


def _is_of_settings(line: Any) -> bool:
    return isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Attribute) and line.targets[0].attr in PRESET_PROPERTIES


def _is_same(one: Any, other: Any) -> bool:
    """Blender keeps single precision."""
    return math.isclose(one, other, rel_tol=1e-6) if isinstance(one, float) and isinstance(other, float | int) else bool(one == other)
