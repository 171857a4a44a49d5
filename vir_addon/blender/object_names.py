"""Objects that a scene's settings name: found again under another name, as an object that is renamed stays the one that was meant.

Files have names, which is what appending, linking and scripts understand; a pointer would keep a deleted object alive. So which object a
name meant is remembered while Blender runs, from when it was last asked for.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy

_meant: dict[tuple[int, str], tuple[str, int]] = {}
"""session_uid of a scene and name of a property -> the name in it, session_uid of the object or 0 if none had it when it was set"""


def named_object(group: bpy.types.PropertyGroup, property_name: str) -> bpy.types.Object | None:
    """The object that a property of a scene's settings names; None: none of the scene's."""
    objects, name = group.id_data.objects, getattr(group, property_name)
    found, key = objects.get(name), (group.id_data.session_uid, property_name)
    known_name, uid = _meant.get(key) or _meant_by_others(property_name, name)
    if uid and known_name == name and (found is None or found.session_uid != uid):
        found = next((item for item in objects if item.session_uid == uid), found)
    if found is not None:
        _meant[key] = name, found.session_uid
    return found


def _meant_by_others(property_name: str, name: str) -> tuple[str, int]:
    """A scene that has never been asked may be a copy of one that has: it has the name from there, and objects as well."""
    return next((meant for (_, other), meant in _meant.items() if other == property_name and meant[0] == name), ("", 0))


def shown_name(group: bpy.types.PropertyGroup, property_name: str) -> str:
    """Of that object now; that in the property where there is none."""
    found = named_object(group, property_name)
    return getattr(group, property_name) if found is None else found.name


def name_object(group: bpy.types.PropertyGroup, property_name: str, name: str) -> None:
    """Have a property mean the object that has a name now."""
    setattr(group, property_name, name)
    mean_anew(group, property_name)


def mean_anew(group: bpy.types.PropertyGroup, property_name: str) -> None:
    """Have a property mean the object that has the name in it now, whatever it meant: it has been set."""
    name = getattr(group, property_name)
    found = group.id_data.objects.get(name)
    _meant[group.id_data.session_uid, property_name] = name, 0 if found is None else found.session_uid


def write_names(groups: Sequence[bpy.types.PropertyGroup], property_names: Sequence[str]) -> None:
    """Into the properties, as for a file, which knows nothing of what is remembered here; asks for all, so that all is remembered."""
    for group in groups:
        for property_name in property_names:
            name = shown_name(group, property_name)
            if name != getattr(group, property_name) and group.id_data.library is None:
                name_object(group, property_name, name)


def forget() -> None:
    _meant.clear()
