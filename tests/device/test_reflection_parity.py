"""Both devices show the same in mirrors."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.scenes import box, bumpy_sphere, floor, matte, mirror, perspective_camera, point_light, render_batches, render_passes, snapshot
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.material import World
from vir_addon.core.material_program import LUMINANCE
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.passes import eye
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.plan import plan
from vir_addon.core.render import Renderer
from vir_addon.core.settings import Effect, ReflectionFilter, ReflectionLookUp, ReflectionMethod, ReflectionWords, Settings
from vir_addon.core.steps import run_steps
from vir_addon.device.owned import Owned


def words(kind):
    return {"reflection_method": ReflectionMethod.IVIR, "reflection_look_up": ReflectionLookUp.SHADED, "reflection_words": kind}


@pytest.mark.parametrize(
    "choices",
    [
        *({"reflection_method": method} for method in (ReflectionMethod.MVR, ReflectionMethod.IVIR, ReflectionMethod.EPR)),
        words(ReflectionWords.PACKED),
        words(ReflectionWords.WIDE),
        {"reflection_look_up": ReflectionLookUp.LAZY, "reflection_filter": ReflectionFilter.POISSON},
    ],
)
def test_reflections_are_the_same_on_both_devices(both, choices):
    """Rays, maps and materials: a mirror ball over a lit floor before the world's grey, and a ball of small triangles."""
    ball = bumpy_sphere("ball", (0, 0, 0.8), 0.7, 24, bump_share=0.0)
    camera = perspective_camera((0.5, -3.0, 1.6), (0, 0, 0.7), 64, 36, 0.6)
    fine = bumpy_sphere("fine", (0.2, -1.5, 0.3), 0.3, 60)
    materials = [matte((0.7, 0.5, 0.3)), mirror(), matte((0.2, 0.8, 0.4))]
    meshes = [floor(4.0), ball, fine]
    light = point_light(eye=(1, -1, 3), radius_m=0.0)
    scene = snapshot(meshes, [light], camera, 64, 36, materials=materials, world=World((0.2, 0.2, 0.2)))
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 4, "bounces": 1, **choices}
    images = [render_passes(scene, device, **settings) for device in both]
    for name in (REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME):
        assert images[0][name].max() > 0.1
        differs = np.abs(images[0][name] - images[1][name]).max(axis=-1) > 1e-3 * images[0][name].max()
        # an edge that a ray meets, or passes by, in the last place of float32
        assert differs.mean() < 0.005


def several_meshes():
    """A floor, a mirror ball and four boxes of one mesh."""
    camera = perspective_camera((0.5, -3.0, 1.6), (0, 0, 0.7), 64, 36, 0.6)
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 0.8), 0.7, 12), box("box", (0.3, -1.4, 0.3), (0.3, 0.3, 0.3))]
    materials = [matte((0.1, 0.1, 0.1)), mirror(), matte((0.9, 0.9, 0.9))]
    scene = snapshot(meshes, [point_light()], camera, 64, 36, materials=materials, world=World((1.0, 1.0, 1.0)))
    mesh_index, moves = [0, 1, 2, 2, 2, 2], np.eye(4)[None].repeat(6, axis=0)
    moves[2:, 0, 3] = -1.5, -0.5, 0.5, 1.0
    rows = {name: values[mesh_index] for name, values in vars(scene.instances).items() if isinstance(values, np.ndarray)}
    instances = dataclasses.replace(scene.instances, **rows)
    return dataclasses.replace(scene, instances=dataclasses.replace(instances, world_from_object=moves @ instances.world_from_object))


