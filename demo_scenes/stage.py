"""The bpy side of modelling: shapes become objects, curves and instances in one collection. Metres, radians."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .shapes import Shape, joined

Part = tuple[Shape, str]
Vec3 = Sequence[float]


class Stage:
    """Where props are put. `palette` maps a material's name to (base colour, roughness, metallic)."""

    def __init__(self, scene: bpy.types.Scene, palette: Mapping[str, tuple[Vec3, float, float]], name: str) -> None:
        """name: of the collection of what is seen"""
        self.scene = scene
        self.palette = palette
        self.collection = bpy.data.collections.new(name)
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
        _fill_mesh(mesh, joined([part for part, _ in parts]))
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

    def area_light(
        self,
        name: str,
        shape: str,
        size_m: tuple[float, float],
        power_w: float,
        colour: Vec3,
        place: Vec3,
        target: Vec3,
        spread_deg: float = 180.0,
    ) -> bpy.types.Object:
        light = bpy.data.lights.new(name, "AREA")
        light.shape, light.size, light.size_y = shape, *size_m
        light.energy, light.color, light.spread = power_w, colour, np.radians(spread_deg)
        return aimed(self.place(name, light, place), target)

    def point_light(self, name: str, radius_m: float, power_w: float, colour: Vec3, place: Vec3) -> bpy.types.Object:
        light = bpy.data.lights.new(name, "POINT")
        light.shadow_soft_size, light.energy, light.color = radius_m, power_w, colour
        return self.place(name, light, place)

    def world(self, name: str, colour: Vec3, strength: float) -> None:
        """One colour in all directions."""
        world = bpy.data.worlds.new(name)
        if world.node_tree is None:
            world.use_nodes = True
        background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
        background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (*colour, 1.0), strength
        self.scene.world = world

    def camera(self, lens_mm: float, place: Vec3, target: Vec3, clip_m: tuple[float, float] = (0.1, 50.0)) -> bpy.types.Object:
        """On a sensor of 36 mm; becomes the scene's camera."""
        data = bpy.data.cameras.new("Camera")
        data.lens, data.sensor_width = lens_mm, 36.0
        data.clip_start, data.clip_end = clip_m
        self.scene.camera = aimed(self.place("Camera", data, place), target)
        return self.scene.camera


def aimed(thing: bpy.types.Object, target: Vec3) -> bpy.types.Object:
    """Turned so that its -z axis points at `target`."""
    thing.rotation_euler = (Vector(target) - thing.location).to_track_quat("-Z", "Y").to_euler()
    return thing


def _fill_mesh(mesh: bpy.types.Mesh, shape: Shape) -> None:
    """Quads first, then triangles. From arrays, as lists of a million faces take Blender half a minute."""
    corner_counts = np.repeat([4, 3], [len(shape.quads), len(shape.triangles)])
    mesh.vertices.add(len(shape.points))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(shape.points, np.float32).ravel())
    mesh.loops.add(int(corner_counts.sum()))
    mesh.loops.foreach_set("vertex_index", np.concatenate([shape.quads.ravel(), shape.triangles.ravel()]).astype(np.int32))
    mesh.polygons.add(len(corner_counts))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(corner_counts) - corner_counts).astype(np.int32))
    mesh.update(calc_edges=True)


def save_scene(build: Callable[[bpy.types.Scene], None], usage: str | None, arguments: list[str]) -> int:
    """The command `python -m demo_scenes.NAME OUT.blend`; returns its exit status."""
    if len(arguments) != 1:
        print(usage, file=sys.stderr)
        return 2
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build(bpy.context.scene)
    bpy.ops.wm.save_as_mainfile(filepath=arguments[0], check_existing=False, compress=True)
    return 0


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
