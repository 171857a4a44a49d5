"""Opening a .blend as a command line or a farm does: clear words when it cannot be read, no scripts of the file run."""

from __future__ import annotations

import gzip
from pathlib import Path

import bpy

from ..core.errors import SceneError, UsageError

ZSTANDARD_MAGIC = b"\x28\xb5\x2f\xfd"


def open_blend(path: Path) -> None:
    """Make `path` the open file. Raises SceneError: missing, not a .blend, damaged, or newer than this Blender."""
    if not path.is_file():
        raise SceneError(f"{path} is not there" if not path.exists() else f"{path} is a folder, not a .blend file")
    _check_header(path)
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        lines = str(error).strip().splitlines() or ["unknown reason"]
        # Blender names the file once or twice before it comes to the point
        reason = lines[0].rpartition("': ")[2].removeprefix("Error: ")
        raise SceneError(
            f"{path} cannot be opened by Blender {bpy.app.version_string}, it may be damaged or half copied: {reason}"
        ) from error
    version = tuple(bpy.data.version)
    if version[:2] > bpy.app.version[:2]:
        made_with = ".".join(map(str, version[:2]))
        raise SceneError(
            f"{path} was saved by Blender {made_with}, which is newer than this Blender {bpy.app.version_string}: "
            f"what it holds may be read wrongly. Use Blender {made_with} or save it from there for an older version"
        )


def _check_header(path: Path) -> None:
    """Blender reports 'not a blend file' and carries on with an empty scene in some versions."""
    try:
        with path.open("rb") as file:
            start = file.read(7)
        if start[:2] == b"\x1f\x8b":
            with gzip.open(path) as file:
                start = file.read(7)
    except OSError as error:
        raise SceneError(f"{path} cannot be read: {error.strerror or error}") from error
    if start != b"BLENDER" and start[:4] != ZSTANDARD_MAGIC:
        raise SceneError(f"{path} is not a .blend file")


def scene_named(name: str | None) -> bpy.types.Scene:
    """The scene of the open file that was active when it was saved, or the named one. Raises UsageError for an unknown name."""
    if name is None:
        return bpy.context.scene
    scene = bpy.data.scenes.get(name)
    if scene is None:
        raise UsageError(f"the file has no scene {name!r}; it has {', '.join(repr(scene.name) for scene in bpy.data.scenes)}")
    return scene
