"""Shadow passes against Cycles in the same Blender: every material white diffuse, one light, no bounces, shadowed over unshadowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from tests.scenes import rmse
from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")

WEIGHT_FLOOR = 0.01
"""pixels that receive less than this share of the brightest twentieth are not judged: the ratio's own noise would be"""


@dataclass(frozen=True)
class Reference:
    """Row 0 at the bottom."""

    ratio: np.ndarray
    lit: np.ndarray
    """(height, width) bool"""
    off_outlines: np.ndarray
    """(height, width) bool: the unshadowed picture changes by less than half to all neighbours. On outlines of things, where brightly and
    dimly lit surfaces share a pixel, what counts is how finely the eye samples it, whatever the light"""
    noise: float
    """RMS of the ratio's standard error over lit pixels"""

    @property
    def penumbra(self) -> np.ndarray:
        return self.lit & (self.ratio > 0.02) & (self.ratio < 0.98)


def cycles_image(scene, samples: int, seed: int, folder) -> np.ndarray:
    scene.cycles.samples, scene.cycles.seed = samples, seed
    scene.render.filepath = str(folder / f"image_{seed}_{samples}_")
    bpy.ops.render.render(write_still=True)
    (path,) = folder.glob(f"image_{seed}_{samples}_*")
    with OpenEXR.File(str(path)) as file:
        pixels = next(iter(file.parts[0].channels.values())).pixels.astype(np.float64)
    path.unlink()
    return (pixels[..., 0] if pixels.ndim == 3 else pixels)[::-1]


