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


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder into which pip has installed the package, from a checkout that it is not near to."""
    target = tmp_path_factory.mktemp("somewhere") / "installed"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", target, PROJECT_FOLDER],
        check=True,
        env=os.environ | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"},
    )
    return target


def run_installed(installed: Path, *arguments: str) -> str:
    """What Python prints, run from a folder that has nothing to do with the checkout."""
    # In front of the path, so that the editable checkout is not what is found.
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-P", *arguments]
    return subprocess.run(command, check=True, cwd=installed.parent, env=environment, capture_output=True, text=True).stdout


@pytest.mark.slow
def test_pip_installs_them_inside_the_package(installed):
    script = "from vir_addon import resources as r; print(r.shader_folder(), r.preset_folder(), sep='\\n')"
    found = run_installed(installed, "-c", script)
    assert found.splitlines() == [str(installed / "vir_addon" / name) for name in ("gpu_shaders", "presets")]
    shaders = {path.relative_to(PROJECT_FOLDER / "gpu_shaders") for path in (PROJECT_FOLDER / "gpu_shaders").rglob("*.glsl")}
    assert {path.relative_to(installed / "vir_addon" / "gpu_shaders") for path in installed.rglob("*.glsl")} == shaders


@pytest.mark.slow
def test_an_installed_package_finds_its_shaders_and_a_device(installed):
    told = run_installed(installed, "-m", "vir_addon", "doctor")
    assert f"shaders: {installed / 'vir_addon' / 'gpu_shaders'}" in told
    assert "device moderngl: not usable" not in told
    # every variant of every kernel can be composed from what was installed
    assert "resolve: " in run_installed(installed, "-m", "vir_addon.device.check_shaders")
