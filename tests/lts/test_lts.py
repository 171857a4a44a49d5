"""The job for Blender 4.5 LTS (Python 3.11): the way out of the house in one go. `make test-lts` runs it beside tests/blender."""

import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version >= (5, 0):
    pytest.skip("for the Blender 4.5 wheel in .venv-lts", allow_module_level=True)

from vir_addon import blender  # noqa: E402
from vir_addon.blender.compositor import add_pass_nodes  # noqa: E402
from vir_addon.blender.images import write_images  # noqa: E402
from vir_addon.core.pass_set import PassSet, SetStatistics  # noqa: E402


@pytest.fixture
def registered():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender.register()
    yield
    blender.unregister()


def test_versions_are_those_of_the_job():
    assert bpy.app.version[:2] == (4, 5)
    assert sys.version_info[:2] == (3, 11)


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
