"""What this machine has, what is missing, and the exact command that installs it."""

from __future__ import annotations

import importlib.metadata
import platform
import sys

from rich.console import Console
from rich.table import Table

from .. import __version__
from ..core.errors import DeviceError, VirError
from ..resources import preset_folder, shader_folder

PACKAGES = {
    "bpy": "reads scenes; needs Python 3.13 (bpy 5.2) or 3.11 (bpy 4.5)",
    "numpy": "arrays",
    "moderngl": "the device moderngl",
    "OpenEXR": "writes passes",
    "rich": "the command line's tables",
    "pillow": "--preview",
}
MISSING_PACKAGE_HELP = {"bpy": "bpy==4.5.15" if sys.version_info < (3, 12) else "bpy==5.2.3"}


def run_doctor(console: Console) -> None:
    """Raises DeviceError when no device can be opened."""
    console.print(f"VIR {__version__}, Python {platform.python_version()}, {platform.platform()}", highlight=False)
    _print_packages(console)
    for name, find in (("shaders", shader_folder), ("presets", preset_folder)):
        try:
            console.print(f"{name}: {find()}", highlight=False, soft_wrap=True)
        except VirError as error:
            console.print(f"{name}: {error}", highlight=False, style="red")
    _print_devices(console)


def _print_packages(console: Console) -> None:
    table = Table("package", "version", "for")
    for package, purpose in PACKAGES.items():
        try:
            table.add_row(package, importlib.metadata.version(package), purpose)
        except importlib.metadata.PackageNotFoundError:
            wanted = MISSING_PACKAGE_HELP.get(package, package)
            table.add_row(package, "[red]missing", f"{purpose}; install it: python -m pip install {wanted}")
    console.print(table)


def _print_devices(console: Console) -> None:
    try:
        from ..device.open import open_device
    except ImportError as error:
        raise DeviceError(f"no device can be tried ({error}); see above for what to install") from error

    usable = 0
    for name in ("moderngl", "gpu"):
        try:
            device = open_device(name)
        except DeviceError as error:
            console.print(f"device {name}: not usable: {error}", highlight=False, markup=False, style="yellow")
            continue
        usable += 1
        console.print(f"device {name}: {device.description}; textures up to {device.max_texture_size_px} px", highlight=False, markup=False)
        device.close()
    if not usable:
        raise DeviceError("no device is usable; see above for what to install")
