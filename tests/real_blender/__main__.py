"""Run the extension's zip in a real Blender, with a window, on a profile of its own.

    BLENDER=/path/to/blender python -m tests.real_blender DIST_FOLDER OUTPUT_FOLDER [--only NAME ...]

DIST_FOLDER has the zips of `make extension`. Screenshots and rendered files go to OUTPUT_FOLDER/NAME. Needs a display: on a machine
without one, BLENDER may be a script that starts a virtual one. Where Blender's own screenshots stay black (software OpenGL on some virtual
displays) SCREENSHOT may name a command that takes a file to write, e.g. SCREENSHOT="import -silent -window root".
"""

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

PROJECT_FOLDER = Path(__file__).resolve().parent.parent.parent
SCRIPTS = Path(__file__).resolve().parent
PARTS = ("first_steps", "frames", "tutorial", "passes", "preview", "interruptions", "mistakes", "windows", "vulkan", "uninstall")
"""in this order, on one profile: the first installs what the others use"""
LIMIT_S = 900
OPTIONS = {"vulkan": ("--gpu-backend", "vulkan")}
"""of Blender, for some parts"""
WINDOW = ("--window-geometry", "0", "0", "1600", "1000", "--enable-event-simulate")


def zip_for_this_machine(folder: Path) -> Path:
    system = {"Linux": "linux_x64", "Windows": "windows_x64", "Darwin": "macos_arm64"}[platform.system()]
    manifest = tomllib.loads((PROJECT_FOLDER / "blender_manifest.toml").read_text())
    path = folder / f"{manifest['id']}-{manifest['version']}-{system}.zip"
    if not path.is_file():
        sys.exit(f"{path} is missing; run `make extension`")
    return path


def run(blender: str, arguments: list[str], environment: dict[str, str]) -> bool:
    print(f"-- {' '.join(arguments)}", flush=True)
    try:
        status = subprocess.run([blender, *arguments], env=environment, timeout=LIMIT_S, check=False).returncode
    except subprocess.TimeoutExpired:
        print(f"ended after {LIMIT_S} s")
        return False
    return status == 0


def run_frames(blender: str, scene: Path, folder: Path, environment: dict[str, str]) -> bool:
    """`blender --background -f` and `-a`, as a farm does, with and without Blender's graphics; `check_frames` looks at the files."""
    initialize = "import gpu, bpy; bpy.app.version >= (5, 2) and gpu.init()"
    kinds = {"f": ["-f", "1"], "a": ["-s", "1", "-e", "3", "-a"], "f_gpu": ["--python-expr", initialize, "-f", "1"]}
    for name, arguments in kinds.items():
        output = folder / f"background_{name}"
        output.mkdir(parents=True, exist_ok=True)
        if not run(blender, ["--background", str(scene), "-o", f"{output}/frame_####", *arguments], environment):
            return False
    check = ["--background", "--python-exit-code", "1", "--python", str(SCRIPTS / "check_frames.py"), "--", str(folder)]
    return run(blender, check, environment)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dist", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    arguments = parser.parse_args()
    blender = os.environ.get("BLENDER") or shutil.which("blender")
    if not blender:
        sys.exit("Set BLENDER to Blender's executable, e.g. BLENDER=/opt/blender/blender make test-blender")
    output = arguments.output.resolve()
    profile = output / "profile"
    if "first_steps" in arguments.only:
        shutil.rmtree(profile, ignore_errors=True)
    profile.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(profile)}
    scene = output / "still_life.blend"
    if not scene.is_file():
        subprocess.run([sys.executable, "-m", "demo_scenes.still_life", str(scene)], cwd=PROJECT_FOLDER, check=True)
    package = zip_for_this_machine(arguments.dist.resolve())
    if "first_steps" not in arguments.only:  # which installs it with the mouse
        run(blender, ["--command", "extension", "install-file", "--repo", "user_default", "--enable", str(package)], environment)
    failed = []
    for part in arguments.only:
        folder = output / part
        folder.mkdir(exist_ok=True)
        inside = [str(package), str(scene), str(folder)]
        passed = run(blender, [*OPTIONS.get(part, ()), *WINDOW, "--python", str(SCRIPTS / f"{part}.py"), "--", *inside], environment)
        if passed and part == "frames":
            passed = run_frames(blender, folder / "frames.blend", folder, environment)
        print(f"== {part}: {'passed' if passed else 'FAILED'}", flush=True)
        failed += [] if passed else [part]
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
