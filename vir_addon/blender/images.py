"""Passes as float images in the .blend file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import bpy
import numpy as np

from ..core.pass_set import REFLECTION_PASS_NAME, PassSet, layer_pass_names

PASS_PROPERTY = "vir_pass"
"""custom property with the pass's name; what marks an image as made here"""
SCENE_PROPERTY = "vir_scene"
"""custom property with the full name of the scene that the pass is of: of linked scenes with that of their file"""
LAYER_PROPERTY = "vir_layer"
"""custom property with the name of the view layer that the pass is of; empty for the first one, whose passes carry no layer's name"""

IMAGES_PROPERTY = "vir_images"
"""custom property of a scene, which points at its images: names and marks of images that come from another file may be the same"""
RECORDED_PROPERTY = "vir_recorded"
"""custom property of an image that a scene points at. Without it an image is of a linked scene, or of before scenes did; it is known by its
scene's name"""

MISSING_COLOR = (1.0, 0.0, 1.0)
"""what Blender shows where a texture is missing"""


def write_images(passes: PassSet, *, pack: bool = True, scene_name: str = "", layer_name: str | None = None) -> dict[str, bpy.types.Image]:
    """Write every pass into an image of its name ("VIR Shadow Key"): float, Non-Color, grey or linear RGB. Returns pass name -> image.

    An image that an earlier call made for the pass is filled again, resized where needed, so nodes keep pointing at it. An
    artist's image that happens to have the name is left alone; ours then gets a number from Blender. `pack` puts the pixels into the
    .blend (Blender drops unsaved pixels of generated images on saving); without it this is fast enough for every frame.

    scene_name: the full one; passes of other scenes keep their images. layer_name: of view layers after the first, whose passes get it in
    their names ("VIR Shadow Key (Foreground)"), here and in what is returned.
    """
    names = layer_pass_names(passes.images, layer_name)
    scene = _recording_scene(scene_name)
    if scene is None or IMAGES_PROPERTY not in scene:
        _follow_renamed_scene(scene_name, names.values())
    own = [image for image in scene_images(scene_name).values() if scene is not None and _is_of(image, scene)]
    written = {names[name]: _write_image(names[name], scene_name, layer_name, pixels, pack) for name, pixels in passes.images.items()}
    if scene is not None:
        _record(scene, [*own, *written.values()])
    return written


def layer_images(passes_of_layers: Mapping[str, PassSet], scene_name: str, *, pack: bool = True) -> dict[str, bpy.types.Image]:
    """`write_images` of all view layers of a scene, in the order in which Blender renders them."""
    images = {}
    for index, (layer_name, passes) in enumerate(passes_of_layers.items()):
        images.update(write_images(passes, pack=pack, scene_name=scene_name, layer_name=layer_name if index else None))
    return images


def fill_unmade(
    passes: PassSet, scene: bpy.types.Scene, layer_name: str, *, is_first: bool, pack: bool = True
) -> dict[str, bpy.types.Image]:
    """Fill the view layer's images of passes that are not among those made now, to be called after `write_images`: white, and reflections,
    which are added, black. A light that is hidden, deleted or called otherwise in this frame must not show its shadow of another, nor a
    view layer that is. Returns what was filled, pass name -> image.

    is_first: of the rendered layers; its passes carry no layer's name, so images that do are of when it was not, or of one that is gone.
    """
    made = set(layer_pass_names(passes.images, None if is_first else layer_name).values())
    others = {layer.name for layer in scene.view_layers} - {layer_name}
    height, width = next(iter(passes.images.values())).shape[:2]
    filled = {}
    for pass_name, image in scene_images(scene.name_full).items():
        of_layer = _layer_of(image)
        is_own = of_layer is not None and (of_layer not in others if is_first else of_layer == layer_name)
        if pass_name not in made and is_own and image.get(SCENE_PROPERTY) == scene.name_full:
            value = 0.0 if pass_name.startswith(REFLECTION_PASS_NAME) else 1.0
            _fill_image(image, np.full((height, width), value, np.float32), pack)
            filled[pass_name] = image
    return filled


def find_image(pass_name: str, scene_name: str = "") -> bpy.types.Image | None:
    """The image made here for the pass of the scene: of those that the scene points at.

    Scenes that cannot, or do not yet, know theirs by the scene's name; of several (an artist's copies carry the marks too) by the pass's
    name. An image whose scene is no more, or has another name now, is taken where the scene has none of its own.
    """
    ours = [image for image in _own_images(scene_name) if image.get(PASS_PROPERTY) == pass_name]
    return min(ours, key=lambda image: (image.get(SCENE_PROPERTY) != scene_name, image.name != pass_name, image.name), default=None)


def scene_images(scene_name: str) -> dict[str, bpy.types.Image]:
    """Pass name -> image, of all passes that the scene has images of, by name."""
    found = {name: find_image(name, scene_name) for name in sorted({image[PASS_PROPERTY] for image in _own_images(scene_name)})}
    return {name: image for name, image in found.items() if image is not None}