@pytest.mark.parametrize("triangles_at_once", [1, 7, 300])
def test_the_eye_rasterizes_in_portions_what_it_does_at_once(device, monkeypatch, triangles_at_once):
    """Which triangles of which instances pixels see: ranges of a mesh, some of its instances, several meshes."""
    scene = several_meshes()
    settings = Settings(effects=(Effect.REFLECTION,), reflection_sample_count=4, bounces=1)

    def seen() -> list[np.ndarray]:
        with contextlib.closing(Renderer(scene, plan(scene, settings), device)) as renderer:
            device.run(renderer.prepare)
            return [device.read(texture) for texture in (*renderer.eye.buffers[0], *renderer.eye.triangles)]

    whole = seen()
    assert {0, 1, 2, 3, 4, 5} <= set(whole[0][..., 3].ravel().tolist()) and whole[2][..., 0].max() > 200
    monkeypatch.setattr(eye, "TRIANGLES_A_PORTION", triangles_at_once)
    for image, expected in zip(seen(), whole, strict=True):
        np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("is_software", [False, True])
def test_software_rasterizers_pause_between_portions_of_the_eyes_triangles(device, monkeypatch, is_software):
    """Of no more triangles each than they may draw at once; which these are does not change from one rasterization to the next."""
    scene = several_meshes()
    count = sum(len(scene.meshes[index].triangles) for index in scene.instances.mesh_index)
    monkeypatch.setattr(device, "is_software", is_software)
    monkeypatch.setattr(eye, "TRIANGLES_A_PORTION", 100)
    with Owned() as owned:
        scene_data = owned.own(SceneData(scene, device))
        # one rasterization an offset
        eye_pass = owned.own(eye.EyePass(scene_data, compute_bounds(scene), np.zeros((2, 2)), visibility_texel_count=0))
        run_steps(eye_pass.rendering([1], batch=0))  # kernels are translated, which takes a pause of its own
        rasterize, drawn = eye_pass.rasterize.draw, []
        monkeypatch.setattr(
            eye_pass.rasterize,
            "draw",
            lambda target, viewport, draws, **rest: drawn.append(draws) or rasterize(target, viewport, draws, **rest),
        )
        pauses = [sum(1 for _ in eye_pass.rendering([index], batch=0)) for index in (0, 1)]
    sizes = [
        sum(draw.instance_count * (draw.triangle_range[1] if draw.triangle_range else draw.mesh.triangle_count) for draw in draws)
        for draws in drawn
    ]
    # one pause more than between portions: before the surface is told from what is visible
    assert pauses == 2 * [len(drawn) // 2] and sum(sizes) == 2 * count
    if is_software:
        assert len(drawn) // 2 >= count // 100 >= 3 and max(sizes) <= 100
    else:
        assert len(drawn) == 2
    assert all(now is before for now, before in zip(drawn[len(drawn) // 2 :], drawn, strict=False))


def test_the_error_estimate_is_that_of_the_sums(device):
    """Both against the sums as NumPy adds them up; pictures are not whole tiles wide."""
    ball = bumpy_sphere("ball", (0, 0, 0.8), 0.7, 16, bump_share=0.0)
    camera = perspective_camera((0.5, -3.0, 1.6), (0, 0, 0.7), 37, 21, 0.6)
    meshes = [floor(4.0), ball, box("box", (0.3, -1.4, 0.3), (0.3, 0.3, 0.3))]
    materials = [matte((0.1, 0.1, 0.1)), mirror(), matte((0.9, 0.9, 0.9))]
    scene = snapshot(meshes, [point_light()], camera, 37, 21, materials=materials, world=World((1.0, 1.0, 1.0)))
    settings = Settings(effects=(Effect.REFLECTION,), reflection_sample_count=6, bounces=1, view_count=1)
    with contextlib.closing(Renderer(scene, plan(scene, settings), device)) as renderer:
        device.run(renderer.prepare)
        render_batches(renderer)
        work = renderer.reflections
        radiance, color = (device.read(work.sums[name]).astype(np.float64) for name in ("radiance_sums", "color_sums"))
        rounds = work.round_count
        mean = radiance[..., :3] @ LUMINANCE / rounds
        variance = np.maximum(radiance[..., 3] / rounds - mean**2, 0)[color[..., 3] > 0] / (rounds - 1)
        assert rounds >= 6
        assert work.compute_error() == pytest.approx(np.sqrt(variance.mean()), rel=1e-3) and variance.mean() > 0
