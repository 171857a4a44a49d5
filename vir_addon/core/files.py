"""Files appear whole or not at all: a render farm must never pick up half a picture."""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import UsageError


def check_writable(folder: Path) -> None:
    """Raises UsageError when no file can be written into `folder`; makes it when it is missing. For before long work."""
    for part in (folder, *folder.parents):
        if os.path.exists(part) and not os.path.isdir(part):
            raise UsageError(f"cannot write into {folder}: {part} is not a folder. Choose another output folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"cannot write into {folder}: {error.strerror or error}. Choose another output folder or free space.") from error


def check_replaceable(target: Path) -> None:
    """Raises UsageError for what a whole file cannot take the place of: folders, and pipes and devices such as /dev/stdout.

    Those would be renamed over, which is what a user who may write into /dev gets, for all programs to come.
    """
    if os.path.isdir(target):
        raise UsageError(f"cannot write {target}: it is a folder. Name a file.")
    if os.path.exists(target) and not os.path.isfile(target):
        raise UsageError(f"cannot write {target}: it is a pipe or a device, which a whole file cannot replace. Name a file.")


@contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """Gives a temporary path in `target`'s folder, which becomes `target` when the block ends well.

    The folder is made when it is missing. When the block raises, Ctrl-C included, the temporary file goes and an older `target`
    stays as it was. Raises UsageError when the folder or the file cannot be written.
    """
    check_replaceable(target)
    # A name of its own length: a long target name leaves no room for a suffix. Same folder, as renaming works only within a disk.
    temporary = target.parent / f".vir-{os.getpid()}-{uuid.uuid4().hex[:8]}.partial"
    try:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.touch()
            yield temporary
            os.replace(temporary, target)
        except OSError as error:
            raise UsageError(f"cannot write {target}: {error.strerror or error}. Choose another output folder or free space.") from error
    finally:
        # When the folder itself is missing or is a file there is nothing to remove, and saying so would hide the cause.
        if os.path.lexists(temporary):
            temporary.unlink()
