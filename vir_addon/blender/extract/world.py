"""The world's nodes -> `core.material.World`."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.material import BLACK, WHITE, Constant, ImageSample, ImageTexels, MaterialInput, Operation, World
from ...core.material_program import combined, constant, evaluate_on_texels, sampled_images
from ...core.scene import LeftOut
from ..materials.colors import ColorReader
from ..materials.expressions import clamped
from ..materials.image_cache import ImageCache
from ..materials.image_texels import UnreadableImage
from ..materials.inputs import NodeInput, UnreadableNodes, output_target

MAX_SIDE_PX = 4096
"""of images of the sky: a twelfth of a degree"""
_MOST_SHADERS_DEEP = 40


class WorldReader:
    """Reads each world once."""

    def __init__(self, engine: str, images: ImageCache) -> None:
        """engine: its identifier"""
        self._target = output_target(engine)
        self._colors = ColorReader(images, MAX_SIDE_PX, is_world=True)
        self._read: dict[int, World] = {}
        self.left_out: list[LeftOut] = []

    @property
    def notes(self) -> list[str]:
        return self._colors.notes

    def read(self, world: bpy.types.World | None) -> World:
        if world is None:
            return World()
        uid = world.original.session_uid
        if uid not in self._read:
            self._read[uid] = self._compute(world)
        return self._read[uid]

    def _compute(self, world: bpy.types.World) -> World:
        red, green, blue = world.color
        if world.node_tree is None or (bpy.app.version < (5, 0) and not world.use_nodes):
            return World((red, green, blue))
        output = world.node_tree.get_output_node(self._target)
        if output is None:
            return World()
        try:
            return self._world_of(self._radiance(NodeInput(output.inputs["Surface"])))
        except (UnreadableNodes, UnreadableImage) as error:
            reason = f"is reflected in its viewport colour, because it depends on {error}"
            self.left_out.append(LeftOut(f"world {world.name}", reason))
            return World((red, green, blue), is_fallback=True)

    def _world_of(self, radiance: MaterialInput) -> World:
        if isinstance(radiance, Constant):
            return World(radiance.value)
        images, directions = sampled_images(radiance), self._colors.directions
        if len(images) != 1 or any(not np.array_equal(directions[0], other) for other in directions):
            raise UnreadableNodes("more than one image, or more than one direction")
        if not isinstance(radiance, ImageSample):
            images = [ImageTexels(images[0].name, evaluate_on_texels(radiance, images[0]))]
        return World(WHITE.value, images[0], directions[0])

    def _radiance(self, shader: NodeInput, depth: int = 0) -> MaterialInput:
        node, _, here = shader.source()
        if depth > _MOST_SHADERS_DEEP:
            raise UnreadableNodes(f"more than {_MOST_SHADERS_DEEP} shaders one behind the other, or links that go in a circle")
        if node is None:
            return BLACK
        match node.type:
            case "BACKGROUND" | "EMISSION":
                strength = self._colors.number(here.of(node, "Strength"))
                return combined(Operation.MULTIPLY, self._colors.color(here.of(node, "Color")), strength)
            case "ADD_SHADER" | "MIX_SHADER":
                first, second = (self._radiance(here.of(node, name), depth + 1) for name in ("Shader", "Shader_001"))
                if node.type == "ADD_SHADER":
                    return combined(Operation.ADD, first, second)
                return combined(Operation.MIX, first, second, self._share(here.of(node, "Fac")))
        raise UnreadableNodes(f"the node '{node.name}'")

    def _share(self, factor: NodeInput) -> MaterialInput:
        """Of a mix: what reflections see is not what the camera sees."""
        node, output, _ = factor.source()
        if node is not None and node.type == "LIGHT_PATH" and output in _LIGHT_PATH:
            return constant(_LIGHT_PATH[output])
        return clamped(self._colors.number(factor))


_LIGHT_PATH = {"Is Camera Ray": 0.0, "Is Shadow Ray": 0.0, "Is Diffuse Ray": 0.0, "Is Glossy Ray": 1.0, "Is Reflection Ray": 1.0}
