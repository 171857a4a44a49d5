"""A region's two matrices and the camera made of them: the same places of the world end up at the same places of the picture."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.extract import snapshot  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.extract.camera import extract_camera, extract_picture  # noqa: E402
from vir_addon.blender.extract.viewport_view import viewport_view  # noqa: E402
from vir_addon.core.passes.eye import clip_from_view  # noqa: E402

SIZE = (320, 200)
PLACES = np.random.default_rng(3).uniform((-2, -3, -2, 1), (2, 3, 2, 1), (32, 4))
PLACES[:, 3] = 1


def on_screen(camera) -> np.ndarray:
    """(n, 3) normalized device coordinates of PLACES; row by row: x, y, depth"""
    clip = PLACES @ (clip_from_view(camera, camera.clip_start_m, camera.clip_end_m) @ np.linalg.inv(camera.world_from_view)).T
    return clip[:, :3] / clip[:, 3:]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_it_sees_what_the_scenes_camera_sees(scene, kind, mirrored):
    data = scene.camera.data
    data.type, data.shift_x, data.shift_y, data.clip_start, data.clip_end, data.ortho_scale = kind, 0.2, -0.1, 0.5, 60.0, 7.0
    scene.camera.rotation_euler = (math.radians(80), math.radians(5), math.radians(10))
    scene.camera.scale.x = -1.0 if mirrored else 1.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = scene.camera.evaluated_get(depsgraph)
    world_from_camera = np.array(evaluated.matrix_world)
    projection = np.array(evaluated.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1]))
    view = viewport_view(np.linalg.inv(world_from_camera), projection, *SIZE)
    expected = extract_camera(evaluated, scene.render, extract_picture(scene.render, SIZE), np.zeros(3))
    camera = view.camera(np.zeros(3))
    assert camera.is_orthographic == (kind == "ORTHO")
    np.testing.assert_allclose(on_screen(camera)[:, :2], on_screen(expected)[:, :2], atol=2e-6)
    assert camera.clip_end_m - camera.clip_start_m == pytest.approx(59.5, rel=1e-3)


def test_a_free_orthographic_view_sees_behind_its_eye():
    """Blender's projection of such a view, of clip end 50: from 50 behind the eye to 50 before it."""
    left, right, bottom, top, depth = -3.0, 5.0, -2.0, 3.0, 50.0
    projection = np.diag([2 / (right - left), 2 / (top - bottom), -1 / depth, 1.0])
    projection[:2, 3] = -(right + left) / (right - left), -(top + bottom) / (top - bottom)
    camera = viewport_view(np.eye(4), projection, *SIZE).camera(np.zeros(3))
    np.testing.assert_allclose(camera.window, (left, right, bottom, top))
    clip = PLACES @ projection.T
    np.testing.assert_allclose(on_screen(camera), clip[:, :3], atol=1e-12)
    assert camera.clip_start_m == 0.0 and camera.clip_end_m == pytest.approx(2 * depth)


def test_the_far_end_may_be_rounded_away():
    """From 0.01 to 1e6 m, float32 leaves nothing of the difference to infinity."""
    projection = np.diag([1.0, 1.6, -1.0, 0.0]).astype(np.float32)
    projection[2, 3], projection[3, 2] = -0.02, -1.0
    camera = viewport_view(np.eye(4), projection, *SIZE).camera(np.zeros(3))
    assert camera.clip_start_m == pytest.approx(0.01)
    assert 1e4 < camera.clip_end_m < 1e9


@pytest.mark.parametrize(
    "matrices",
    [(np.eye(4), np.zeros((4, 4))), (np.zeros((4, 4)), np.eye(4)), (np.full((4, 4), np.nan), np.eye(4))],
    ids=["no projection", "no view", "not numbers"],
)
def test_a_region_that_was_never_drawn_shows_nothing(matrices):
    assert viewport_view(*matrices, *SIZE) is None
    assert viewport_view(np.eye(4), np.eye(4), 0, 200) is None


def test_local_view_hides_the_others_and_keeps_some_light(scene, add):
    add.cube("Shown")
    hidden = add.cube("Hidden", location=(3, 0, 0))
    key = add.light("Key")
    fill = add.light("Fill")
    collection = bpy.data.collections.new("Leaves")
    leaf = add.cube("Leaf", collection)
    instancer = add.instance_of(collection, "Branch", location=(0, 4, 0))
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def names(*outside):
        uids = frozenset(one.session_uid for one in outside)
        view = viewport_view(np.eye(4), np.diag([1.0, 1.0, -0.1, 1.0]), *SIZE, uids)
        taken = snapshot(depsgraph, view=view)
        return sorted(taken.instances.object_names), [light.name for light in taken.lights]

    assert names() == (["Hidden", "Leaf", "Shown"], ["Fill", "Key"])
    assert names(hidden, key) == (["Leaf", "Shown"], ["Fill"])
    # an instance is shown where what brings it in is shown
    assert names(leaf) == (["Hidden", "Leaf", "Shown"], ["Fill", "Key"])
    assert names(instancer) == (["Hidden", "Shown"], ["Fill", "Key"])
    # with no light at all there would be nothing to see
    assert names(hidden, key, fill) == (["Leaf", "Shown"], ["Fill", "Key"])


def test_a_view_needs_no_camera(scene, add):
    add.cube()
    add.light("Key")
    scene.camera = None
    view = viewport_view(np.eye(4), np.diag([1.0, 1.0, -0.1, 1.0]), *SIZE)
    taken = snapshot(bpy.context.evaluated_depsgraph_get(), view=view)
    assert (taken.width_px, taken.height_px) == SIZE
    assert taken.notes == ()
