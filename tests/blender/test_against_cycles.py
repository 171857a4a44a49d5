"""Shadow passes against Cycles in the same Blender: every material white diffuse, one light, no bounces, shadowed over unshadowed."""

from __future__ import annotations

import numpy as np
import pytest

from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device

bpy = pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

from tests import cycles  # noqa: E402  (bpy decides whether this file runs)


def suzanne_on_a_floor(scene, levels: int):
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


def shadow_pass(scene, method: Method, view_count: int):
    from vir_addon.blender.job import frame_jobs, run

    (job,) = frame_jobs(scene, scene.frame_current, Settings(method=method, view_count=view_count)).values()
    device = open_device("moderngl")
    try:
        passes = run(job, device)
    finally:
        device.close()
    return passes.images[shadow_pass_name("Key")], passes.statistics


def compare(scene, reference: cycles.CyclesReference, view_count: int):
    for method in (Method.MVR, Method.IVIR, Method.MICRO):
        image, statistics = shadow_pass(scene, method, view_count)
        errors = reference.errors(image)
        print(
            f"{method.value}: RMSE {errors['rmse']:.4f}, penumbra {errors['rmse_penumbra']:.4f}, reference's noise {reference.noise:.4f}, "
            f"{statistics.instanced_triangle_count} triangles"
        )
        yield method, errors["rmse"], errors["rmse_penumbra"]


def test_small_picture_agrees(scene):
    """A small picture of a coarser head with fewer samples: the reference's noise is allowed for."""
    suzanne_on_a_floor(scene, levels=4)
    cycles.prepare(scene, (240, 135))
    reference = cycles.CyclesReference(scene, 256)
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


UNSCALED = (1.0, 1.0, 1.0)
SCALED = (1.5, 0.7, 1.2)
"""concerns the cone alone, and must not concern the radius"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scale"), [*((name, UNSCALED) for name in LIGHTS), ("sphere", SCALED), ("spot", SCALED)])
def test_lights_of_all_kinds_agree(scene, name, scale):
    suzanne_on_a_floor(scene, levels=4)
    kind, data = LIGHTS[name]
    lamp = bpy.data.lights.new("Lamp", kind)
    lamp.energy = 3.0 if kind == "SUN" else 300.0
    for key, value in data.items():
        setattr(lamp, key, value)
    bpy.data.objects.remove(bpy.data.objects["Key"])
    key = bpy.data.objects.new("Key", lamp)
    scene.collection.objects.link(key)
    key.location, key.rotation_euler, key.scale = (2.0, -2.0, 4.0), (0.6, 0.0, 0.785), scale
    cycles.prepare(scene, (160, 90))
    reference = cycles.CyclesReference(scene, 512)
    assert reference.off_outlines.sum() > 0.8 * reference.judged.sum()
    for method in (Method.MVR, Method.IVIR, Method.MICRO):
        image, _ = shadow_pass(scene, method, 128)
        errors = reference.errors(image)
        print(f"{name} {method.value}: RMSE {errors['rmse_off_outlines']:.4f}, reference's noise {reference.noise:.4f}")
        assert errors["rmse_off_outlines"] <= 0.02, method


@pytest.mark.slow
def test_million_triangles_agree(scene):
    suzanne_on_a_floor(scene, levels=5)
    cycles.prepare(scene, (480, 270))
    reference = cycles.CyclesReference(scene, 1024)
    for method, overall, penumbra in compare(scene, reference, 128):
        assert overall <= 0.02, method
        assert penumbra <= 0.04, method
