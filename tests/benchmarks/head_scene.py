"""Suzanne, subdivided, on a floor under a square light of 1 m: the scene that is also rendered by Cycles."""

from __future__ import annotations

import bpy
import mathutils

MILLION_TRIANGLES_LEVEL = 5
"""Suzanne's 500 faces give 3,936 triangles at level 1 and four times as many with every further one: 1,007,616 here."""


def build_head_scene(subdivision_level: int) -> bpy.types.Scene:
    """Replaces the open file. The modifier stays a modifier, so both renderers pay for its evaluation."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_monkey_add(size=2, location=(0, 0, 1))
    head = bpy.context.object
    subdivision = head.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = subdivision_level
    for polygon in head.data.polygons:
        polygon.use_smooth = True
    bpy.ops.mesh.primitive_plane_add(size=20)

    add_key(scene)
    add_camera(scene)
    return scene


def add_key(scene: bpy.types.Scene) -> None:
    """A square light of 1 m over something of 2 m that stands at the origin."""
    light = bpy.data.lights.new("Key", "AREA")
    light.shape, light.size, light.energy = "SQUARE", 1.0, 500.0
    _place(scene, bpy.data.objects.new("Key", light), eye=(2, -2, 4), target=(0, 0, 0.8))


def add_camera(scene: bpy.types.Scene) -> None:
    camera = bpy.data.cameras.new("Camera")
    camera.lens = 50
    scene.camera = _place(scene, bpy.data.objects.new("Camera", camera), eye=(0.5, -7, 3), target=(-0.3, 0, 0.6))


def _place(scene: bpy.types.Scene, placed: bpy.types.Object, eye: tuple, target: tuple) -> bpy.types.Object:
    scene.collection.objects.link(placed)
    placed.location = eye
    placed.rotation_euler = (mathutils.Vector(target) - mathutils.Vector(eye)).to_track_quat("-Z", "Y").to_euler()
    return placed
