"""The panels: the same in the 3D viewport's sidebar ("VIR") and in the render properties."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from ..core.errors import UsageError
from ..core.settings import Method
from . import frame_state
from .frame_hook import reasons_against_frames
from .frame_state import SceneState, decision_text, made_text, state_of
from .job import SURFACE_TYPES
from .object_names import named_object
from .operators import mendable_by, reason_against_rendering
from .presets import VIR_PT_presets, matching_preset
from .properties import is_newer, reflector_mark, settings_of

LIGHT_ICONS = {"AREA": "LIGHT_AREA", "SUN": "LIGHT_SUN", "POINT": "LIGHT_POINT", "SPOT": "LIGHT_SPOT"}
LETTER_WIDTH_PX = 6.5
"""of Blender's interface font at scale 1, on average"""
FEWEST_LETTERS = 24
NAME_SHARE = 0.38
"""of a light's row, at least"""
ICON_LETTERS = 4
"""that would fit in an icon's place"""
LIST_MARGIN_PX = 90.0
"""beside that and what was decided, at scale 1: tabs, borders, the box to tick"""
REFLECTOR_SHARE = 0.3
"""of a reflector's row, for its name"""
MARK_LETTERS, MOST_MARK_SHARE = 13, 0.6
"""that "Automatic" and the arrow beside it take, and their share of the rest of the row at most"""
METHOD_PROPERTIES = {
    "HYBRID": ("small_triangle_points",),
    "VWSS": ("back_faces", "views_per_thread"),
    "PCSS": ("blocker_sample_count", "filter_sample_count"),
}
"""shown for one method only"""
POINT_METHODS = tuple(method.value.upper() for method in Method if method.may_be_bufferless)
CULLING_METHODS = tuple(method.value.upper() for method in Method if method.may_cull_at_random)


class VIR_UL_lights(bpy.types.UIList):
    """Every light with what the plan decided"""

    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, icon: int, active_data: Any, active_property: str, index: int = 0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item.data.vir, "use_pass", text="")
        letters = _letters_across(context, LIST_MARGIN_PX)
        state = state_of(context.scene)
        decision = decision_text(state, state.name_of(item), int(letters * (1.0 - NAME_SHARE)))
        split = row.split(factor=name_share(item.name, decision, letters), align=True)
        split.label(text=item.name, translate=False, icon=LIGHT_ICONS.get(item.data.type, "LIGHT"))
        text = split.row()
        text.active = item.data.vir.use_pass
        text.label(text=decision, translate=False)

    def filter_items(self, context: Any, data: Any, property_name: str) -> tuple[list[int], list[int]]:
        objects = getattr(data, property_name)
        wanted = self.filter_name.casefold()
        shown = [self.bitflag_filter_item if item.type == "LIGHT" and wanted in item.name.casefold() else 0 for item in objects]
        return shown, bpy.types.UI_UL_list.sort_items_by_name(objects, "name")


def name_share(name: str, decision: str, letter_count: float) -> float:
    """Of a row that so many letters fit into: what a long name needs, as far as what was decided leaves room for it."""
    wanted = (len(name) + ICON_LETTERS) / letter_count
    return max(NAME_SHARE, min(wanted, 1.0 - (len(decision) + 1) / letter_count))


class VIR_UL_reflectors(bpy.types.UIList):
    """Every reflector with what the plan decided, and every object that is marked"""

    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, icon: int, active_data: Any, active_property: str, index: int = 0
    ) -> None:
        letters = _letters_across(context, LIST_MARGIN_PX)
        split = layout.split(factor=REFLECTOR_SHARE, align=True)
        split.label(text=item.name, translate=False, icon="OBJECT_DATA")
        mark_share = min(MARK_LETTERS / (letters * (1.0 - REFLECTOR_SHARE)), MOST_MARK_SHARE)
        row = split.split(factor=mark_share, align=True)
        row.prop(item.vir, "reflector", text="")
        state = state_of(context.scene)
        runs, how = state.reflectors.get(state.name_of(item), (False, "not a reflector" if state.plans else "not planned yet"))
        text = row.row()
        text.active = runs
        # all of it stands below the list once the row is clicked
        fits = len(how) <= letters * (1.0 - REFLECTOR_SHARE) * (1.0 - mark_share)
        text.label(text=how if fits else how.partition(":")[0], translate=False)

    def filter_items(self, context: Any, data: Any, property_name: str) -> tuple[list[int], list[int]]:
        objects = getattr(data, property_name)
        names, wanted = reflector_names(context.scene), self.filter_name.casefold()
        shown = [self.bitflag_filter_item if item.name in names and wanted in item.name.casefold() else 0 for item in objects]
        return shown, bpy.types.UI_UL_list.sort_items_by_name(objects, "name")


