"""Where the files that are not Python lie.

In a checkout and in the extension's folder `gpu_shaders/` and `presets/` stand beside this package; `pip install`
puts them inside it, because an installed package has nothing beside it that is its own.
"""

from __future__ import annotations

from pathlib import Path

from .core.errors import VirError

PACKAGE_FOLDER = Path(__file__).resolve().parent


def shader_folder() -> Path:
    """The folder `gpu_shaders`. Raises VirError when the installation lacks it."""
    return find_folder("gpu_shaders", PACKAGE_FOLDER)


def preset_folder() -> Path:
    """The folder `presets`. Raises VirError when the installation lacks it."""
    return find_folder("presets", PACKAGE_FOLDER)


def find_folder(name: str, package_folder: Path) -> Path:
    """The folder `name` inside or beside `package_folder`. Raises VirError naming both places when neither exists."""
    candidates = (package_folder / name, package_folder.parent / name)
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    places = " or ".join(str(candidate) for candidate in candidates)
    raise VirError(f"the folder {name} is missing: expected {places}. The installation is incomplete; install it again.")