def cycles_reference(scene, samples: int, folder) -> Reference:
    """Two halves with different seeds tell the noise."""
    white = bpy.data.materials.new("white")
    nodes = white.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    white.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
    for layer in scene.view_layers:
        layer.material_override = white
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.film_transparent = True
    render.image_settings.file_format, render.image_settings.color_depth, render.image_settings.color_mode = "OPEN_EXR", "32", "RGB"
    scene.view_settings.view_transform = "Raw"
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    casts = {thing: thing.visible_shadow for thing in scene.objects}
    for thing in casts:
        thing.visible_shadow = False
    unshadowed = cycles_image(scene, max(64, samples // 4), 1, folder)
    for thing, own in casts.items():
        thing.visible_shadow = own
    lit = unshadowed > WEIGHT_FLOOR * np.percentile(unshadowed[unshadowed > 0], 95)
    halves = [
        np.clip(np.divide(cycles_image(scene, samples // 2, seed, folder), unshadowed, where=lit, out=np.ones_like(unshadowed)), 0, 1)
        for seed in (2, 3)
    ]
    off_outlines = ndimage.minimum_filter(unshadowed, 3) > 0.5 * ndimage.maximum_filter(unshadowed, 3)
    return Reference((halves[0] + halves[1]) / 2, lit, off_outlines, rmse(halves[0][lit], halves[1][lit]) / 2)


def suzanne_on_a_floor(scene, levels: int, resolution: tuple[int, int]):
    bpy.ops.mesh.primitive_monkey_add(location=(0, 0, 1.0), rotation=(-0.4, 0, 0.4))
    head = bpy.context.object
    head.modifiers.new("Subdivision", "SUBSURF").render_levels = levels
    for polygon in head.data.polygons:
        polygon.use_smooth = True
    bpy.ops.mesh.primitive_plane_add(size=20)
    area = bpy.data.lights.new("Key", "AREA")
    area.energy, area.size = 300.0, 1.0
    key = bpy.data.objects.new("Key", area)
    key.location, key.rotation_euler = (2.0, -2.0, 4.0), (0.6, 0.0, 0.785)
    scene.collection.objects.link(key)
    scene.camera.location, scene.camera.rotation_euler = (0.0, -6.0, 3.0), (1.2, 0.0, 0.0)
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.render.resolution_percentage = 100


def shadow_pass(scene, method: Method, view_count: int):
    from vir_addon.blender.job import frame_jobs, run

    (job,) = frame_jobs(scene, scene.frame_current, Settings(method=method, view_count=view_count)).values()
    device = open_device("moderngl")
    try:
        passes = run(job, device)
    finally:
        device.close()
    return passes.images[shadow_pass_name("Key")], passes.statistics


def compare(scene, reference, view_count):
    for method in (Method.MVR, Method.IVIR):
        image, statistics = shadow_pass(scene, method, view_count)
        overall = rmse(image[reference.lit], reference.ratio[reference.lit])
        penumbra = rmse(image[reference.penumbra], reference.ratio[reference.penumbra])
        print(
            f"{method.value}: RMSE {overall:.4f}, penumbra {penumbra:.4f}, reference's noise {reference.noise:.4f}, "
            f"{statistics.instanced_triangle_count} triangles"
        )
        yield method, overall, penumbra


def test_small_picture_agrees(scene, tmp_path):
    """A small picture of a coarser head with fewer samples: the reference's noise is allowed for."""
    suzanne_on_a_floor(scene, levels=4, resolution=(240, 135))
    reference = cycles_reference(scene, 256, tmp_path)
    assert reference.noise < 0.03 and reference.penumbra.mean() > 0.05
    for method, overall, penumbra in compare(scene, reference, 128):
        assert np.sqrt(max(overall**2 - reference.noise**2, 0)) <= 0.025, method
        assert np.sqrt(max(penumbra**2 - reference.noise**2, 0)) <= 0.05, method


LIGHTS = {
    "hard point": ("POINT", {"shadow_soft_size": 0.0}),
    "point with a soft falloff": ("POINT", {"shadow_soft_size": 0.4, "use_soft_falloff": True}),
    "sphere": ("POINT", {"shadow_soft_size": 0.4, "use_soft_falloff": False}),
    "spot": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_soft_falloff": True}),
    "spot of a sphere": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_soft_falloff": False}),
    "square spot, which is round": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.2, "spot_blend": 0.5, "use_square": True}),
    "wide spot": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 2.9, "spot_blend": 0.3}),
    "sun": ("SUN", {"angle": 0.15}),
    "wide sun": ("SUN", {"angle": 0.8}),
}


@pytest.mark.slow
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (1.5, 0.7, 1.2)])
@pytest.mark.parametrize("name", LIGHTS)
def test_lights_of_all_kinds_agree(scene, tmp_path, name, scale):
    if scale != (1.0, 1.0, 1.0) and name not in ("sphere", "spot"):
        pytest.skip("scale concerns the cone alone, and must not concern the radius")
    suzanne_on_a_floor(scene, levels=4, resolution=(160, 90))
    kind, data = LIGHTS[name]
    lamp = bpy.data.lights.new("Lamp", kind)
    lamp.energy = 3.0 if kind == "SUN" else 300.0
    for key, value in data.items():
        setattr(lamp, key, value)
    bpy.data.objects.remove(bpy.data.objects["Key"])
    key = bpy.data.objects.new("Key", lamp)
    scene.collection.objects.link(key)
    key.location, key.rotation_euler, key.scale = (2.0, -2.0, 4.0), (0.6, 0.0, 0.785), scale
    reference = cycles_reference(scene, 512, tmp_path)
    judged = reference.lit & reference.off_outlines
    assert judged.sum() > 0.8 * reference.lit.sum()
    for method in (Method.MVR, Method.IVIR):
        image, _ = shadow_pass(scene, method, 128)
        error = rmse(image[judged], reference.ratio[judged])
        print(f"{name} {method.value}: RMSE {error:.4f}, reference's noise {reference.noise:.4f}")
        assert error <= 0.02, method


@pytest.mark.slow
def test_million_triangles_agree(scene, tmp_path):
    suzanne_on_a_floor(scene, levels=5, resolution=(480, 270))
    reference = cycles_reference(scene, 1024, tmp_path)
    for method, overall, penumbra in compare(scene, reference, 128):
        assert overall <= 0.02, method
        assert penumbra <= 0.04, method
