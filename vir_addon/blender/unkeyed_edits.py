"""Edits of animated values that nobody has keyed yet: Blender drops them whenever it evaluates a frame anew."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import bpy

Animated = tuple[bpy.types.ID, str, int]
"""datablock, path of a property in it, index into an array"""


@contextlib.contextmanager
def kept_unkeyed_edits() -> Iterator[None]:
    """Put animated values back that have changed when the block is left."""
    kept = {animated: value for animated in _animated_properties() if (value := _read(*animated)) is not None}
    try:
        yield
    finally:
        for animated, value in kept.items():
            if _read(*animated) != value:
                _write(*animated, value)


def _animated_properties() -> Iterator[Animated]:
    for owner in _datablocks():
        animation = getattr(owner, "animation_data", None)
        if animation is None:
            continue
        played = [animation, *(strip for track in animation.nla_tracks for strip in track.strips)]
        for player in played:
            if player.action is not None and player.action_slot is not None:
                for curve in _curves(player.action, player.action_slot):
                    yield owner, curve.data_path, curve.array_index


def _datablocks() -> Iterator[bpy.types.ID]:
    for name, described in bpy.data.bl_rna.properties.items():
        if described.type == "COLLECTION":
            for datablock in getattr(bpy.data, name):
                yield datablock
                if (tree := getattr(datablock, "node_tree", None)) is not None:
                    yield tree


def _curves(action: bpy.types.Action, slot: Any) -> Iterator[bpy.types.FCurve]:
    for layer in action.layers:
        for strip in layer.strips:
            if (bag := strip.channelbag(slot)) is not None:
                yield from bag.fcurves


def _read(owner: bpy.types.ID, path: str, index: int) -> Any:
    """None for a path that leads nowhere"""
    try:
        value = owner.path_resolve(path)
        return value[index] if hasattr(value, "__len__") and not isinstance(value, str) else value
    except (ValueError, IndexError, KeyError):
        return None


def _write(owner: bpy.types.ID, path: str, index: int, value: Any) -> None:
    is_custom = path.endswith('"]')
    place, _, name = path[:-2].rpartition('["') if is_custom else path.rpartition(".")
    holder = owner.path_resolve(place) if place else owner
    held = owner.path_resolve(path)
    if hasattr(held, "__len__") and not isinstance(held, str):
        held[index] = value
    elif is_custom:
        holder[bpy.utils.unescape_identifier(name)] = value
    else:
        setattr(holder, name, value)
