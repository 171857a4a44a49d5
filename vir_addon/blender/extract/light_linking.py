"""Light linking and shadow linking as Cycles and EEVEE evaluate them.

A light may have a collection of receivers and one of blockers. Each entry of the collection, object or child collection, says INCLUDE or
EXCLUDE; a child collection's word holds for all objects in it, nested ones too. If anything is included, only that counts; otherwise
everything that is not excluded. A collection without objects says nothing.

An instance is looked up under its instancer, if that is named in any receiver (or blocker) collection of the scene, and otherwise under
the instanced object. The collections of a light inside an instance are those of the light object; its instancer does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

INCLUDE = "INCLUDE"


@dataclass
class Linking:
    """All receiver, or all blocker, collections of a scene."""

    state_of_object: dict[int, dict[int, str]] = field(default_factory=dict)
    """session_uid of the light object -> session_uid of a linked object -> INCLUDE or EXCLUDE"""
    named: set[int] = field(default_factory=set)
    """session_uid of every object that any of the collections holds"""

    def add(self, light_uid: int, collection: bpy.types.Collection | None) -> None:
        if collection is None:
            return
        states: dict[int, str] = {}
        for child, entry in zip(collection.children, collection.collection_children, strict=True):
            for linked in child.all_objects:
                states[linked.session_uid] = entry.light_linking.link_state
        # After the children: where an object is named twice, Blender lets its own entry win.
        for linked, entry in zip(collection.objects, collection.collection_objects, strict=True):
            states[linked.session_uid] = entry.light_linking.link_state
        self.named.update(states)
        if states:
            self.state_of_object[light_uid] = states

    def joined(self, other: Linking) -> Linking:
        return Linking(self.state_of_object | other.state_of_object, self.named | other.named)

    def mask(self, light_uid: int, object_uid: np.ndarray, instancer_uid: np.ndarray) -> np.ndarray | None:
        """(instance_count,) bool: which instances the light's collection lets through; None: all, there is no collection.

        object_uid, instancer_uid: (instance_count,) int64; the object itself where nothing instances it.
        """
        states = self.state_of_object.get(light_uid)
        if states is None:
            return None
        looked_up = np.where(np.isin(instancer_uid, list(self.named)), instancer_uid, object_uid)
        included = [uid for uid, state in states.items() if state == INCLUDE]
        excluded = [uid for uid, state in states.items() if state != INCLUDE]
        allowed = np.isin(looked_up, included) if included else np.ones(len(looked_up), dtype=bool)
        return allowed & ~np.isin(looked_up, excluded)


@dataclass
class SceneLinking:
    """Of a scene's lights, and of meshes that may emit: their collections decide who is looked up how."""

    receivers: Linking = field(default_factory=Linking)
    blockers: Linking = field(default_factory=Linking)

    def add(self, emitter: bpy.types.Object) -> None:
        original = emitter.original
        self.receivers.add(original.session_uid, original.light_linking.receiver_collection)
        self.blockers.add(original.session_uid, original.light_linking.blocker_collection)

    def joined(self, other: SceneLinking) -> SceneLinking:
        return SceneLinking(self.receivers.joined(other.receivers), self.blockers.joined(other.blockers))
