"""Presets of how passes are made: those of the folder `presets/`, and those that users add."""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..resources import preset_folder

SUBFOLDER = "vir"
PRESET_PROPERTIES = (
    "view_count", "map_resolution_px", "method", "points", "point_generation", "resolve", "stochastic_culling", "culling_area_texels",
    "cull_hidden", "watertight", "small_triangle_points", "back_faces", "views_per_thread", "blocker_sample_count", "filter_sample_count",
    "bounces", "reflection_method", "points_per_eye_pixel", "reflection_look_up",
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
