"""Cycles' glossy passes with direct light only: what reflection passes mean."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np
import OpenEXR


def render(scene: bpy.types.Scene, resolution: tuple[int, int], samples: int, bounces: int) -> tuple[np.ndarray, np.ndarray]:
    """What arrives along reflections and what it is multiplied by, (height, width, 3) float32 each, row 0 at the bottom. Lamps show in
    neither, as they are no surfaces, but have highlights on what reflections show."""
    direct, _, color = _render(scene, resolution, samples, bounces, has_highlights=False)
    _, indirect, _ = _render(scene, resolution, samples, bounces, has_highlights=True)
    return direct + indirect, color


def _render(
    scene: bpy.types.Scene, resolution: tuple[int, int], samples: int, bounces: int, *, has_highlights: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Glossy direct, indirect and colour."""
    for shown in scene.objects:
        shown.visible_glossy = has_highlights or shown.type != "LIGHT"
    rendered, cycles = scene.render, scene.cycles
    rendered.engine, cycles.device, cycles.samples = "CYCLES", "CPU", samples
    rendered.resolution_x, rendered.resolution_y, rendered.resolution_percentage = *resolution, 100
    if hasattr(rendered.image_settings, "media_type"):
        rendered.image_settings.media_type = "MULTI_LAYER_IMAGE"
    rendered.image_settings.file_format, rendered.image_settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    for layer in scene.view_layers:
        layer.use_pass_glossy_direct = layer.use_pass_glossy_indirect = layer.use_pass_glossy_color = True
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces = cycles.glossy_bounces = bounces
    cycles.diffuse_bounces = cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    with tempfile.TemporaryDirectory() as folder:
        rendered.filepath = str(Path(folder) / "image")
        bpy.ops.render.render(write_still=True)
        with OpenEXR.File(str(next(Path(folder).glob("image*.exr"))), separate_channels=True) as file:
            channels = {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}

    def image(*names: str) -> np.ndarray:
        found = next(name for name in (key[:-2] for key in channels if key.endswith(".R")) if name.split(".")[-1] in names)
        return np.stack([channels[f"{found}.{letter}"] for letter in "RGB"], axis=-1)[::-1].astype(np.float32)

    return image("GlossDir", "Glossy Direct"), image("GlossInd", "Glossy Indirect"), image("GlossCol", "Glossy Color")
