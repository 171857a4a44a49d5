"""Validate the extension's sources or build its zip, with the tool that the Blender wheel brings.

python tools/extension.py validate
python tools/extension.py build OUTPUT_FOLDER
"""

import importlib.util
import subprocess
import sys
from pathlib import Path

PROJECT_FOLDER = Path(__file__).resolve().parent.parent


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


def main(arguments: list[str]) -> int:
    match arguments:
        case ["validate"]:
            command = ["validate", str(PROJECT_FOLDER)]
        case ["build", output_folder]:
            command = ["build", "--source-dir", str(PROJECT_FOLDER), "--output-dir", output_folder]
        case _:
            sys.exit(__doc__)
    return subprocess.run([sys.executable, str(find_tool()), *command], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
