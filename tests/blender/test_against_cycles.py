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
    for method in (Method.MVR, Method.IVIR):
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


@pytest.mark.slow
def test_million_triangles_agree(scene):
    suzanne_on_a_floor(scene, levels=5)
    cycles.prepare(scene, (480, 270))
    reference = cycles.CyclesReference(scene, 1024)
    for method, overall, penumbra in compare(scene, reference, 128):
        assert overall <= 0.02, method
        assert penumbra <= 0.04, method
