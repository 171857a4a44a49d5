"""The node group "VIR Passes" in a scene's compositor: every pass as an output socket, and a picture with its reflections; the artist's own
nodes untouched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import bpy

from ..core.errors import SceneError
from ..core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME, layer_pass_names
from .images import LAYER_PROPERTY, PASS_PROPERTY, SCENE_PROPERTY

GROUP_NAME = "VIR Passes"
GROUP_PROPERTY = "vir_passes"
"""custom property that marks the node group as made here, whatever an artist renames it to"""
SUM_PROPERTY = "vir_sum"
"""custom property of the nodes that add reflections to a picture: the name of their output"""
WITHOUT_REFLECTIONS, WITH_REFLECTIONS = "Without Reflections", "With Reflections"
"""input and output of the group, where there are reflections"""
BLACK = (0.0, 0.0, 0.0, 1.0)
NODE_GAP_PX = 60.0
OTHERS_PASSES = (
    "The compositor's node VIR Passes belongs to another .blend file and shows the passes that were saved there: "
    "make the compositor and the node's group local, then press Render Passes"
)
"""what a user is told where `shows_others_passes`"""


@dataclass
class PassNodes:
    """What `add_pass_nodes` left in the scene."""

    node: bpy.types.Node
    """the group node"""
    added: list[str] = field(default_factory=list)
    """passes, and sums with them, that got an output"""
    removed: list[str] = field(default_factory=list)
    """outputs of passes, and sums with them, that are gone and were linked to nothing"""
    kept: list[str] = field(default_factory=list)
    """outputs of passes that are gone but still linked: they give what `images.fill_unmade` writes"""
    is_switched_off: bool = False
    """4.5: the scene has compositor nodes but "Use Nodes" is off; switching it on would change the artist's render"""


def add_pass_nodes(scene: bpy.types.Scene, images: Mapping[str, bpy.types.Image]) -> PassNodes:
    """Give every image (pass name -> image) an output on the scene's group node "VIR Passes".

    A compositor is made when the scene has none, with the render passed through. Where images have both passes of a view layer's
    reflections, the group also adds their product to what is linked to its input "Without Reflections". On a group that exists, outputs
    are matched by name: missing ones are added, links stay, and outputs whose pass is gone are removed unless something is linked to them.
    What an artist put between an image and its output inside the group stays too.
    Raises SceneError when the compositor belongs to another .blend file.
    """
    tree = _made_compositor_tree(scene)
    result = PassNodes(_find_group_node(tree) or _new_group_node(tree))
    result.is_switched_off = not bpy.app.version >= (5, 0) and not scene.use_nodes
    _check_editable(result.node.node_tree)
    group = _own_group(scene, tree, result.node)
    _drop_gone_passes(group, images, result)
    output = _group_output(group)
    for row, (pass_name, image) in enumerate(images.items()):
        if _output_socket(group, pass_name) is None:
            group.interface.new_socket(name=pass_name, in_out="OUTPUT", socket_type="NodeSocketColor")
            result.added.append(pass_name)
        node = _image_node(group, pass_name) or _new_image_node(group, pass_name, row)
        node.image = image
        if not output.inputs[pass_name].is_linked:
            group.links.new(node.outputs["Image"], output.inputs[pass_name])
    for each in _sums_of(images):
        _add_sum(group, each, result)
    return result


def has_pass_nodes(scene: bpy.types.Scene) -> bool:
    """Whether the scene's compositor has the group already."""
    tree = compositor_tree(scene)
    return tree is not None and _find_group_node(tree) is not None


def shows_others_passes(scene: bpy.types.Scene) -> bool:
    """Whether its compositor has a group of another .blend file, and so the passes that were saved there."""
    tree = compositor_tree(scene)
    node = None if tree is None else _find_group_node(tree)
    return node is not None and not node.node_tree.is_editable


def compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """What Blender would run after a render; None where the scene has no compositor, or (4.5) does not use it."""
    if bpy.app.version >= (5, 0):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def has_node(tree: bpy.types.NodeTree, node_type: str) -> bool:
    """Whether a node of the type is in the tree or in any group inside it."""
    groups = (node.node_tree for node in tree.nodes if node.type == "GROUP" and node.node_tree is not None)
    return any(node.bl_idname == node_type for node in tree.nodes) or any(has_node(group, node_type) for group in groups)


def _made_compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The scene's compositor, made when there is none so that it gives the render unchanged."""
    if bpy.app.version >= (5, 0):
        if scene.compositing_node_group is None:
            scene.compositing_node_group = _new_pass_through(scene)
        tree = scene.compositing_node_group
    else:
        if scene.node_tree is None:
            scene.use_nodes = True  # makes Render Layers -> Composite
        tree = scene.node_tree
    _check_editable(tree)
    return tree