def reflector_names(scene: bpy.types.Scene) -> set[str]:
    """Of the scene's objects that have a row in the list of reflectors."""
    state = state_of(scene)
    return {item.name for item in scene.objects if reflector_mark(item) >= 0 or state.name_of(item) in state.reflectors}


class _InSidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "VIR"


class _InRenderProperties:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}


class _Passes:
    bl_label = "VIR Passes"

    def draw(self: Any, context: Any) -> None:
        scene, layout = context.scene, self.layout
        state = state_of(scene)
        VIR_PT_presets.draw_menu(layout, text=matching_preset(scene.vir) or "Presets")
        column = layout.column(align=True)
        column.prop(scene.vir, "quality", slider=True)
        column.label(text=frame_state.forecast_text(scene), icon="TIME")
        _draw_buttons(layout, context, state)
        for problem in _problems(scene, state):
            _draw_text(layout.box(), context, problem, "ERROR")
        column = layout.column(heading="Effects")
        column.prop(scene.vir, "use_soft_shadows")
        column.prop(scene.vir, "use_omni_shadows")
        column.prop(scene.vir, "use_reflections")


def _draw_buttons(layout: Any, context: Any, state: SceneState) -> None:
    column = layout.column(align=True)
    if state.running is not None:
        how_far = state.running.state
        left = "" if how_far.seconds_left is None else f", {frame_state.seconds_text(how_far.seconds_left)} left"
        column.progress(factor=how_far.share_done, text=f"{how_far.share_done:.0%}{left}")
        column.operator("vir.cancel", icon="CANCEL")
    else:
        row = column.row(align=True)
        row.scale_y = 1.4
        row.operator("vir.render", icon="RENDER_STILL")
        row.operator("vir.plan", text="", icon="FILE_REFRESH")
        if (reason := reason_against_rendering(context)) is not None:
            _draw_text(column, context, reason, "INFO")
    column.operator("vir.add_to_compositor", icon="NODE_COMPOSITING")
    column.operator("vir.open_report", icon="TEXT")


def _problems(scene: Any, state: SceneState) -> list[str]:
    stands = state.problem and (state.problem_while is None or state.problem_while == mendable_by(scene))
    problems = [state.problem] if stands else []
    try:
        settings_of(scene)
    except UsageError as error:
        problems.append(str(error))
    if is_newer(scene.vir):
        problems.append("These settings were saved by a newer version of VIR and may be misread. Update the extension.")
    return list(dict.fromkeys(problems))


class _Lights:
    bl_label = "Lights"

    def draw(self: Any, context: Any) -> None:
        scene, layout = context.scene, self.layout
        state = state_of(scene)
        layout.template_list("VIR_UL_lights", "", scene, "objects", scene.vir, "active_light_index", rows=4)
        _draw_light(layout, context, state)
        known = {state.name_of(item) for item in scene.objects}
        inside = sorted({name for lines in state.plans.values() for name in lines} - known)
        for name in inside:  # lights of instanced collections have no row of their own
            _draw_text(layout, context, f"{name}: {decision_text(state, name)}", "OUTLINER_OB_GROUP_INSTANCE")


def _draw_light(layout: Any, context: Any, state: SceneState) -> None:
    scene = context.scene
    chosen = named_object(scene.vir, "active_light")
    if chosen is None or chosen.type != "LIGHT":
        layout.label(text="Click a light for details")
        return
    box = layout.box()
    wishes = chosen.data.vir
    box.label(text=chosen.name, translate=False, icon=LIGHT_ICONS.get(chosen.data.type, "LIGHT"))
    row = box.row()
    row.active = wishes.use_pass
    row.prop(wishes, "use_own_views")
    views = row.row()
    views.enabled = wishes.use_own_views
    views.prop(wishes, "view_count", text="")
    name = state.name_of(chosen)
    planned = state.planned(name)
    if planned is not None:
        _draw_text(box, context, planned.reason[:1].upper() + planned.reason[1:] + ".", "NONE")
    made = state.made(name)
    if made is not None:
        _draw_text(box, context, f"Made by {made.method} in frame {state.frame}: {made_text(made)}.", "NONE")


