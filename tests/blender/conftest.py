"""A clean scene for each test, and short ways to put things into it."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest


@pytest.fixture
def scene():
    """The only scene of an empty file, with a camera at (0, -10, 0) looking along +y."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, -10.0, 0.0)
    camera.rotation_euler = (np.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


@pytest.fixture
def add(scene) -> SimpleNamespace:
    """Functions that link a new object to the scene's collection (or to `collection`) and return it."""
    import bpy

    def put(name: str, data: Any, collection: Any = None, **properties: Any):
        added = bpy.data.objects.new(name, data)
        for key, value in properties.items():
            setattr(added, key, value)
        (collection or scene.collection).objects.link(added)
        return added

    def mesh(name: str, vertices, faces, collection: Any = None, **properties: Any):
        data = bpy.data.meshes.new(name)
        data.from_pydata(vertices, [], faces)
        return put(name, data, collection, **properties)

    def cube(name: str = "Cube", collection: Any = None, **properties: Any):
        return mesh(name, CUBE_VERTICES, CUBE_FACES, collection, **properties)

    def light(name: str, kind: str = "AREA", collection: Any = None, data: dict[str, Any] | None = None, **properties: Any):
        made = bpy.data.lights.new(name, kind)
        for key, value in (data or {}).items():
            setattr(made, key, value)
        return put(name, made, collection, **properties)

    def instance_of(collection, name: str = "Instancer", **properties: Any):
        return put(name, None, instance_type="COLLECTION", instance_collection=collection, **properties)

    return SimpleNamespace(object=put, mesh=mesh, cube=cube, light=light, instance_of=instance_of)


@pytest.fixture
def take(scene) -> Callable[..., Any]:
    """The snapshot of the scene as a render would show it."""
    import bpy

    from vir_addon.blender.extract import snapshot
    from vir_addon.blender.render_depsgraph import with_render_depsgraph

    def take(**arguments):
        return with_render_depsgraph(scene, bpy.context.view_layer, lambda depsgraph: snapshot(depsgraph, **arguments))

    return take


CUBE_VERTICES = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
CUBE_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