def is_used(image: bpy.types.Image) -> bool:
    """Whether anything shows it: not the scene that points at it to know it as its own."""
    return image.users - image.use_fake_user > sum(image in _recorded(scene) for scene in bpy.data.scenes)


def mark_missing(scene_name: str) -> None:
    """Fill the scene's images with the colour of what is missing: a frame whose passes failed must not show those of another."""
    for image in scene_images(scene_name).values():
        rgba = np.ones((image.size[0] * image.size[1], image.channels), np.float32)
        rgba[:, :3] = MISSING_COLOR
        image.pixels.foreach_set(rgba.ravel())
        image.update()


@bpy.app.handlers.persistent
def pack_unsaved(*_: Any) -> None:
    """Blender's handler, before a file is saved: images of frames are not packed one by one, and would be saved as they were before."""
    for image in bpy.data.images:
        if image.library is None and image.get(PASS_PROPERTY) and image.is_dirty:
            image.pack()


def _recording_scene(scene_name: str) -> bpy.types.Scene | None:
    """The scene, unless it is of another file and cannot be written."""
    return next((scene for scene in bpy.data.scenes if scene.name_full == scene_name and scene.is_editable), None)


def _recorded(scene: bpy.types.Scene) -> list[bpy.types.Image]:
    """Without those that were deleted since."""
    images = scene.get(IMAGES_PROPERTY, {}).values()
    return [image for image in images if image is not None]


def _record(scene: bpy.types.Scene, images: Iterable[bpy.types.Image]) -> None:
    """Also under which name the scene has them now, which tells it from its copies."""
    images = list(dict.fromkeys(images))
    for image in images:
        if not image.get(RECORDED_PROPERTY) or image.get(SCENE_PROPERTY) != scene.name_full:
            image[RECORDED_PROPERTY], image[SCENE_PROPERTY] = True, scene.name_full
    if set(images) != set(_recorded(scene)):
        scene[IMAGES_PROPERTY] = {str(number): image for number, image in enumerate(images)}


def _own_images(scene_name: str) -> list[bpy.types.Image]:
    ours = [image for image in bpy.data.images if image.library is None and image.get(PASS_PROPERTY)]
    scene = _recording_scene(scene_name)
    if scene is not None and IMAGES_PROPERTY in scene:
        recorded = set(_recorded(scene))
        return [image for image in ours if image in recorded and _is_of(image, scene)]
    others = {scene.name_full for scene in bpy.data.scenes if scene.name_full != scene_name}
    return [image for image in ours if not image.get(RECORDED_PROPERTY) and image.get(SCENE_PROPERTY, "") not in others]


def _is_of(image: bpy.types.Image, scene: bpy.types.Scene) -> bool:
    """Of an image that the scene points at, or of before it did. Copies of a scene point at the other's, whose name they have."""
    if image.get(SCENE_PROPERTY) == scene.name_full:
        return True
    others = (other for other in bpy.data.scenes if other != scene and other.library is None)
    return image in _recorded(scene) and not any(image in _recorded(other) for other in others)


def _follow_renamed_scene(scene_name: str, pass_names: Iterable[str]) -> None:
    """Images of a scene that has another name now are its own, also those of passes that are not made any more. One that has images of its
    own has not been renamed since; others were of scenes that are gone. For scenes that do not point at theirs."""
    ours = [image for image in bpy.data.images if image.library is None and image.get(PASS_PROPERTY) and not image.get(RECORDED_PROPERTY)]
    if any(image.get(SCENE_PROPERTY) == scene_name for image in ours):
        return
    taken = next((found for name in pass_names if (found := find_image(name, scene_name)) is not None), None)
    if taken is not None:
        before = taken.get(SCENE_PROPERTY)
        for image in ours:
            if image.get(SCENE_PROPERTY) == before:
                image[SCENE_PROPERTY] = scene_name


def _layer_of(image: bpy.types.Image) -> str | None:
    """None: not known. Files of before passes told their layer know it by the name alone."""
    return image.get(LAYER_PROPERTY, None if image[PASS_PROPERTY].endswith(")") else "")


def _write_image(pass_name: str, scene_name: str, layer_name: str | None, pixels: np.ndarray, pack: bool) -> bpy.types.Image:
    height, width = pixels.shape[:2]
    image = find_image(pass_name, scene_name) or _new_image(pass_name, width, height)
    image[SCENE_PROPERTY], image[LAYER_PROPERTY] = scene_name, layer_name or ""
    _fill_image(image, pixels, pack)
    return image


def _fill_image(image: bpy.types.Image, pixels: np.ndarray, pack: bool) -> None:
    height, width = pixels.shape[:2]
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    rgba = np.ones((height, width, image.channels), dtype=np.float32)
    rgba[..., :3] = pixels.reshape(height, width, -1)
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    if pack:
        image.pack()


def _new_image(pass_name: str, width: int, height: int) -> bpy.types.Image:
    image = bpy.data.images.new(pass_name, width, height, alpha=False, float_buffer=True, is_data=True)
    image[PASS_PROPERTY] = pass_name
    image.use_fake_user = True  # else saving drops it until a node uses it
    return image
