"""Cycles on the same scene, set so that it computes what a pass means: direct light on white diffuse surfaces, no bounces."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
from scipy import ndimage

DELIVERED_FLOOR = 0.01
"""Pixels that receive less than this share of what the brightest twentieth receives are not judged: their ratio is mostly noise."""


def prepare(scene: bpy.types.Scene, resolution: tuple[int, int]) -> None:
    """White diffuse everywhere, no world, no bounces, no denoising, no adaptive sampling; the scene's own pixel filter."""
    white = bpy.data.materials.new("white")
    if bpy.app.version < (5, 0):  # later ones always have nodes, and warn
        white.use_nodes = True
    nodes = white.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    white.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
    for layer in scene.view_layers:
        layer.material_override = white
    scene.world = None
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y = resolution
    render.resolution_percentage = 100
    render.film_transparent = True
    render.image_settings.file_format, render.image_settings.color_depth, render.image_settings.color_mode = "OPEN_EXR", "32", "RGB"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0


def render_pair(scene: bpy.types.Scene, light: bpy.types.Object, samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture, the same without the light's shadows, and the seconds of each, waited and of processors.

    The second one finds what Cycles made of the scene for the first: only the light is another.
    """
    pictures, taken = [], []
    own, scene.render.use_persistent_data = light.data.use_shadow, True
    try:
        for has_shadows in (True, False):
            light.data.use_shadow = own and has_shadows
            image, *seconds = render(scene, samples, seed)
            pictures.append(image)
            taken.append(seconds)
    finally:
        light.data.use_shadow = own
        scene.render.use_persistent_data = False  # and lets go of it
    return *pictures, np.array(taken)


def render(scene: bpy.types.Scene, samples: int, seed: int = 0, *, has_shadows: bool = True) -> tuple[np.ndarray, float, float]:
    """(height, width) float32 irradiance, row 0 at the bottom; the seconds that the render took, writing its file included and reading it
    not, waited and of all processors."""
    scene.cycles.samples, scene.cycles.seed = samples, seed
    casts = {shown: shown.visible_shadow for shown in scene.objects}
    try:
        for shown, own in casts.items():
            shown.visible_shadow = own and has_shadows
        with tempfile.TemporaryDirectory() as folder:
            scene.render.filepath = str(Path(folder) / "image")
            start_s, start_cpu_s = time.perf_counter(), time.process_time()
            bpy.ops.render.render(write_still=True)
            taken_s, taken_cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
            with OpenEXR.File(str(next(Path(folder).glob("image*.exr")))) as file:
                pixels = next(iter(file.channels().values())).pixels
    finally:
        for shown, own in casts.items():
            shown.visible_shadow = own
    red = pixels[..., 0] if pixels.ndim == 3 else pixels
    return red[::-1].astype(np.float32), taken_s, taken_cpu_s


class CyclesReference:
    """Shadowed over unshadowed irradiance of the scene's one light, and where it can be judged. Row 0 at the bottom."""

    def __init__(self, scene: bpy.types.Scene, samples: int) -> None:
        """Half of the samples each with another seed: what the halves differ by tells the noise.

        The unshadowed picture takes the same samples as the shadowed one. With others an outline's pixel would divide what one picture
        happens to see of a bright surface by what the other happens to see of it.
        """
        halves = [[render(scene, samples // 2, seed, has_shadows=has_shadows)[0] for has_shadows in (True, False)] for seed in (2, 3)]
        shadowed, self.unshadowed = np.mean(halves, axis=0)
        self.judged = self.unshadowed > DELIVERED_FLOOR * np.percentile(self.unshadowed[self.unshadowed > 0], 95)
        self.ratio = self.ratio_of(shadowed, self.unshadowed)
        first, second = (self.ratio_of(*half) for half in halves)
        self.noise = _rms((first - second)[self.judged].astype(np.float64)) / 2
        """RMS of the ratio's standard error over judged pixels"""
        # where brightly and dimly lit surfaces share a pixel, what counts is how finely the eye samples it, whatever the light
        even = ndimage.minimum_filter(self.unshadowed, 3) > 0.5 * ndimage.maximum_filter(self.unshadowed, 3)
        self.off_outlines = self.judged & even
        self.penumbra = self.judged & (self.ratio > 0.02) & (self.ratio < 0.98)

    def ratio_of(self, shadowed: np.ndarray, unshadowed: np.ndarray | None = None) -> np.ndarray:
        """unshadowed: None for the reference's own, nearly without noise"""
        if unshadowed is None:
            unshadowed = self.unshadowed
        return np.where(self.judged, np.clip(shadowed / np.maximum(unshadowed, 1e-12), 0, 1), 1)

    def errors(self, image: np.ndarray) -> dict[str, float]:
        """RMSE over the judged pixels, over those off outlines of things and over those in a penumbra; and over the judged pixels each
        counting as much as it receives, which is what is seen of the error once the pass is multiplied with a picture."""
        error = image.astype(np.float64) - self.ratio
        regions = {"rmse": self.judged, "rmse_off_outlines": self.off_outlines, "rmse_penumbra": self.penumbra}
        received = np.minimum(self.unshadowed / np.percentile(self.unshadowed[self.judged], 95), 1)
        return {name: _rms(error[region]) for name, region in regions.items()} | {"rmse_received": _rms((error * received)[self.judged])}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else 0.0
