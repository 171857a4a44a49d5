"""The report of a scene's last render, as a page in Blender's folder for temporary files."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..analysis.report_page import report_page
from ..core.errors import UsageError
from ..core.files import whole_file
from ..core.preview import file_name_part
from .frame_state import state_of
from .images import scene_images


def write_report(scene: bpy.types.Scene) -> Path:
    """Where the page was written. Raises UsageError before the first render, and where nothing can be written."""
    state = state_of(scene)
    if not state.statistics:
        raise UsageError("nothing was rendered since the file was opened; press Render Passes first")
    pictures = {name: _pixels(image) for name, image in scene_images(scene.name_full).items()}
    target = Path(bpy.app.tempdir) / f"vir_{file_name_part(scene.name)}.html"
    with whole_file(target) as temporary:
        temporary.write_text(report_page(f"VIR: {scene.name}, frame {state.frame}", state.statistics, pictures), encoding="utf-8")
    return target


def _pixels(image: bpy.types.Image) -> np.ndarray:
    """(height, width) where all three channels are alike, otherwise (height, width, 3) float32"""
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    rgb = pixels.reshape(height, width, -1)[..., :3]
    return rgb[..., 0] if (rgb == rgb[..., :1]).all() else rgb