class _Reflectors:
    bl_label = "Reflectors"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(context.scene.vir.use_reflections)

    def draw(self: Any, context: Any) -> None:
        scene, layout = context.scene, self.layout
        state = state_of(scene)
        chosen = context.object
        names = reflector_names(scene)
        if names:
            layout.template_list("VIR_UL_reflectors", "", scene, "objects", scene.vir, "active_reflector_index", rows=3)
        active = named_object(scene.vir, "active_reflector")
        if active is not None and (runs_and_how := state.reflectors.get(state.name_of(active))) is not None:
            _draw_text(layout.box(), context, f"{active.name}: {runs_and_how[1]}", "CHECKMARK" if runs_and_how[0] else "X")
        if chosen is not None and chosen.name not in names and chosen.type in SURFACE_TYPES:
            layout.prop(chosen.vir, "reflector", text=chosen.name, translate=False)
        rows = {state.name_of(item) for item in scene.objects if item.name in names}
        for name, (runs, how) in state.reflectors.items():  # those of instanced collections, and many small ones together, have no row
            if name not in rows:
                _draw_text(layout, context, f"{name}: {how}", "CHECKMARK" if runs else "X")
        if not state.reflectors:
            layout.label(text="Nothing reflects" if state.plans else "Not planned yet")
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(scene.vir, "bounces")
        layout.prop(scene.vir, "reflection_method")
        if scene.vir.reflection_method in ("AUTO", "EPR"):
            layout.prop(scene.vir, "points_per_eye_pixel")
        layout.prop(scene.vir, "planar")
        layout.prop(scene.vir, "reflection_look_up")
        layout.prop(scene.vir, "per_reflector")
        layout.prop(scene.vir, "reflection_map_mib")


class _Rendering:
    bl_label = "F12 and Animation"

    def draw(self: Any, context: Any) -> None:
        scene, layout = context.scene, self.layout
        layout.prop(scene.vir, "use_on_render")
        if not scene.vir.use_on_render:
            return
        layout.prop(scene.render, "use_lock_interface", text="Lock Interface while Rendering")
        for reason in reasons_against_frames(scene):
            _draw_text(layout, context, reason, "ERROR")


class _Advanced:
    bl_label = "Method"

    def draw(self: Any, context: Any) -> None:
        group, layout = context.scene.vir, self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(group, "device")
        layout.prop(group, "method")
        column = layout.column()
        column.prop(group, "view_count")
        column.prop(group, "map_resolution_px")
        layout.prop(group, "resolve")
        for name in METHOD_PROPERTIES.get(group.method, ()):
            layout.prop(group, name)
        if group.method in POINT_METHODS:
            layout.prop(group, "points")
            layout.prop(group, "watertight")
        if group.method == "IVIR":
            layout.prop(group, "point_generation")
        if group.method in CULLING_METHODS:
            layout.prop(group, "stochastic_culling")
            row = layout.row()
            row.enabled = group.stochastic_culling
            row.prop(group, "culling_area_texels")
        layout.prop(group, "cull_hidden")
        layout.prop(group, "replay_buffer_mib")


class _Notes:
    bl_label = "Notes"

    @classmethod
    def poll(cls, context: Any) -> bool:
        state = state_of(context.scene)
        return bool(state.notes or state.left_out)

    def draw(self: Any, context: Any) -> None:
        state = state_of(context.scene)
        for note in state.notes:
            _draw_text(self.layout, context, note, "INFO")
        for text in state.left_out:
            _draw_text(self.layout, context, f"Left out: {text}", "HIDE_ON")


def _draw_text(layout: Any, context: Any, text: str, icon: str) -> None:
    """As many lines as the region's width asks for: Blender cuts labels off. Not translated: there are names in it."""
    letters = max(int(_letters_across(context)) - 8, FEWEST_LETTERS)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text, letters)):
        column.label(text=line, translate=False, icon="BLANK1" if number and icon != "NONE" else icon)


def _letters_across(context: Any, margin_px: float = 0.0) -> float:
    """That fit into the region's width, without margins at scale 1."""
    if not context.region:
        return FEWEST_LETTERS
    return float(context.region.width / context.preferences.system.ui_scale - margin_px) / LETTER_WIDTH_PX


def _make_panels() -> list[type]:
    contents = {
        "passes": _Passes,
        "lights": _Lights,
        "reflectors": _Reflectors,
        "rendering": _Rendering,
        "method": _Advanced,
        "notes": _Notes,
    }
    made: list[type] = []
    for place, base in (("view3d", _InSidebar), ("render", _InRenderProperties)):
        for name, content in contents.items():
            attributes: dict[str, Any] = {"__doc__": content.__doc__}
            if name != "passes":
                attributes["bl_parent_id"] = f"VIR_PT_{place}_passes"
            if name in ("method", "rendering", "notes"):
                attributes["bl_options"] = {"DEFAULT_CLOSED"}
            elif name in ("lights", "reflectors"):
                attributes["bl_options"] = set()
            made.append(type(f"VIR_PT_{place}_{name}", (content, base, bpy.types.Panel), attributes))
    return made


PANELS = _make_panels()
CLASSES = (VIR_UL_lights, VIR_UL_reflectors, *PANELS)
