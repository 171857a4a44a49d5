"""What drivers raise when graphics are lost, in words for whoever renders."""

from __future__ import annotations

import traceback
from pathlib import Path

from ..core.errors import DeviceError

_PACKAGE = Path(__file__).parent.parent
_DRIVER_ERRORS = {("builtins", "RuntimeError"), ("builtins", "Exception")}
"""that Blender and glcontext raise; moderngl has its own"""


def as_told(error: BaseException) -> BaseException:
    """A DeviceError for what a driver raised when it was called, with the error as its cause; any other error as it is.

    Drivers' errors have no types that tell them: what was raised within this folder is of a driver, and a mistake of ours that shows as
    one of these types elsewhere stays one.
    """
    kind = type(error)
    is_drivers = (kind.__module__, kind.__name__) in _DRIVER_ERRORS or kind.__module__.partition(".")[0] in ("moderngl", "glcontext")
    files = [Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)]
    ours = [file for file in files if file.is_relative_to(_PACKAGE)]
    if not is_drivers or not ours or ours[-1].parent != Path(__file__).parent:
        return error
    told = DeviceError(
        f"the graphics device failed or was lost ({error or kind.__name__}): render again, and if that fails too, restart Blender "
        "and choose less views or smaller maps"
    )
    told.__cause__ = error
    return told
