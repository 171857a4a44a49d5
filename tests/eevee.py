"""EEVEE, whatever this Blender calls it."""

from __future__ import annotations

import bpy

EEVEE_ENGINES = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")
"""since 5.0, and in 4.5"""


def choose_eevee(scene: bpy.types.Scene) -> None:
    """RuntimeError where there is none."""
    for engine in EEVEE_ENGINES:
        try:
            scene.render.engine = engine
            return
        except TypeError:
            continue
    raise RuntimeError("this Blender has no engine of that name")
