"""The zip: valid, lean, and enabled by Blender from an extension folder as a user has it."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("bpy")

PROJECT_FOLDER = Path(__file__).resolve().parent.parent
MANIFEST = tomllib.loads((PROJECT_FOLDER / "blender_manifest.toml").read_text())

# Runs in a process of its own: Blender reads where its user's files are when bpy is imported.
ENABLE = """
import importlib
import sys

import bpy
import addon_utils  # on the path only after bpy

name = "bl_ext.user_default." + sys.argv[1]
for _ in range(2):
    assert addon_utils.enable(name, default_set=True) is not None, "enabling failed"
    assert addon_utils.check(name)[1], "not enabled"
    resources = importlib.import_module(name + ".vir_addon.resources")
    print(resources.shader_folder())
    print(resources.preset_folder())
    addon_utils.disable(name, default_set=True)
    assert not addon_utils.check(name)[1], "still enabled"
leaked = [name for name in sys.modules if name.split(".")[0] == "vir_addon"]
assert not leaked, f"absolute imports of {leaked}: they find nothing in a user's Blender"
print("enabled and disabled twice")
"""


def run_tool(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, PROJECT_FOLDER / "tools" / "extension.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def zip_path(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    result = run_tool("build", str(folder))
    assert result.returncode == 0, result.stdout + result.stderr
    return folder / f"{MANIFEST['id']}-{MANIFEST['version']}.zip"


def test_blenders_own_tool_finds_the_manifest_valid():
    result = run_tool("validate")
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_manifest_agrees_with_the_package():
    from vir_addon import __version__

    assert MANIFEST["version"] == __version__
    assert "Blender" not in MANIFEST["name"]


def test_the_zip_has_what_runs_and_nothing_else(zip_path):
    names = zipfile.ZipFile(zip_path).namelist()
    top_level = {name.split("/")[0] for name in names}
    assert {"__init__.py", "blender_manifest.toml", "LICENSE", "vir_addon", "gpu_shaders", "presets"} <= top_level
    assert top_level <= {"__init__.py", "blender_manifest.toml", "LICENSE", "README.md", "vir_addon", "gpu_shaders", "presets", "wheels"}
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".blend"))]
    in_checkout = {path.relative_to(PROJECT_FOLDER).as_posix() for path in (PROJECT_FOLDER / "gpu_shaders").rglob("*.glsl")}
    assert in_checkout <= set(names)


def test_blender_enables_what_was_unzipped(zip_path, tmp_path):
    extension_folder = tmp_path / "extensions" / "user_default" / MANIFEST["id"]
    zipfile.ZipFile(zip_path).extractall(extension_folder)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"BLENDER_USER_RESOURCES": str(tmp_path)}
    result = subprocess.run(
        # -P and another folder: the checkout's vir_addon must not be what is found.
        [sys.executable, "-P", "-c", ENABLE, MANIFEST["id"]],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "enabled and disabled twice" in result.stdout
    assert f"{extension_folder / 'gpu_shaders'}\n{extension_folder / 'presets'}\n" in result.stdout


@pytest.fixture(scope="module")
def platform_zips(tmp_path_factory) -> dict[str, zipfile.ZipFile]:
    """By Blender's name of the platform; from empty wheels with the names of real ones, as tests fetch nothing."""
    wheels, folder = tmp_path_factory.mktemp("wheels"), tmp_path_factory.mktemp("dist")
    for package in ("moderngl-5.13.0", "glcontext-3.1.0", "openexr-3.5.3"):
        for python in ("cp311", "cp313", "cp314"):
            for tag in ("manylinux_2_28_x86_64", "win_amd64", "macosx_11_0_arm64"):
                (wheels / f"{package}-{python}-{python}-{tag}.whl").write_bytes(f"{package} {python} {tag}".encode())
    result = run_tool("build", str(folder), str(wheels))
    assert result.returncode == 0, result.stdout + result.stderr
    return {path.stem.partition(f"{MANIFEST['version']}-")[2]: zipfile.ZipFile(path) for path in folder.glob("*.zip")}


@pytest.mark.parametrize(
    ("platform", "tag"), [("linux_x64", "manylinux_2_28_x86_64"), ("windows_x64", "win_amd64"), ("macos_arm64", "macosx_11_0_arm64")]
)
def test_each_platform_has_its_own_wheels_unmodified(platform_zips, platform, tag):
    archive = platform_zips[platform]
    bundled = {name for name in archive.namelist() if name.endswith(".whl")}
    assert len(bundled) == 9 and all(tag in name for name in bundled)
    for name in bundled:
        package, _, rest = name.removeprefix("wheels/").removesuffix(".whl").partition("-cp")
        assert archive.read(name).decode() == f"{package} cp{rest[:3]} {tag}"
    manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    generated = manifest["build"]["generated"]  # what counts in a zip of one platform
    assert {path.removeprefix("./") for path in generated["wheels"]} == bundled
    assert generated["platforms"] == [platform.replace("_", "-")] and manifest["permissions"] == MANIFEST["permissions"]


def test_an_unfinished_download_is_not_packed(tmp_path):
    (tmp_path / "moderngl-5.13.0-cp313-cp313-win_amd64.whl").write_bytes(b"")
    result = run_tool("build", str(tmp_path), str(tmp_path))
    assert result.returncode and "has 1 wheels" in result.stderr
