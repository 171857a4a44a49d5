"""A model of any file on a floor under a square light, seen from a little above: what the benches do with `--model`."""

from __future__ import annotations

import gzip
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from vir_addon.blender.open_file import open_blend

from .head_scene import add_camera, add_key

HEIGHT_M = 2.0
IMPORTERS: dict[str, Callable[[str], object]] = {
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y"),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
}


def open_model(path: Path) -> bpy.types.Scene:
    """Replaces the open file. A .blend with a camera and a light is taken as it is, anything else is scaled to a height of 2 m."""
    if path.suffix == ".blend":
        open_blend(path)
        return bpy.context.scene
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder:
        if path.suffix == ".gz":
            unpacked = Path(folder) / path.stem
            with gzip.open(path) as packed, unpacked.open("wb") as target:
                shutil.copyfileobj(packed, target)
            path = unpacked
        if path.suffix.lower() not in IMPORTERS:
            raise SystemExit(f"--model takes .blend, {', '.join(IMPORTERS)}, also with .gz behind, not {path.name}")
        IMPORTERS[path.suffix.lower()](str(path.resolve()))
    scene = bpy.context.scene
    for thing in [thing for thing in scene.objects if thing.type in ("LIGHT", "CAMERA")]:
        bpy.data.objects.remove(thing)
    _stand_on_floor(scene)
    bpy.ops.mesh.primitive_plane_add(size=20)
    add_key(scene)
    add_camera(scene)
    return scene


def _stand_on_floor(scene: bpy.types.Scene) -> None:
    """2 m high, or as wide as that is not too wide, its middle over the origin."""
    bpy.context.view_layer.update()
    surfaces = [thing for thing in scene.objects if thing.type == "MESH"]
    if not surfaces:
        raise SystemExit("the model has no mesh")
    corners = np.array([thing.matrix_world @ Vector(corner) for thing in surfaces for corner in thing.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = HEIGHT_M / max(high[2] - low[2], (high - low)[:2].max() / 1.5)
    holder = bpy.data.objects.new("Model", None)
    scene.collection.objects.link(holder)
    for thing in scene.objects:
        if thing.parent is None and thing is not holder:
            thing.parent = holder
    holder.scale = (scale,) * 3
    holder.location = (*(-scale * (low + high)[:2] / 2), -scale * low[2])
