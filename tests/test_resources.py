"""Shaders and presets are found wherever the project is installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vir_addon import resources
from vir_addon.core.errors import VirError

PROJECT_FOLDER = Path(__file__).resolve().parent.parent


def test_a_checkout_uses_its_own_files():
    assert resources.shader_folder() == PROJECT_FOLDER / "gpu_shaders"
    assert resources.preset_folder() == PROJECT_FOLDER / "presets"


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(VirError, match=r"folder gpu_shaders is missing: expected .* or .*install it again"):
        resources.find_folder("gpu_shaders", tmp_path / "vir_addon")


@pytest.mark.slow
def test_pip_installs_them_inside_the_package(tmp_path):
    installed = tmp_path / "installed"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", installed, PROJECT_FOLDER],
        check=True,
        env=os.environ | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"},
    )
    script = "from vir_addon import resources as r; print(r.shader_folder(), r.preset_folder(), sep='\\n')"
    # In front of the path, so that the editable checkout is not what is found.
    environment = os.environ | {"PYTHONPATH": str(installed)}
    found = subprocess.run([sys.executable, "-P", "-c", script], check=True, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert found.stdout.splitlines() == [str(installed / "vir_addon" / name) for name in ("gpu_shaders", "presets")]
    shaders = {path.relative_to(PROJECT_FOLDER / "gpu_shaders") for path in (PROJECT_FOLDER / "gpu_shaders").rglob("*.glsl")}
    assert {path.relative_to(installed / "vir_addon" / "gpu_shaders") for path in installed.rglob("*.glsl")} == shaders
