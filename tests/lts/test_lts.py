"""The job for Blender 4.5 LTS (Python 3.11): a scene in, passes out, by every way out. `make test-lts` runs it beside tests/blender."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version >= (5, 0):
    pytest.skip("for the Blender 4.5 wheel in .venv-lts", allow_module_level=True)

from vir_addon import blender  # noqa: E402
from vir_addon.__main__ import main  # noqa: E402
from vir_addon.blender.compositor import add_pass_nodes  # noqa: E402
from vir_addon.blender.images import write_images  # noqa: E402
from vir_addon.blender.job import LayerJob, run, take_snapshot  # noqa: E402
from vir_addon.core.pass_set import PassSet, SetStatistics  # noqa: E402
from vir_addon.core.plan import plan  # noqa: E402
from vir_addon.core.settings import Method, Settings  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402

WIDTH_PX, HEIGHT_PX = 60, 20
WIDTH_M = 6.0
LIGHT_SIZE_M, LIGHT_HEIGHT_M, EDGE_HEIGHT_M = 2.0, 4.0, 2.0


@pytest.fixture
def registered():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender.register()
    yield
    blender.unregister()


@pytest.fixture
def scene(registered):
    """A floor seen from straight above under a square light, with a board over its left half that the camera does not see."""
    scene = bpy.context.scene

    def put(name, data, height_m):
        added = bpy.data.objects.new(name, data)
        added.location.z = height_m
        scene.collection.objects.link(added)
        return added

    def rectangle(name, left, right, height_m):
        data = bpy.data.meshes.new(name)
        data.from_pydata([(left, -2, 0), (right, -2, 0), (right, 2, 0), (left, 2, 0)], [], [(0, 1, 2, 3)])
        return put(name, data, height_m)

    rectangle("Floor", -4, 4, 0)
    rectangle("Board", -4, 0, EDGE_HEIGHT_M).visible_camera = False
    light = bpy.data.lights.new("Key", "AREA")
    light.shape, light.size = "SQUARE", LIGHT_SIZE_M
    put("Key", light, LIGHT_HEIGHT_M)
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", WIDTH_M
    scene.camera = put("Camera", camera, 10)
    scene.render.resolution_x, scene.render.resolution_y = WIDTH_PX, HEIGHT_PX
    return scene


def expected_profile() -> np.ndarray:
    """(WIDTH_PX,) the pass along x at y = 0, integrated over the light on a fine grid: the board hides what lies left of -x."""
    x = ((np.arange(WIDTH_PX) + 0.5) / WIDTH_PX - 0.5) * WIDTH_M
    across = (np.arange(400) + 0.5) / 400 * LIGHT_SIZE_M - LIGHT_SIZE_M / 2
    light_x, light_y = across[None, :, None], across[None, None, :]
    squared_distance = (x[:, None, None] - light_x) ** 2 + light_y**2 + LIGHT_HEIGHT_M**2
    delivered = LIGHT_HEIGHT_M**2 / squared_distance**2
    # the ray from the light to x crosses the board's height where it has come this far
    share = EDGE_HEIGHT_M / LIGHT_HEIGHT_M
    visible = share * light_x + (1 - share) * x[:, None, None] > 0
    return (delivered * visible).sum(axis=(1, 2)) / delivered.sum(axis=(1, 2))


def test_versions_are_those_of_the_job():
    assert bpy.app.version[:2] == (4, 5)
    assert sys.version_info[:2] == (3, 11)


@pytest.mark.parametrize("method", [Method.MVR, Method.IVIR])
def test_a_penumbra_is_where_the_integral_says(scene, method):
    snapshot = take_snapshot(scene, scene.view_layers[0])
    work = plan(snapshot, Settings(method=method, view_count=64, map_resolution_px=512))
    assert [planned.runs for planned in work.passes] == [True]
    device = open_device("moderngl")
    try:
        images = run(LayerJob(snapshot, work), device).images
    finally:
        device.close()
    profile = images["VIR Shadow Key"].mean(axis=0)
    assert profile[:15].max() <= 0.01
    assert profile[-15:].min() >= 0.99
    assert np.sqrt(((profile - expected_profile()) ** 2).mean()) <= 0.015
    np.testing.assert_allclose(images["VIR Shadow"], images["VIR Shadow Key"], atol=1e-6)


def test_the_command_line_plans_and_renders(scene, tmp_path: Path, capsys):
    import OpenEXR

    blend, output, statistics = tmp_path / "scene.blend", tmp_path / "passes", tmp_path / "stats.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert main(["plan", str(blend)]) == 0
    assert "Key" in capsys.readouterr().out
    options = ["--views", "16", "--map-resolution", "256", "--preview", "--stats", str(statistics)]
    assert main(["render", str(blend), "--output", str(output), *options]) == 0
    assert {path.name for path in output.iterdir()} == {
        "scene_0001.exr",
        "scene_0001_VIR_Shadow.png",
        "scene_0001_VIR_Shadow_Key.png",
        "scene_0001_contact_sheet.png",
    }
    with OpenEXR.File(str(output / "scene_0001.exr")) as file:
        pixels = file.channels()["ViewLayer.VIR Shadow Key.V"].pixels
    assert pixels.shape == (HEIGHT_PX, WIDTH_PX)
    assert pixels[:, :15].max() <= 0.01 and pixels[:, -15:].min() >= 0.99
    (made,) = json.loads(statistics.read_text())["frames"][0]["view_layers"]["ViewLayer"]["passes"]
    assert made["view_count"] == 16


def test_passes_become_images_and_outputs_that_survive_saving(registered, tmp_path: Path):
    passes = PassSet({"VIR Shadow Key": np.linspace(0.0, 1.0, 12, dtype=np.float32).reshape(3, 4)}, SetStatistics())
    add_pass_nodes(bpy.context.scene, write_images(passes))
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    tree = bpy.context.scene.node_tree
    again = add_pass_nodes(bpy.context.scene, write_images(passes))
    assert again.added == []
    assert again.node == tree.nodes["VIR Passes"]