def _new_pass_through(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    output = tree.nodes.new("NodeGroupOutput")
    output.location.x = layers.width + 4 * NODE_GAP_PX
    tree.links.new(layers.outputs["Image"], output.inputs["Image"])
    return tree


def _check_editable(tree: bpy.types.NodeTree) -> None:
    if not tree.is_editable:
        raise SceneError(f"the node tree {tree.name!r} belongs to another .blend file; make it local to add the passes to it")


def _find_group_node(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    """Our node in `tree` or in any group inside it: an artist may have tidied it away."""
    groups = [node for node in tree.nodes if node.type == "GROUP" and node.node_tree is not None]
    for node in groups:
        if node.node_tree.get(GROUP_PROPERTY):
            return node
    # Groups cannot contain themselves, so this ends.
    return next((found for node in groups if (found := _find_group_node(node.node_tree))), None)


def _new_group_node(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """Below all other nodes, where it covers none. A group whose node was deleted is used again."""
    location = _free_location(tree)
    orphans = (group for group in bpy.data.node_groups if group.get(GROUP_PROPERTY) and group.users == 0 and group.library is None)
    group = next(orphans, None)
    if group is None:
        group = bpy.data.node_groups.new(GROUP_NAME, "CompositorNodeTree")
        group[GROUP_PROPERTY] = True
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    node.name = node.label = GROUP_NAME
    node.width = 280.0  # pass names are long
    node.location = location
    return node


def _own_group(scene: bpy.types.Scene, tree: bpy.types.NodeTree, node: bpy.types.Node) -> bpy.types.NodeTree:
    """The node's group, a copy of it where it gives another scene's passes. Scenes that share their whole compositor share it too."""
    group = node.node_tree
    owner = next((each for each in bpy.data.scenes if each.name_full == group.get(SCENE_PROPERTY)), None)
    if owner is None:
        group[SCENE_PROPERTY] = scene.name_full
    elif owner != scene and compositor_tree(owner) != tree:
        group = node.node_tree = group.copy()
        group[SCENE_PROPERTY] = scene.name_full
    return group


def _free_location(tree: bpy.types.NodeTree) -> tuple[float, float]:
    nodes = [node for node in tree.nodes if node.type != "FRAME"]
    if not nodes:
        return (0.0, 0.0)
    # Nodes that were never drawn have no dimensions; count their rows instead.
    bottoms = [node.location_absolute.y - max(node.dimensions.y, 22.0 * (8 + len(node.inputs) + len(node.outputs))) for node in nodes]
    return (min(node.location_absolute.x for node in nodes), min(bottoms) - NODE_GAP_PX)


def _group_output(group: bpy.types.NodeTree) -> bpy.types.Node:
    outputs = [node for node in group.nodes if node.bl_idname == "NodeGroupOutput"]
    if (active := next((node for node in outputs if node.is_active_output), None)) is not None:
        return active
    made: bpy.types.Node = group.nodes.new("NodeGroupOutput")
    made.location.x = 400.0
    return made


def _group_input(group: bpy.types.NodeTree) -> bpy.types.Node:
    inputs = (node for node in group.nodes if node.bl_idname == "NodeGroupInput")
    return next(inputs, None) or group.nodes.new("NodeGroupInput")


def _output_socket(group: bpy.types.NodeTree, pass_name: str) -> bpy.types.NodeTreeInterfaceSocket | None:
    sockets = (item for item in group.interface.items_tree if item.item_type == "SOCKET" and item.in_out == "OUTPUT")
    return next((socket for socket in sockets if socket.name == pass_name), None)


def _image_node(group: bpy.types.NodeTree, pass_name: str) -> bpy.types.Node | None:
    return next((node for node in group.nodes if node.get(PASS_PROPERTY) == pass_name), None)


def _new_image_node(group: bpy.types.NodeTree, pass_name: str, row: int) -> bpy.types.Node:
    node = group.nodes.new("CompositorNodeImage")
    node[PASS_PROPERTY] = node.label = pass_name
    node.width = 280.0
    node.location = (0.0, -300.0 * row)
    return node


@dataclass(frozen=True)
class _Sum:
    """A view layer's picture without reflections and the product of its two passes."""

    input_name: str
    output_name: str
    pass_names: tuple[str, str]


def _sums_of(images: Mapping[str, bpy.types.Image]) -> list[_Sum]:
    """Those of which both passes are there."""
    sums = {}
    for layer_name in {image.get(LAYER_PROPERTY, ""): None for image in images.values()}:
        names = layer_pass_names(
            (REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME, WITHOUT_REFLECTIONS, WITH_REFLECTIONS), layer_name or None
        )
        reflection, color, input_name, output_name = names.values()
        if reflection in images and color in images:
            sums[output_name] = _Sum(input_name, output_name, (reflection, color))
    return list(sums.values())


def _add_sum(group: bpy.types.NodeTree, wanted: _Sum, result: PassNodes) -> None:
    if _sum_nodes(group, wanted.output_name):
        return
    source = group.interface.new_socket(name=wanted.input_name, in_out="INPUT", socket_type="NodeSocketColor")
    source.default_value = BLACK
    group.interface.new_socket(name=wanted.output_name, in_out="OUTPUT", socket_type="NodeSocketColor")
    result.added.append(wanted.output_name)
    given = _group_input(group)
    product, total = (_new_mix_node(group, wanted.output_name, blend_type) for blend_type in ("MULTIPLY", "ADD"))
    passes = [node for name in wanted.pass_names if (node := _image_node(group, name)) is not None]
    output = _group_output(group)
    given.location.x = total.location.x = output.location.x
    product.location.y = total.location.y = min(node.location.y for node in passes) - 5 * NODE_GAP_PX
    given.location.y = product.location.y - 3 * NODE_GAP_PX
    for node, place in zip(passes, ("A_Color", "B_Color"), strict=True):
        group.links.new(node.outputs["Image"], _socket(product.inputs, place))
    # first what is given: its alpha stays
    group.links.new(given.outputs[wanted.input_name], _socket(total.inputs, "A_Color"))
    group.links.new(_socket(product.outputs, "Result_Color"), _socket(total.inputs, "B_Color"))
    group.links.new(_socket(total.outputs, "Result_Color"), output.inputs[wanted.output_name])


def _new_mix_node(group: bpy.types.NodeTree, output_name: str, blend_type: str) -> bpy.types.Node:
    node = group.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type = "RGBA", blend_type
    node[SUM_PROPERTY] = output_name
    _socket(node.inputs, "Factor_Float").default_value = 1.0
    return node


def _socket(sockets: bpy.types.bpy_prop_collection, identifier: str) -> bpy.types.NodeSocket:
    """By what tells those of a mix node apart: several have the same name."""
    return next(socket for socket in sockets if socket.identifier == identifier)


def _sum_nodes(group: bpy.types.NodeTree, output_name: str) -> list[bpy.types.Node]:
    return [node for node in group.nodes if node.get(SUM_PROPERTY) == output_name]


def _drop_gone_passes(group: bpy.types.NodeTree, images: Mapping[str, bpy.types.Image], result: PassNodes) -> None:
    """A linked output stays: removing it would break the artist's links, and a light may only be left out this time."""
    needed = _drop_gone_sums(group, images, result)
    for node in [node for node in group.nodes if node.get(PASS_PROPERTY, "") not in ("", *images)]:
        pass_name = node[PASS_PROPERTY]
        if _is_linked(group, pass_name) or node in needed:
            result.kept.append(pass_name)
            continue
        group.nodes.remove(node)
        if socket := _output_socket(group, pass_name):
            group.interface.remove(socket)
        result.removed.append(pass_name)


def _drop_gone_sums(group: bpy.types.NodeTree, images: Mapping[str, bpy.types.Image], result: PassNodes) -> list[bpy.types.Node]:
    """The image nodes that those still linked need."""
    present = {each.output_name for each in _sums_of(images)}
    needed = []
    for output_name in sorted({node[SUM_PROPERTY] for node in group.nodes if SUM_PROPERTY in node} - present):
        nodes = _sum_nodes(group, output_name)
        if _is_linked(group, output_name):
            needed += [link.from_node for link in group.links if link.to_node in nodes]
            continue
        inputs = {
            link.from_socket.identifier for link in group.links if link.to_node in nodes and link.from_node.bl_idname == "NodeGroupInput"
        }
        for node in nodes:
            group.nodes.remove(node)
        for item in list(group.interface.items_tree):
            if item.item_type == "SOCKET" and (item.identifier in inputs or (item.in_out == "OUTPUT" and item.name == output_name)):
                group.interface.remove(item)
        result.removed.append(output_name)
    return needed


def _is_linked(group: bpy.types.NodeTree, output_name: str) -> bool:
    """Whether an output is used anywhere in the file."""
    return any(user.outputs[output_name].is_linked for user in _users(group) if output_name in user.outputs)


def _users(group: bpy.types.NodeTree) -> Iterator[bpy.types.Node]:
    """Every node in the file that shows the group."""
    trees = list(bpy.data.node_groups)
    if bpy.app.version < (5, 0):  # there a scene owns its tree
        trees += [scene.node_tree for scene in bpy.data.scenes if scene.node_tree is not None]
    for tree in trees:
        yield from (node for node in tree.nodes if node.type == "GROUP" and node.node_tree == group)
