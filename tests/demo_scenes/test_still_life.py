"""The demo scene: big enough, well formed, and the same on every build."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from demo_scenes import still_life  # noqa: E402

SAMPLED = ("Cloth", "Basket", "Walnut", "Blossoms", "Leaf Cluster")


def _points(mesh: bpy.types.Mesh) -> np.ndarray:
    points = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", points)
    return points


def _build() -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    still_life.build(bpy.context.scene)
    return bpy.context.scene


def _fingerprint() -> dict[str, str]:
    return {name: hashlib.sha256(_points(bpy.data.objects[name].data).tobytes()).hexdigest() for name in SAMPLED}


@pytest.fixture(scope="module")
def first_fingerprint() -> dict[str, str]:
    _build()
    return _fingerprint()


@pytest.fixture(scope="module")
def scene(first_fingerprint: dict[str, str]) -> bpy.types.Scene:
    """The second build of this module."""
    return _build()


def test_builds_are_identical(first_fingerprint: dict[str, str], scene: bpy.types.Scene) -> None:
    assert _fingerprint() == first_fingerprint


def test_has_three_area_lights_of_different_sizes(scene: bpy.types.Scene) -> None:
    lights = {thing.name: thing.data for thing in scene.objects if thing.type == "LIGHT"}
    assert sorted(lights) == ["Key", "Lamp", "Window"]
    assert all(light.type == "AREA" for light in lights.values())
    assert lights["Key"].size * 2 < lights["Lamp"].size < lights["Window"].size / 4
    assert lights["Window"].shape == "RECTANGLE"
    assert lights["Lamp"].shape == "DISK"
    assert lights["Lamp"].spread < np.pi


def test_has_a_camera_and_resolution(scene: bpy.types.Scene) -> None:
    assert scene.camera is not None
    assert (scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage) == (960, 540, 100)


def test_evaluated_geometry_is_large_finite_and_instanced(scene: bpy.types.Scene) -> None:
    triangles_of: dict[str, int] = {}
    total = instances = 0
    for item in bpy.context.evaluated_depsgraph_get().object_instances:
        if item.object.type != "MESH":  # a curve comes twice: as itself, and as the mesh that is rendered
            continue
        key = item.object.original.name
        if key not in triangles_of:
            mesh = item.object.to_mesh()
            triangles_of[key] = len(mesh.loop_triangles) or sum(len(polygon.vertices) - 2 for polygon in mesh.polygons)
            assert np.isfinite(_points(mesh)).all(), key
            item.object.to_mesh_clear()
        assert np.isfinite(np.array(item.matrix_world)).all()
        total += triangles_of[key]
        instances += item.is_instance
    assert 300_000 <= total <= 800_000
    assert instances >= 300
