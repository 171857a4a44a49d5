"""Objects that a scene's settings name: found again under another name, as an object that is renamed stays the one that was meant.

Files have names, which is what appending, linking and scripts understand; a pointer would keep a deleted object alive. So beside a name
stands which object of this session it means: copies of scenes and undo take it along, and to other sessions it says nothing. A full
copy of a scene has copies of its objects, under other names: objects that were meant know it, and so do their copies. A name that no
object of the scene has when it is set means whichever has it when it is asked for, until the file is saved.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence

import bpy

MEANT = "{}_meant"
"""the property beside one that names an object, by that one's name: `_mark` of the object that was meant when the name was set"""

_SESSION = secrets.token_hex(8)
"""no other has the same: a session_uid means another object there"""


def _mark(scene: bpy.types.Scene, found: bpy.types.Object | None, name: str) -> str:
    """The name as well: it may be changed without a call."""
    return "" if found is None else f"{_SESSION} {scene.session_uid} {found.session_uid} {name}"


def _meant_uids(item: bpy.types.Object) -> list[int]:
    """In `Object.vir.meant`: of the object if it was meant, and of those it is a copy of that were."""
    session, *uids = item.vir.meant.split(" ")
    return [int(uid) for uid in uids] if session == _SESSION else []


def named_object(group: bpy.types.PropertyGroup, property_name: str) -> bpy.types.Object | None:
    """The object that a property of a scene's settings names; None: none of the scene's."""
    objects, name = group.id_data.objects, getattr(group, property_name)
    found, mark = objects.get(name), getattr(group, MEANT.format(property_name))
    if not mark.startswith(f"{_SESSION} "):
        return found
    scene_uid, uid, marked_name = mark.removeprefix(f"{_SESSION} ").split(" ", 2)
    if marked_name != name or (found is not None and found.session_uid == int(uid)):
        return found
    meant = next((item for item in objects if item.session_uid == int(uid)), None)
    if meant is None and int(scene_uid) != group.id_data.session_uid:
        # set in a scene that this one is a copy of
        meant = next((item for item in objects if int(uid) in _meant_uids(item)), None)
    # where it is gone, the one that has its name now
    return found if meant is None else meant


def shown_name(group: bpy.types.PropertyGroup, property_name: str) -> str:
    """Of that object now; that in the property where there is none."""
    found = named_object(group, property_name)
    return getattr(group, property_name) if found is None else found.name


def mean_anew(group: bpy.types.PropertyGroup, property_name: str) -> None:
    """Have a property mean the object that has the name in it now, whatever it meant: for the property's update callback."""
    name = getattr(group, property_name)
    found = group.id_data.objects.get(name)
    setattr(group, MEANT.format(property_name), _mark(group.id_data, found, name))
    if found is not None and found.library is None:
        # other properties and scenes may still mean what it is a copy of, unless that is beside it
        beside = {item.session_uid for item in group.id_data.objects}
        uids = (*(uid for uid in _meant_uids(found) if uid not in beside), found.session_uid)
        found.vir.meant = " ".join((_SESSION, *map(str, uids)))


def write_names(groups: Sequence[bpy.types.PropertyGroup], property_names: Sequence[str]) -> None:
    """Into the properties, as for a file, which other sessions understand by names alone, and which objects they mean: files that were
    opened do not say. Leaves what is linked and what holds no name as it is."""
    for group in groups:
        for property_name in property_names:
            found = named_object(group, property_name)
            if found is not None and group.id_data.library is None and _is_to_write(group, property_name, found):
                setattr(group, property_name, found.name)


def _is_to_write(group: bpy.types.PropertyGroup, property_name: str, found: bpy.types.Object) -> bool:
    mark = _mark(group.id_data, found, found.name)
    return getattr(group, MEANT.format(property_name)) != mark or getattr(group, property_name) != found.name
