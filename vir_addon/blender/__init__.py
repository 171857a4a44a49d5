"""The only folder that imports bpy. Registration here; what reads scenes and renders is imported when it is first used."""

from __future__ import annotations

import contextlib
from typing import Any

import bpy

from . import devices, frame_hook, frame_state, operators, panels, presets, properties, translations
from .preview import interface

CLI_COMMAND = "vir"
"""`blender --command vir render scene.blend ...` is `python -m vir_addon render scene.blend ...`"""

CLASSES = (*operators.CLASSES, *presets.CLASSES, *panels.CLASSES, *interface.CLASSES)

_registered = contextlib.ExitStack()
"""what `unregister` undoes"""


def register() -> None:
    """Called by Blender when the extension is enabled. Touches no GPU: in background that would break Blender.

    Where it fails nothing is left behind: Blender does not call `unregister` then.
    """
    with contextlib.ExitStack() as undone:
        properties.register()
        undone.callback(properties.unregister)
        for registered in CLASSES:
            bpy.utils.register_class(registered)
            undone.callback(bpy.utils.unregister_class, registered)
        devices.register()
        undone.callback(devices.unregister)
        undone.callback(frame_state.forget_all)
        bpy.utils.register_preset_path(presets.search_path())
        undone.callback(bpy.utils.unregister_preset_path, presets.search_path())
        bpy.app.handlers.load_pre.append(_forget_file)
        undone.callback(bpy.app.handlers.load_pre.remove, _forget_file)
        for part in (frame_hook, interface, translations):
            part.register()
            undone.callback(part.unregister)
        undone.callback(operators.end_modal)
        undone.callback(bpy.utils.unregister_cli_command, bpy.utils.register_cli_command(CLI_COMMAND, run_command))
        _registered.enter_context(undone.pop_all())


def unregister() -> None:
    """Called by Blender when the extension is disabled. Undoes `register` in reverse, all of it even where some fails."""
    _registered.close()


@bpy.app.handlers.persistent
def _forget_file(*_: Any) -> None:
    """Another file is about to be opened: what runs belongs to this one."""
    frame_state.forget_all()


def run_command(arguments: list[str]) -> int:
    """Run the command line with the arguments after `blender --command vir`. Returns the exit status."""
    from ..__main__ import main  # not needed until someone types the command

    return main(arguments)
