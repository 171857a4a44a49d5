"""Validate the extension's sources or build its zips, with the tool that the Blender wheel brings.

python tools/extension.py validate [ZIP]
python tools/extension.py wheels WHEEL_FOLDER                 fetch what the zips bundle, for every platform and Python
python tools/extension.py build OUTPUT_FOLDER WHEEL_FOLDER    one zip a platform, with the wheels inside
python tools/extension.py build OUTPUT_FOLDER                 one zip without: for Blenders that have the packages already
"""

import importlib.util
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

PROJECT_FOLDER = Path(__file__).resolve().parent.parent
MANIFEST = PROJECT_FOLDER / "blender_manifest.toml"

BUNDLED = ("moderngl", "glcontext", "OpenEXR")
"""numpy comes with Blender; versions stand in pyproject.toml"""
PYTHON_VERSIONS = ("3.11", "3.13", "3.14")
"""of Blender 4.5, of Blender 5, and of Linux distributions that build Blender with their own Python"""
PLATFORMS = {
    "linux-x64": ("manylinux2014_x86_64", "manylinux_2_17_x86_64", "manylinux_2_28_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64",),
}
"""Blender's name -> tags of wheels that run wherever Blender does"""


def find_tool() -> Path:
    """Blender's extension tool, without starting Blender. Exits in words when the wheel is missing."""
    wheel = importlib.util.find_spec("bpy")
    tools = (
        []
        if wheel is None or wheel.origin is None
        else sorted(Path(wheel.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    )
    if not tools:
        sys.exit("Blender's wheel is not installed in this Python; run `make setup` and use .venv/bin/python")
    return tools[-1]


def run_tool(*arguments: str | Path) -> None:
    """Exits with the tool's status when it fails."""
    status = subprocess.run([sys.executable, find_tool(), *arguments], check=False).returncode
    if status:
        sys.exit(status)


def fetch_wheels(folder: Path) -> None:
    """From the package index that pip is configured for, which also checks that they are what was uploaded there."""
    pinned = tomllib.loads((PROJECT_FOLDER / "pyproject.toml").read_text())["project"]["dependencies"]
    wanted = [line for line in pinned if line.partition("==")[0] in BUNDLED]
    for python_version in PYTHON_VERSIONS:
        for name, tags in PLATFORMS.items():
            platform_options = [option for tag in tags for option in ("--platform", tag)]
            choice = ["--only-binary=:all:", "--implementation", "cp", "--python-version", python_version, *platform_options]
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", *choice]
            if subprocess.run([*command, "--dest", folder, *wanted], check=False).returncode:
                sys.exit(f"pip cannot fetch {', '.join(wanted)} for {name} and Python {python_version}")


def build_with_wheels(output_folder: Path, wheel_folder: Path) -> None:
    """The zip without wheels, unpacked; wheels and their names added; packed again, a platform at a time."""
    wheels = sorted(wheel_folder.glob("*.whl"))
    expected = len(BUNDLED) * len(PYTHON_VERSIONS) * len(PLATFORMS)
    if len(wheels) != expected:
        sys.exit(f"{wheel_folder} has {len(wheels)} wheels and not {expected}; empty it and fetch them again")
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary, "source")
        plain = Path(temporary, "plain.zip")
        run_tool("build", "--source-dir", PROJECT_FOLDER, "--output-filepath", plain)
        zipfile.ZipFile(plain).extractall(source)
        (source / "wheels").mkdir()
        for wheel in wheels:
            (source / "wheels" / wheel.name).write_bytes(wheel.read_bytes())
        (source / MANIFEST.name).write_text(manifest_with(wheels))
        run_tool("validate", source)
        run_tool("build", "--source-dir", source, "--output-dir", output_folder, "--split-platforms")


def manifest_with(wheels: list[Path]) -> str:
    """The manifest with what only zips with wheels have, before its first table, as TOML asks for."""
    head, table, rest = MANIFEST.read_text().partition("[permissions]")
    names = "".join(f'    "./wheels/{wheel.name}",\n' for wheel in wheels)
    platforms = ", ".join(f'"{name}"' for name in PLATFORMS)
    return f"{head}platforms = [{platforms}]\nwheels = [\n{names}]\n\n{table}{rest}"


def main(arguments: list[str]) -> None:
    match arguments:
        case ["validate", *zip_path]:
            run_tool("validate", *(zip_path or [PROJECT_FOLDER]))
        case ["wheels", folder]:
            fetch_wheels(Path(folder))
        case ["build", output_folder]:
            run_tool("build", "--source-dir", PROJECT_FOLDER, "--output-dir", output_folder)
        case ["build", output_folder, wheel_folder]:
            build_with_wheels(Path(output_folder), Path(wheel_folder))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
