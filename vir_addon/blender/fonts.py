"""Blender's own fonts, for text that may hold any light's name."""

from __future__ import annotations

from pathlib import Path

import bpy


def find_label_font() -> Path | None:
    """The font with most scripts (Latin with accents, Greek, Cyrillic, Chinese, Japanese, Korean); None if this Blender lacks it."""
    path = Path(bpy.utils.system_resource("DATAFILES", path="fonts")) / "Noto Sans CJK Regular.woff2"
    return path if path.is_file() else None
