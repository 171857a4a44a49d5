"""Where the preview is switched on: the viewport's header, its overlays' menu, and a panel beside the others."""

from __future__ import annotations

from typing import Any

import bpy

from . import running


class VIR_OT_preview(bpy.types.Operator):
    """Show the passes over the 3D viewport, or stop showing them"""

    bl_idname = "vir.preview"
    bl_label = "Preview Passes"
    bl_options = {"UNDO"}  # a step of its own: undoing what was done before it would turn the switch as well

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if bpy.app.background:
            cls.poll_message_set("There is no viewport in background")
            return False
        if reason := running.unavailable():
            cls.poll_message_set(reason)
            return False
        return context.scene is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        wishes = context.scene.vir
        wishes.use_preview = not wishes.use_preview
        return {"FINISHED"}


class VIR_PT_preview(bpy.types.Panel):
    """What the preview shows, and how far it is"""

    bl_label = "Preview"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "VIR"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.enabled = not running.unavailable()
        self.layout.prop(context.scene.vir, "use_preview", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, wishes = self.layout, context.scene.vir
        layout.use_property_split = True
        layout.use_property_decorate = False
        if reason := running.unavailable():
            layout.label(text=reason, icon="INFO")
        column = layout.column()
        column.active, column.enabled = wishes.use_preview, not running.unavailable()
        column.prop(wishes, "preview_pass")
        row = column.row()
        row.active = wishes.preview_pass in ("ALL", "SHADOW")
        row.prop(wishes, "preview_light_now")
        column.prop(wishes, "preview_display")
        column.prop(wishes, "preview_slice_ms")
        if wishes.device == "MODERNGL":
            layout.label(text="With Blender's own graphics", icon="INFO")
        if wishes.use_preview and not context.space_data.overlay.show_overlays:
            layout.label(text="This viewport shows no overlays", icon="INFO")


def _draw_in_header(self: Any, context: bpy.types.Context) -> None:
    self.layout.operator("vir.preview", text="", icon="SHADING_TEXTURE", depress=context.scene.vir.use_preview)


def _draw_in_overlays(self: Any, context: bpy.types.Context) -> None:
    column = self.layout.column()
    column.active = context.space_data.overlay.show_overlays
    column.label(text="VIR")
    if reason := running.unavailable():
        column.label(text=reason, icon="INFO")
    row = column.row()
    row.enabled = not running.unavailable()
    row.prop(context.scene.vir, "use_preview", text="Passes")
    row.prop(context.scene.vir, "preview_pass", text="")
    row.prop(context.scene.vir, "preview_display", text="")


CLASSES = (VIR_OT_preview, VIR_PT_preview)


def register() -> None:
    bpy.types.VIEW3D_HT_header.append(_draw_in_header)
    bpy.types.VIEW3D_PT_overlay.append(_draw_in_overlays)
    running.register()


def unregister() -> None:
    running.unregister()
    bpy.types.VIEW3D_PT_overlay.remove(_draw_in_overlays)
    bpy.types.VIEW3D_HT_header.remove(_draw_in_header)
