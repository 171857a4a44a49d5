"""Colours and numbers that sockets of shader nodes have, as the expressions of `core.material`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np

from ...core.material import (
    WHITE,
    CornerValue,
    ImageSample,
    ImageTexels,
    Layer,
    LayerKind,
    MaterialInput,
    Operation,
)
from ...core.material_program import combined, constant
from ...core.passes.material_images import texel_count_of
from .expressions import channel_sum, is_gray
from .image_cache import ImageCache
from .image_texels import MAX_SIDE_PX, UnreadableImage
from .inputs import (
    EXTENSIONS,
    NodeInput,
    UnreadableNodes,
    check_image_node,
    check_own_mapping,
    read_direction,
    read_uv,
)
from .operations import OPERATION_NODES, refuse

_MOST_NODES_DEEP = 60
"""Nodes between a socket and an image at most: what reads them calls itself."""
IMAGE_BUDGET_BYTES = 1 << 29
"""on the device, for all images of materials, and as much for those of the world"""


class ColorReader:
    """Reads each image and each node's output once."""

    def __init__(self, images: ImageCache, max_side_px: int = MAX_SIDE_PX, *, is_world: bool = False) -> None:
        """max_side_px: of images; is_world: images may be of surroundings"""
        self._cache = images
        self._max_side_px, self.is_world = max_side_px, is_world
        self._bytes_left = IMAGE_BUDGET_BYTES
        self.directions: list[np.ndarray] = []
        """(3, 3) each, what images of surroundings are looked up with"""
        self._images: dict[int, tuple[ImageTexels, ImageTexels | None] | UnreadableImage] = {}
        self._known: dict[tuple[object, ...], MaterialInput] = {}
        self._depth = 0
        self.notes: list[str] = []

    def color(self, socket: NodeInput) -> MaterialInput:
        """Raises UnreadableNodes or UnreadableImage."""
        return self._value(socket)[0]

    def number(self, socket: NodeInput) -> MaterialInput:
        """The same in all three channels."""
        value, kind = self._value(socket)
        if kind == "VALUE" or is_gray(value):
            return value
        if kind != "RGBA":
            return combined(Operation.MULTIPLY, channel_sum(value), constant(1 / 3))
        return combined(Operation.LUMINANCE, value)

    def image(self, image: bpy.types.Image) -> tuple[ImageTexels, ImageTexels | None]:
        """Colours, and alpha where it is kept apart from them."""
        address = image.as_pointer()
        if address not in self._images:
            try:
                # a share of what is left: however many there are, there is something for all; a power of two, which stays the same
                # when another image comes before
                share = 1 << max(self._bytes_left // 4, 1).bit_length() - 1
                colors, alpha, note = self._cache.colors(image, self._max_side_px, share)
            except UnreadableImage as error:
                self._images[address] = error
            else:
                self._images[address] = (colors, alpha)
                self._bytes_left -= sum(16 * texel_count_of(one) for one in (colors, alpha) if one is not None)
                self.notes += [note] * bool(note)
        found = self._images[address]
        if isinstance(found, UnreadableImage):
            raise found
        return found

    def _value(self, socket: NodeInput) -> tuple[MaterialInput, str]:
        """The value and the type of the socket that makes it: VALUE, RGBA or another."""
        node, output, here = socket.source()
        if node is None:
            value = here.socket.default_value
            return constant(*([value] if isinstance(value, (int, float)) else value[:3])), here.socket.type
        kind = next((out.type for out in node.outputs if out.identifier == output), "RGBA")
        key = (node.as_pointer(), output, *(group.as_pointer() for group in here.groups))
        if key not in self._known:
            if self._depth >= _MOST_NODES_DEEP:
                raise UnreadableNodes(f"more than {_MOST_NODES_DEEP} nodes one behind the other, or links that go in a circle")
            self._depth += 1
            try:
                self._known[key] = self._computed(node, output, here)
            finally:
                self._depth -= 1
        return self._known[key], kind

    def _computed(self, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
        read = _NODES.get(node.type)
        if read is None:
            raise UnreadableNodes(f"the node '{node.name}'")
        return read(self, node, output, here)

    def named(self, node: bpy.types.Node, here: NodeInput, *identifiers: str) -> list[MaterialInput]:
        """The colours of a node's inputs."""
        return [self.color(here.of(node, identifier)) for identifier in identifiers]

    def numbers(self, node: bpy.types.Node, here: NodeInput, *identifiers: str) -> list[MaterialInput]:
        return [self.number(here.of(node, identifier)) for identifier in identifiers]


# nodes


def _constant_output(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    value = next(out.default_value for out in node.outputs if out.identifier == output)
    return constant(*([value] if isinstance(value, (int, float)) else value[:3]))


def _image(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    check_image_node(node)
    uv_map, uv_rows = read_uv(here.of(node, "Vector"))
    colors, apart = reader.image(node.image)
    sample = ImageSample(colors, Layer(LayerKind.UV, uv_map or ""), uv_rows, EXTENSIONS[node.extension], node.interpolation != "Closest")
    if output == "Alpha":
        if apart is not None:
            return replace(sample, image=apart)
        return replace(sample, is_alpha=True) if colors.texels.shape[2] == 4 else WHITE
    # renderers hand out colours multiplied with alpha where only the colour is asked for
    return replace(sample, divides_by_alpha=colors.texels.shape[2] == 4 and node.outputs["Alpha"].is_linked)


def _environment(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if not reader.is_world:
        raise UnreadableNodes(f"the node '{node.name}'")
    if node.image is None:
        raise UnreadableNodes(f"the node '{node.name}', which has no image")
    if node.projection != "EQUIRECTANGULAR":
        raise refuse(node, "projection")
    check_own_mapping(node)
    reader.directions.append(read_direction(here.of(node, "Vector")))
    return ImageSample(reader.image(node.image)[0], is_interpolated=node.interpolation != "Closest")


def _coordinates(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    kinds = {"UV": LayerKind.UV, "Generated": LayerKind.GENERATED}
    if output not in kinds or node.from_instancer:
        raise UnreadableNodes(f"coordinates of the node '{node.name}'")
    return CornerValue(Layer(kinds[output]))


def _uv_map(_: ColorReader, node: bpy.types.Node, __: str, ___: NodeInput) -> MaterialInput:
    if node.from_instancer:
        raise UnreadableNodes(f"coordinates of the node '{node.name}'")
    return CornerValue(Layer(LayerKind.UV, node.uv_map))


def _vertex_color(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    if output != "Color":
        raise refuse(node, "alpha")
    return CornerValue(Layer(LayerKind.COLOR, node.layer_name))


def _attribute(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    if node.attribute_type != "GEOMETRY" or output == "Alpha":
        raise UnreadableNodes(f"what the node '{node.name}' reads")
    value = CornerValue(Layer(LayerKind.COLOR, node.attribute_name))
    return value if output != "Fac" else combined(Operation.MULTIPLY, channel_sum(value), constant(1 / 3))


_NODES: dict[str, Callable[[ColorReader, bpy.types.Node, str, NodeInput], MaterialInput]] = {
    **OPERATION_NODES,
    "RGB": _constant_output,
    "VALUE": _constant_output,
    "TEX_IMAGE": _image,
    "TEX_ENVIRONMENT": _environment,
    "TEX_COORD": _coordinates,
    "UVMAP": _uv_map,
    "VERTEX_COLOR": _vertex_color,
    "ATTRIBUTE": _attribute,
}
