"""The bpy side of modelling: shapes become objects, curves and instances in one collection. Metres, radians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np
from mathutils import Matrix

from .shapes import Shape, joined

Part = tuple[Shape, str]
Vec3 = Sequence[float]


class Stage:
    """Where props are put. `palette` maps a material's name to (base colour, roughness, metallic)."""

    def __init__(self, scene: bpy.types.Scene, palette: Mapping[str, tuple[Vec3, float, float]]) -> None:
        self.scene = scene
        self.palette = palette
        self.collection = bpy.data.collections.new("Still Life")
        scene.collection.children.link(self.collection)
        self.prototypes = bpy.data.collections.new("Prototypes")
        self.prototypes.hide_render = self.prototypes.hide_viewport = True
        scene.collection.children.link(self.prototypes)
        self._materials: dict[str, bpy.types.Material] = {}

    def material(self, name: str) -> bpy.types.Material:
        if name not in self._materials:
            colour, roughness, metallic = self.palette[name]
            material = bpy.data.materials.new(name)
            if material.node_tree is None:
                material.use_nodes = True
            shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
            shader.inputs["Base Color"].default_value = (*colour, 1.0)
            shader.inputs["Roughness"].default_value = roughness
            shader.inputs["Metallic"].default_value = metallic
            material.diffuse_color = (*colour, 1.0)
            self._materials[name] = material
        return self._materials[name]

    def _mesh(self, name: str, parts: list[Part], sharp_deg: float) -> bpy.types.Mesh:
        mesh = bpy.data.meshes.new(name)
        shape = joined([part for part, _ in parts])
        mesh.from_pydata(shape.points, [], shape.quads.tolist() + shape.triangles.tolist())
        names = list(dict.fromkeys(material for _, material in parts))
        for material in names:
            mesh.materials.append(self.material(material))
        slots = [names.index(material) for _, material in parts]
        quad_slots = np.repeat(slots, [len(part.quads) for part, _ in parts])
        triangle_slots = np.repeat(slots, [len(part.triangles) for part, _ in parts])
        mesh.polygons.foreach_set("material_index", np.concatenate([quad_slots, triangle_slots]).astype(np.int32))
        mesh.shade_smooth()
        if sharp_deg < 180.0:
            mesh.set_sharp_from_angle(angle=np.radians(sharp_deg))
        return mesh

    def place(
        self, name: str, data: bpy.types.ID, location: Vec3 = (0, 0, 0), rotation: Vec3 = (0, 0, 0), scale: float = 1.0
    ) -> bpy.types.Object:
        """One more object of the same data; rotation is XYZ Euler."""
        thing = bpy.data.objects.new(name, data)
        thing.location, thing.rotation_euler, thing.scale = location, rotation, (scale,) * 3
        self.collection.objects.link(thing)
        return thing

    def add(
        self,
        name: str,
        parts: list[Part],
        location: Vec3 = (0, 0, 0),
        rotation: Vec3 = (0, 0, 0),
        sharp_deg: float = 45.0,
        bevel_m: float = 0.0,
    ) -> bpy.types.Object:
        """A mesh of (shape, material) parts. Edges sharper than `sharp_deg` stay sharp, or are rounded by a bevel modifier."""
        thing = self.place(name, self._mesh(name, parts, 180.0 if bevel_m else sharp_deg), location, rotation)
        if bevel_m:
            bevel = thing.modifiers.new("Bevel", "BEVEL")
            bevel.width, bevel.segments, bevel.limit_method, bevel.harden_normals = bevel_m, 2, "ANGLE", True
        return thing

    def curve(
        self,
        name: str,
        paths: list[np.ndarray],
        radius_m: float,
        material: str,
        tapers: list[np.ndarray] | None = None,
        closed: bool = False,
        sides: int = 2,
    ) -> bpy.types.Object:
        """Bevelled poly curves; `tapers` are radius factors point by point, `sides` the bevel resolution (4 sides and 2 more for each)."""
        curve = bpy.data.curves.new(name, "CURVE")
        curve.dimensions, curve.bevel_depth, curve.bevel_resolution, curve.use_fill_caps = "3D", radius_m, sides, True
        curve.materials.append(self.material(material))
        for i, path in enumerate(paths):
            line = curve.splines.new("POLY")
            line.points.add(len(path) - 1)
            line.points.foreach_set("co", np.column_stack([path, np.ones(len(path))]).astype(np.float32).ravel())
            if tapers is not None:
                line.points.foreach_set("radius", np.asarray(tapers[i], dtype=np.float32))
            line.use_cyclic_u, line.use_smooth = closed, True
        return self.place(name, curve)

    def prototype(self, name: str, parts: list[Part], sharp_deg: float = 60.0) -> bpy.types.Object:
        """An object that is only shown through `scatter`."""
        thing = bpy.data.objects.new(name, self._mesh(name, parts, sharp_deg))
        self.prototypes.objects.link(thing)
        return thing

    def scatter(
        self, name: str, prototype: bpy.types.Object, points: np.ndarray, frames: np.ndarray, scales: np.ndarray
    ) -> bpy.types.Object:
        """Geometry-nodes instances: `frames` are (n, 3, 3) with the instance's axes as columns."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(points, [], [])
        quaternions = np.array([Matrix(frame.tolist()).to_quaternion() for frame in frames], dtype=np.float32)
        mesh.attributes.new("turn", "QUATERNION", "POINT").data.foreach_set("value", quaternions.ravel())
        mesh.attributes.new("size", "FLOAT", "POINT").data.foreach_set("value", np.asarray(scales, dtype=np.float32))
        thing = self.place(name, mesh)
        thing.modifiers.new("Scatter", "NODES").node_group = _scatter_nodes(name, prototype)
        return thing


def _scatter_nodes(name: str, prototype: bpy.types.Object) -> bpy.types.NodeTree:
    tree = bpy.data.node_groups.new(f"{name} scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, leave = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    info, put = tree.nodes.new("GeometryNodeObjectInfo"), tree.nodes.new("GeometryNodeInstanceOnPoints")
    info.inputs["Object"].default_value = prototype
    info.inputs["As Instance"].default_value = True
    tree.links.new(entry.outputs["Geometry"], put.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], put.inputs["Instance"])
    for attribute, kind, socket in (("turn", "QUATERNION", "Rotation"), ("size", "FLOAT", "Scale")):
        read = tree.nodes.new("GeometryNodeInputNamedAttribute")
        read.data_type = kind
        read.inputs["Name"].default_value = attribute
        tree.links.new(read.outputs["Attribute"], put.inputs[socket])
    tree.links.new(put.outputs["Instances"], leave.inputs["Geometry"])
    return tree
