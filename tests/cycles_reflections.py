"""Cycles' glossy passes with direct light only: what reflection passes mean; and EEVEE's of the same."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
import OpenEXR

from .eevee import choose_eevee


class Glossy(NamedTuple):
    """(height, width, 3) float32 each, row 0 at the bottom"""

    direct: np.ndarray
    indirect: np.ndarray
    color: np.ndarray


def render(scene: bpy.types.Scene, resolution: tuple[int, int], samples: int, bounces: int) -> tuple[np.ndarray, np.ndarray]:
    """What arrives along reflections and what it is multiplied by, as of `Glossy`. Lamps show in neither, as they are no surfaces, but have
    highlights on what reflections show."""
    color, reflections = render_bounces(scene, resolution, samples, (bounces,))
    return reflections[bounces], color


def render_bounces(
    scene: bpy.types.Scene, resolution: tuple[int, int], samples: int, bounces: Sequence[int], seed: int = 0
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """What reflections are multiplied by, and for every number of bounces what arrives along them; as of `render`."""
    rendered, cycles = scene.render, scene.cycles
    rendered.engine, cycles.device, cycles.samples, cycles.seed = "CYCLES", "CPU", samples, seed
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.diffuse_bounces = cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0

    def passes(bounce_count: int, *, has_highlights: bool) -> Glossy:
        cycles.max_bounces = cycles.glossy_bounces = bounce_count
        for shown in scene.objects:
            shown.visible_glossy = has_highlights or shown.type != "LIGHT"
        return _render(scene, resolution)

    direct, _, color = passes(1, has_highlights=False)
    return color, {count: direct + passes(count, has_highlights=True).indirect for count in bounces}


def render_eevee(scene: bpy.types.Scene, resolution: tuple[int, int], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """The same by EEVEE's rays in the picture, one for every pixel and sample, denoised as usual. RuntimeError where there is no EEVEE.

    Its one pass has highlights of lamps on the reflectors themselves. They are what it has without rays more than without lamps' gloss.
    """
    choose_eevee(scene)
    scene.eevee.taa_render_samples = samples
    scene.eevee.use_raytracing, scene.eevee.use_fast_gi = True, False
    scene.eevee.ray_tracing_method, scene.eevee.ray_tracing_options.resolution_scale = "SCREEN", "1"
    reflected = _render(scene, resolution)
    scene.eevee.use_raytracing = False
    highlights = _render(scene, resolution).direct
    with _without_gloss(scene):
        highlights = highlights - _render(scene, resolution).direct
    return np.maximum(reflected.direct + reflected.indirect - highlights, 0.0), reflected.color


@contextmanager
def _without_gloss(scene: bpy.types.Scene) -> Iterator[None]:
    factors = {shown.data: shown.data.specular_factor for shown in scene.objects if shown.type == "LIGHT"}
    for lamp in factors:
        lamp.specular_factor = 0.0
    try:
        yield
    finally:
        for lamp, factor in factors.items():
            lamp.specular_factor = factor


def _render(scene: bpy.types.Scene, resolution: tuple[int, int]) -> Glossy:
    """With the scene's engine; what it has no pass for is 0."""
    rendered = scene.render
    rendered.resolution_x, rendered.resolution_y, rendered.resolution_percentage = *resolution, 100
    if hasattr(rendered.image_settings, "media_type"):
        rendered.image_settings.media_type = "MULTI_LAYER_IMAGE"
    rendered.image_settings.file_format, rendered.image_settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    for layer in scene.view_layers:
        layer.use_pass_glossy_direct = layer.use_pass_glossy_indirect = layer.use_pass_glossy_color = True
    with tempfile.TemporaryDirectory() as folder:
        rendered.filepath = str(Path(folder) / "image")
        bpy.ops.render.render(write_still=True)
        with OpenEXR.File(str(next(Path(folder).glob("image*.exr"))), separate_channels=True) as file:
            channels = {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}

    def image(*names: str) -> np.ndarray:
        found = [name for name in (key[:-2] for key in channels if key.endswith(".R")) if name.split(".")[-1] in names]
        if not found:
            return np.zeros((resolution[1], resolution[0], 3), np.float32)
        return np.stack([channels[f"{found[0]}.{letter}"] for letter in "RGB"], axis=-1)[::-1].astype(np.float32)

    return Glossy(image("GlossDir", "Glossy Direct"), image("GlossInd", "Glossy Indirect"), image("GlossCol", "Glossy Color"))
