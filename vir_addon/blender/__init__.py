"""The only folder that imports bpy. Registration here; the rest is imported when it is first used."""

from __future__ import annotations

from typing import Any

import bpy

from . import properties

CLI_COMMAND = "vir"
"""`blender --command vir render scene.blend ...` is `python -m vir_addon render scene.blend ...`"""

_handles: list[Any] = []
"""what `unregister` gives back"""


def register() -> None:
    """Called by Blender when the extension is enabled. Touches no GPU: in background that would break Blender."""
    properties.register()
    _handles.append(bpy.utils.register_cli_command(CLI_COMMAND, run_command))


def unregister() -> None:
    """Called by Blender when the extension is disabled. Undoes `register` in reverse."""
    if not _handles:
        return
    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
    properties.unregister()


def run_command(arguments: list[str]) -> int:
    """Run the command line with the arguments after `blender --command vir`. Returns the exit status."""
    from ..__main__ import main  # not needed until someone types the command

    return main(arguments)
