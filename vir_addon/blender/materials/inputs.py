"""Walking through Blender's node trees: what a socket gets its value from, and where on a surface an image is looked up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import bpy
import mathutils
import numpy as np

from ...core.material import IDENTITY_UV_ROWS, Extension, UvRows

EXTENSIONS = {kind.name: kind for kind in Extension}
"""of image nodes"""


class UnreadableNodes(Exception):  # noqa: N818  a reason, caught where materials are read
    """The text says what of the nodes is not understood, as in 'its opacity depends on ...'."""


def slot_materials(shown: bpy.types.Object, override: bpy.types.Material | None) -> list[bpy.types.Material | None]:
    """What an evaluated object has in its material slots. override: of the view layer, takes the place of every material."""
    slots = shown.material_slots
    materials = []
    for index, own in enumerate(shown.data.materials):
        is_objects = index < len(slots) and slots[index].link == "OBJECT"
        materials.append(override or (slots[index].material if is_objects else own))
    return materials


def output_target(engine: str) -> str:
    """Which output nodes a render engine looks at."""
    return "CYCLES" if engine == "CYCLES" else "EEVEE"


def output_node(material: bpy.types.Material, target: str) -> bpy.types.Node | None:
    if material.node_tree is None or (bpy.app.version < (5, 0) and not material.use_nodes):
        return None
    return material.node_tree.get_output_node(target)


@dataclass(frozen=True)
class NodeInput:
    """An input socket, and the group nodes that it lies in."""

    socket: bpy.types.NodeSocket
    groups: tuple[bpy.types.Node, ...] = ()

    def of(self, node: bpy.types.Node, identifier: str) -> NodeInput:
        return replace(self, socket=by_identifier(node.inputs, identifier))

    def source(self) -> tuple[bpy.types.Node | None, str, NodeInput]:
        """The node that makes the value, the identifier of its output, and an input as deep in groups as the node; without a node the
        input itself has the value."""
        here = self
        for _ in range(_MAX_LINKS):
            unmuted = [link for link in here.socket.links if not link.is_muted]
            links = [link for link in unmuted if link.is_valid]
            if not links:
                if any(_is_in_circle(link) for link in unmuted):
                    raise UnreadableNodes(_CIRCLE)
                return None, "", here
            node, output = links[0].from_node, links[0].from_socket
            if node.mute:
                through = [link.from_socket for link in node.internal_links if link.to_socket == output]
                if not through:
                    raise UnreadableNodes(f"the muted node '{node.name}'")
                here = replace(here, socket=through[0])
            elif node.type == "REROUTE":
                here = replace(here, socket=node.inputs[0])
            elif node.type == "GROUP" and node.node_tree is not None:
                ends = [end for end in node.node_tree.nodes if end.type == "GROUP_OUTPUT" and end.is_active_output]
                if not ends:
                    raise UnreadableNodes(f"the group '{node.name}', which has no output")
                here = NodeInput(by_identifier(ends[0].inputs, output.identifier), (*here.groups, node))
            elif node.type == "GROUP_INPUT" and here.groups:
                here = NodeInput(by_identifier(here.groups[-1].inputs, output.identifier), here.groups[:-1])
            else:
                return node, output.identifier, here
        raise UnreadableNodes(_CIRCLE)


_MAX_LINKS = 1000
"""reroutes and groups that a link may go through"""
_CIRCLE = "links that go in a circle"


def _is_in_circle(link: bpy.types.NodeLink) -> bool:
    """Whether the link's end is among what its start comes from. One link of a circle is not valid, but
    Cycles does not read the rest as if that were not there: it shows black."""
    reached, waiting = set(), [link.from_node]
    while waiting:
        node = waiting.pop()
        if node == link.to_node:
            return True
        if node.name not in reached:
            reached.add(node.name)
            waiting += [each.from_node for socket in node.inputs for each in socket.links]
    return False


def by_identifier(sockets: bpy.types.NodeInputs, identifier: str) -> bpy.types.NodeSocket:
    found = next((socket for socket in sockets if socket.identifier == identifier), None)
    if found is None:
        raise UnreadableNodes(f"a socket '{identifier}' that is not there")
    return found


def check_image_node(node: bpy.types.Node) -> None:
    """Raises UnreadableNodes unless the node looks a flat image up where it is told to."""
    if node.image is None:
        raise UnreadableNodes(f"the node '{node.name}', which has no image")
    if node.projection != "FLAT":
        raise UnreadableNodes(f"the projection of the node '{node.name}'")
    check_own_mapping(node)


def check_own_mapping(node: bpy.types.Node) -> None:
    own = node.texture_mapping
    if (*own.translation, *own.rotation, *own.scale) != (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0):
        raise UnreadableNodes(f"the node '{node.name}', which maps coordinates itself")


def read_uv(vector: NodeInput) -> tuple[str | None, UvRows]:
    """Name of the UV map, None for the default one, and what maps its (u, v, 1) to a place in the image."""
    node, output, matrix = _mapped_source(vector)
    if node is None:
        return None, IDENTITY_UV_ROWS
    rows = tuple((matrix[row][0], matrix[row][1], matrix[row][3]) for row in range(2))
    if node.type == "UVMAP" and not node.from_instancer:
        return node.uv_map or None, rows  # type: ignore[return-value]
    if node.type == "TEX_COORD" and output == "UV" and not node.from_instancer:
        return None, rows  # type: ignore[return-value]
    if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY" and output == "Vector":
        return node.attribute_name, rows  # type: ignore[return-value]
    raise UnreadableNodes(f"coordinates of the node '{node.name}'")


def read_direction(vector: NodeInput) -> np.ndarray:
    """(3, 3) float64: what is looked up in an image of the surroundings = matrix @ direction."""
    node, output, matrix = _mapped_source(vector)
    if node is not None and not (node.type == "TEX_COORD" and output == "Generated"):
        raise UnreadableNodes(f"coordinates of the node '{node.name}'")
    if matrix.translation.length > 0.0:
        raise UnreadableNodes("directions that are moved")
    return np.array(matrix.to_3x3())


def _mapped_source(vector: NodeInput) -> tuple[bpy.types.Node | None, str, mathutils.Matrix]:
    """What coordinates come from, None for nothing, and what the Mapping nodes on the way make of them."""
    matrix = mathutils.Matrix.Identity(4)
    for _ in range(_MAX_LINKS):
        node, output, here = vector.source()
        if node is None or node.type != "MAPPING":
            return node, output, matrix
        matrix = matrix @ mapping_matrix(node, here)
        vector = here.of(node, "Vector")
        if vector.source()[0] is None:
            raise UnreadableNodes(f"the node '{node.name}', which maps nothing")
    raise UnreadableNodes(_CIRCLE)


def mapping_matrix(node: bpy.types.Node, here: NodeInput) -> mathutils.Matrix:
    if node.vector_type == "NORMAL":
        raise UnreadableNodes(f"the node '{node.name}', which maps normals")
    values = {}
    for name in ("Rotation", "Scale", "Location"):
        if name == "Location" and node.vector_type == "VECTOR":
            values[name] = (0.0, 0.0, 0.0)
            continue
        source, _, end = here.of(node, name).source()
        if source is not None:
            raise UnreadableNodes(f"what is linked to the node '{node.name}'")
        values[name] = tuple(end.socket.default_value)
    matrix = mathutils.Matrix.LocRotScale(values["Location"], mathutils.Euler(values["Rotation"]), values["Scale"])
    if node.vector_type != "TEXTURE":
        return matrix
    if any(math.isclose(factor, 0.0) for factor in values["Scale"]):
        raise UnreadableNodes(f"the node '{node.name}', whose scale is zero")
    return matrix.inverted()
