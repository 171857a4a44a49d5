"""The scenes of the benchmarks: as large as their tables say, finite, and with work for a light."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from demo_scenes import breakfast, colonnade, forest, furnished_room, gallery  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.job import frame_jobs, take_snapshot  # noqa: E402
from vir_addon.core.plan import plan  # noqa: E402
from vir_addon.core.scene import LightShape, SceneSnapshot  # noqa: E402
from vir_addon.core.settings import Effect, Settings  # noqa: E402


def built(build: Callable[..., None], **sizes: int) -> SceneSnapshot:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    build(scene, **sizes)
    return take_snapshot(scene, scene.view_layers[0], (160, 90))


def check(taken: SceneSnapshot, light_shape: LightShape) -> None:
    assert not taken.left_out
    assert [light.shape for light in taken.lights] == [light_shape]
    assert all(np.isfinite(mesh.positions_os).all() for mesh in taken.meshes)
    (planned,) = plan(taken, Settings()).passes
    assert planned.runs and planned.needs_maps


def test_colonnade_is_large_triangles():
    taken = built(colonnade.build)
    check(taken, LightShape.RECTANGLE)
    assert 150_000 < taken.instanced_triangle_count < 300_000
    assert taken.unique_triangle_count < 0.1 * taken.instanced_triangle_count


@pytest.mark.slow
def test_furnished_room_has_two_million_triangles_around_a_round_lamp():
    taken = built(furnished_room.build)
    check(taken, LightShape.POINT)
    assert taken.instanced_triangle_count >= 2_000_000


def test_forest_instances_as_many_triangles_as_asked():
    sizes = {"tree_count": 10, "triangles_a_tree": 60_000}
    taken = built(forest.build, **sizes)
    check(taken, LightShape.SUN)
    ground = next(mesh for mesh in taken.meshes if mesh.name == "Ground")
    assert taken.instanced_triangle_count - ground.triangle_count == pytest.approx(600_000, rel=0.01)
    assert taken.unique_triangle_count - ground.triangle_count == pytest.approx(forest.SPECIES * 60_000, rel=0.01)
    assert len(taken.instances) == 11


def test_a_tree_leaves_room_for_its_leaves_and_is_the_same_every_time():
    (wood, _), (leaves, _) = forest.tree(0, 60_000)
    for again, shape in zip(forest.tree(0, 60_000), (wood, leaves), strict=True):
        np.testing.assert_array_equal(again[0].points, shape.points)
    triangles = 2 * len(wood.quads) + len(wood.triangles) + 2 * len(leaves.quads)
    assert triangles == pytest.approx(60_000, rel=0.001)
    assert 2 * len(leaves.quads) > 0.1 * triangles
    assert leaves.points[:, 2].min() > 1.0


@pytest.mark.parametrize(
    ("build", "planar_count", "cube_count"),
    [(partial(colonnade.build, columns=7, has_mirrors=True), 2, 2), (breakfast.build, 0, 7), (gallery.build, 1, 3)],
    ids=["colonnade", "breakfast", "gallery"],
)
def test_scenes_of_mirrors_have_them_in_the_picture(build, planar_count, cube_count):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build(bpy.context.scene)
    (job,) = frame_jobs(bpy.context.scene, 1, Settings(effects=(Effect.REFLECTION,)), (160, 90)).values()
    assert not job.snapshot.left_out
    shown = [each for each in job.plan.reflections.reflectors if each.seen is not None]
    is_planar = [each.method_text == "planar" for each in shown]
    assert (sum(is_planar), len(shown) - sum(is_planar)) == (planar_count, cube_count)
