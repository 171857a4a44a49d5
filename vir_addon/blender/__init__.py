"""The only folder that imports bpy. Registration here; what reads scenes and renders is imported when it is first used."""

from __future__ import annotations

from typing import Any

import bpy

from . import devices, frame_hook, frame_state, operators, panels, presets, properties, translations
from .preview import interface

CLI_COMMAND = "vir"
"""`blender --command vir render scene.blend ...` is `python -m vir_addon render scene.blend ...`"""

CLASSES = (*operators.CLASSES, *presets.CLASSES, *panels.CLASSES, *interface.CLASSES)

_handles: list[Any] = []
"""what `unregister` gives back"""


def register() -> None:
    """Called by Blender when the extension is enabled. Touches no GPU: in background that would break Blender."""
    properties.register()
    for registered in CLASSES:
        bpy.utils.register_class(registered)
    bpy.utils.register_preset_path(presets.search_path())
    bpy.app.handlers.load_pre.append(_forget_file)
    devices.register()
    frame_hook.register()
    interface.register()
    translations.register()
    _handles.append(bpy.utils.register_cli_command(CLI_COMMAND, run_command))


def unregister() -> None:
    """Called by Blender when the extension is disabled. Undoes `register` in reverse."""
    if not _handles:
        return
    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
    operators.end_modal()
    translations.unregister()
    interface.unregister()
    frame_hook.unregister()
    bpy.app.handlers.load_pre.remove(_forget_file)
    bpy.utils.unregister_preset_path(presets.search_path())
    frame_state.forget_all()
    devices.unregister()
    for registered in reversed(CLASSES):
        bpy.utils.unregister_class(registered)
    properties.unregister()


@bpy.app.handlers.persistent
def _forget_file(*_: Any) -> None:
    """Another file is about to be opened: what runs belongs to this one."""
    frame_state.forget_all()


def run_command(arguments: list[str]) -> int:
    """Run the command line with the arguments after `blender --command vir`. Returns the exit status."""
    from ..__main__ import main  # not needed until someone types the command

    return main(arguments)
