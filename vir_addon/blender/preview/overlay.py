"""Draws a picture over the viewport, within Blender's own drawing of it. The picture stays on the device all the time."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from typing import Any

import blf
import bpy
import gpu

from ...core.passes.surface_data import LUMINANCE_DEFINES
from ...core.picture import Picture
from ...device.blender_gpu_device import BlenderTexture
from ...device.shader_source import load


class Display(enum.Enum):
    """How a picture is shown."""

    MULTIPLY = 0
    """darken what is there by shadows, add the light of reflectors"""
    PASS = 1
    """cover it with the pass"""
    DIFFERENCE = 2
    """orange over what is lighter than in the reference, blue over what is darker"""


SAMPLERS = ("shadows", "reflections", "reference_shadows", "reference_reflections")


class Overlay:
    """Make it, draw with it and let go of it on Blender's main thread."""

    def __init__(self) -> None:
        info = gpu.types.GPUShaderCreateInfo()
        for slot, name in enumerate(SAMPLERS):
            info.sampler(slot, "FLOAT_2D", name)
        for name in ("viewport_size", "viewport_origin"):
            info.push_constant("VEC2", name)
        for name in ("display", "has_shadows", "has_reflections"):
            info.push_constant("INT", name)
        for name, weight in LUMINANCE_DEFINES.items():
            info.define(name, repr(weight))
        for display in Display:
            info.define(f"DISPLAY_{display.name}", str(display.value))
        info.vertex_in(0, "VEC2", "corner")
        info.fragment_out(0, "VEC4", "overlaid")
        info.vertex_source(load("overlay.vert.glsl"))
        info.fragment_source(load("overlay.frag.glsl"))
        self._shader = gpu.shader.create_from_info(info)
        vertex_format = gpu.types.GPUVertFormat()
        vertex_format.attr_add(id="corner", comp_type="F32", len=2, fetch_mode="FLOAT")
        corners = gpu.types.GPUVertBuf(vertex_format, 3)
        corners.attr_fill("corner", [(-1.0, -1.0), (3.0, -1.0), (-1.0, 3.0)])
        self._triangle = gpu.types.GPUBatch(type="TRIS", buf=corners)

    def draw(self, picture: Picture, display: Display, reference: Picture | None) -> None:
        """Over all of the current viewport. reference: an earlier picture of the same passes and view, only for a difference"""
        if display is Display.DIFFERENCE and reference is None:
            return
        compared = reference or picture
        textures = (picture.shadows, picture.reflections, compared.shadows, compared.reflections)
        left, bottom, width, height = gpu.state.viewport_get()
        state = gpu.state
        before = state.blend_get(), state.depth_test_get(), state.depth_mask_get()
        try:
            state.blend_set("ALPHA_PREMULT")
            state.depth_test_set("NONE")
            state.depth_mask_set(False)
            self._shader.bind()
            for name, texture in zip(SAMPLERS, textures, strict=True):
                assert isinstance(texture, BlenderTexture)
                self._shader.uniform_sampler(name, texture.handle)
            self._shader.uniform_float("viewport_size", (width, height))
            self._shader.uniform_float("viewport_origin", (left, bottom))
            self._shader.uniform_int("display", display.value)
            self._shader.uniform_int("has_shadows", picture.has_shadows)
            self._shader.uniform_int("has_reflections", picture.has_reflections)
            self._triangle.draw(self._shader)
        finally:
            state.blend_set(before[0])
            state.depth_test_set(before[1])
            state.depth_mask_set(before[2])


TEXT_TOP_PX = 35
"""of the line at interface scale 1, from the viewport's lower edge"""


def covered_px(viewport: Any, regions: Iterable[Any], height_px: float) -> int:
    """How far from its left edge other regions of the area lie over a viewport's lowest pixels: tools, and the panel of the last
    operator."""
    reach_px = [
        region.x + region.width - viewport.x
        for region in regions
        if region.type in ("TOOLS", "HUD")
        and region.width > 1  # otherwise it is not shown
        and region.x < viewport.x + viewport.width / 2
        and region.y < viewport.y + height_px
        and region.y + region.height > viewport.y
    ]
    return max([0, *reach_px])


def draw_text(context: bpy.types.Context, text: str) -> None:
    """A line at the lower left of the current viewport, beside what lies over it."""
    scale = context.preferences.system.ui_scale
    font = 0
    blf.size(font, 11 * scale)
    blf.enable(font, blf.SHADOW)
    blf.shadow(font, 6, 0.0, 0.0, 0.0, 1.0)  # an outline: a pass may be white
    blf.color(font, 1.0, 1.0, 1.0, 1.0)
    blf.position(font, covered_px(context.region, context.area.regions, TEXT_TOP_PX * scale) + 20 * scale, 20 * scale, 0)
    blf.draw(font, text)
    blf.disable(font, blf.SHADOW)
