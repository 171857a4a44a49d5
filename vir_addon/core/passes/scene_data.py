"""The scene on the device: textures that kernels index, and meshes for the rasterizer.

    vertices          one texel a vertex: position (object space), octahedral normal packed in 24 bits
    triangles         one texel a triangle: three vertex indices within the mesh, material slot
    corner_normals    one texel a triangle: three packed normals; only of meshes whose corners differ
    instances         INSTANCE_TEXELS texels an instance: three rows of world_from_object; vertex and triangle base;
                      corner base, shading kind, orientation; stable id
What has an opacity map stands in `opacity_maps.OpacityMaps` besides, which exists only if something has.
Integers are floats here (Blender uploads only floats), those that may exceed 2^24 split into high and low 16 bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...device.declaration import Sampled
from ...device.interface import Device, DeviceMesh, Draw, Texture, split_integers
from ...device.owned import Owned, Shared
from ..eye_pixels import eye_pixels
from ..scene import Mesh, SceneSnapshot
from .opacity_maps import OpacityMaps

INSTANCE_TEXELS = 6
SHADING_FLAT, SHADING_POINT, SHADING_CORNER = 0, 1, 2
WORK_GROUP_SIZE = 64
"""triangles that one entry of a work table covers, and invocations of the kernels that walk it"""

SCENE_TEXTURES: Mapping[str, Sampled] = {
    "vertices": Sampled("sampler2D", "position (object space) and packed normal of every vertex"),
    "triangles": Sampled("sampler2D", "vertex indices of every triangle, within its mesh, and its material slot"),
    "instances": Sampled("sampler2D", "transforms and bases of every instance"),
}
SCENE_DEFINES = {"INSTANCE_TEXELS": INSTANCE_TEXELS}


PACKED_TOGETHER = 1 << 14
"""directions; temporaries stay in the cache"""


def pack_directions(directions: np.ndarray) -> np.ndarray:
    """(..., 3) float32 unit vectors -> (...) float32 holding 24 bits; the host's side of lib/octahedral.glsl."""
    rows = directions.reshape(-1, 3)
    packed = np.empty(len(rows), np.float32)
    for start in range(0, len(rows), PACKED_TOGETHER):
        x, y, z = np.ascontiguousarray(rows[start : start + PACKED_TOGETHER].T, np.float32)
        length = np.abs(x) + np.abs(y) + np.abs(z)
        length[length == 0] = 1
        x, y = x / length, y / length
        wrapped_x, wrapped_y = np.copysign(1 - np.abs(y), x + 0), np.copysign(1 - np.abs(x), y + 0)  # + 0: no -0
        is_below = z < 0
        x, y = (np.floor((np.where(is_below, *pair) * 0.5 + 0.5) * 4095 + 0.5) for pair in ((wrapped_x, x), (wrapped_y, y)))
        packed[start : start + PACKED_TOGETHER] = x * 4096 + y
    return packed.reshape(directions.shape[:-1])


def _shading_of(mesh: Mesh) -> int:
    if mesh.corner_normals_os is not None:
        return SHADING_CORNER
    return SHADING_POINT if mesh.point_normals_os is not None else SHADING_FLAT


def geometry_bases(meshes: tuple[Mesh, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each mesh begins in the textures: (mesh_count + 1,) int64 each of vertices, triangles and triangles with corner normals."""
    vertex_counts = [mesh.vertex_count for mesh in meshes]
    triangle_counts = [mesh.triangle_count for mesh in meshes]
    corner_counts = [mesh.triangle_count if mesh.corner_normals_os is not None else 0 for mesh in meshes]
    vertices, triangles, corners = (
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64) for counts in (vertex_counts, triangle_counts, corner_counts)
    )
    return vertices, triangles, corners


class GeometryRows(NamedTuple):
    """What the textures of meshes hold, (n, 4) float32 each."""

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray


def pack_geometry(meshes: tuple[Mesh, ...]) -> GeometryRows:
    """Work for the host alone, and most of an upload."""
    vertex_bases, triangle_bases, corner_bases = geometry_bases(meshes)
    rows = GeometryRows(*(np.zeros((int(bases[-1]), 4), np.float32) for bases in (vertex_bases, triangle_bases, corner_bases)))
    for index, mesh in enumerate(meshes):
        vertices = rows.vertices[vertex_bases[index] : vertex_bases[index + 1]]
        vertices[:, :3] = mesh.positions_os
        if mesh.point_normals_os is not None:
            vertices[:, 3] = pack_directions(mesh.point_normals_os)
        triangles = rows.triangles[triangle_bases[index] : triangle_bases[index + 1]]
        triangles[:, :3] = mesh.triangles
        if mesh.material_slot is not None:
            triangles[:, 3] = mesh.material_slot
        if mesh.corner_normals_os is not None:
            rows.corner_normals[corner_bases[index] : corner_bases[index + 1], :3] = pack_directions(mesh.corner_normals_os)
    return rows


class SceneGeometry(Shared):
    """Meshes on the device, wherever instances of them are. Those for the rasterizer are uploaded when first drawn."""

    def __init__(self, meshes: tuple[Mesh, ...], device: Device, rows: GeometryRows | None = None) -> None:
        """rows: of these meshes, if they are packed already"""
        self.meshes, self.device = meshes, device
        self._drawables: dict[int, DeviceMesh] = {}
        self.triangle_counts = np.array([mesh.triangle_count for mesh in meshes], np.int64)
        self.vertex_bases, self.triangle_bases, self.corner_bases = geometry_bases(meshes)
        self.shading = np.array([_shading_of(mesh) for mesh in meshes], np.int64)
        rows = pack_geometry(meshes) if rows is None else rows
        with Owned() as owned:
            self.vertices = owned.own(device.upload_array(rows.vertices))
            self.triangles = owned.own(device.upload_array(rows.triangles))
            self.corner_normals = owned.own(device.upload_array(rows.corner_normals))
            self._owned = owned.pop_all()

    def drawable(self, mesh_index: int) -> DeviceMesh:
        if mesh_index not in self._drawables:
            mesh = self.meshes[mesh_index]
            self._drawables[mesh_index] = self._owned.own(self.device.upload_mesh(mesh.positions_os, mesh.triangles))
        return self._drawables[mesh_index]

    def _free(self) -> None:
        self._owned.close()


class SceneData(Shared):
    """Uploads a snapshot."""

    def __init__(self, snapshot: SceneSnapshot, device: Device, geometry: SceneGeometry | None = None) -> None:
        """geometry: of the same meshes, if there is one already"""
        self.snapshot, self.device = snapshot, device
        self.eye_pixels = eye_pixels(snapshot)
        self.orientation = np.where(np.linalg.det(snapshot.instances.world_from_object[:, :3, :3].astype(np.float64)) < 0, -1.0, 1.0)
        is_cut_out = np.array([mesh.opacity_map is not None for mesh in snapshot.meshes], bool)
        self.cut_out = is_cut_out[snapshot.instances.mesh_index]
        """(instance_count,) bool: instances with an opacity map"""
        with Owned() as owned:
            self.geometry = owned.own(SceneGeometry(snapshot.meshes, device) if geometry is None else geometry.share())
            self.triangle_counts = self.geometry.triangle_counts
            self.vertices, self.triangles = self.geometry.vertices, self.geometry.triangles
            self.corner_normals = self.geometry.corner_normals
            self.instances = owned.own(device.upload_array(self._instance_rows()))
            self.opacity_maps = owned.own(OpacityMaps(snapshot, device)) if is_cut_out.any() else None
            self._owned = owned.pop_all()

    def _instance_rows(self) -> np.ndarray:
        instances, geometry = self.snapshot.instances, self.geometry
        rows = np.zeros((len(instances), INSTANCE_TEXELS, 4), np.float32)
        rows[:, :3] = instances.world_from_object[:, :3]
        mesh = instances.mesh_index
        rows[:, 3, :2] = split_integers(geometry.vertex_bases[mesh])
        rows[:, 3, 2:] = split_integers(geometry.triangle_bases[mesh])
        rows[:, 4, :2] = split_integers(geometry.corner_bases[mesh])
        rows[:, 4, 2] = geometry.shading[mesh]
        rows[:, 4, 3] = self.orientation
        rows[:, 5, :2] = split_integers(instances.stable_id)
        return rows.reshape(-1, 4)

    @property
    def bindings(self) -> dict[str, Texture]:
        return {"vertices": self.vertices, "triangles": self.triangles, "instances": self.instances}

    def draws(self, instance_indices: np.ndarray, culled: np.ndarray | None = None) -> list[Draw]:
        """Draw calls for some instances, runs of consecutive instances of one mesh as one instanced draw.

        culled: (instance_count,) bool, instances whose back faces are left out; only those that the transform does not
        mirror are (a mirrored one would need the other winding, and drawing both faces is right too).
        """
        instances = self.snapshot.instances
        order = np.asarray(instance_indices)[np.lexsort((instance_indices, instances.mesh_index[instance_indices]))]
        cull = np.zeros(len(order), bool) if culled is None else culled[order] & (self.orientation[order] > 0)
        mesh = instances.mesh_index[order]
        if not len(order):
            return []
        breaks = (np.diff(order) != 1) | (np.diff(mesh) != 0) | (cull[1:] != cull[:-1])
        starts = np.flatnonzero(np.r_[True, breaks])
        ends = np.r_[starts[1:], len(order)]
        return [
            Draw(self.geometry.drawable(int(mesh[start])), int(end - start), {"first_instance": int(order[start])}, bool(cull[start]))
            for start, end in zip(starts, ends, strict=True)
        ]

    def work_table(self, instance_indices: np.ndarray, two_sided: np.ndarray) -> WorkTable:
        """One texel per WORK_GROUP_SIZE triangles of the given instances.

        two_sided: (instance_count,) bool, whether back faces count.
        """
        counts = self.triangle_counts[self.snapshot.instances.mesh_index[instance_indices]]
        groups = -(-counts // WORK_GROUP_SIZE)
        instance = np.repeat(instance_indices, groups)
        first_group = np.repeat(np.cumsum(groups) - groups, groups)
        rows = np.zeros((len(instance), 4), np.float32)
        rows[:, 0] = instance
        rows[:, 1] = (np.arange(len(instance)) - first_group) * WORK_GROUP_SIZE
        rows[:, 2] = np.repeat(counts, groups)
        rows[:, 3] = two_sided[instance]
        return WorkTable(self.device.upload_array(rows), len(rows), int(counts.sum()))

    def _free(self) -> None:
        self._owned.close()


def portions(draws: Iterable[Draw], triangle_count: int) -> Iterator[list[Draw]]:
    """The same in the same order, so many triangles at a time at most. Kernels are told the first triangle of a draw by a constant."""
    portion: list[Draw] = []
    drawn = 0
    for draw in draws:
        for piece in _pieces(draw, triangle_count):
            count = piece.instance_count * (piece.mesh.triangle_count if piece.triangle_range is None else piece.triangle_range[1])
            if portion and drawn + count > triangle_count:
                yield portion
                portion, drawn = [], 0
            portion.append(piece)
            drawn += count
    if portion:
        yield portion


def _pieces(draw: Draw, triangle_count: int) -> Iterator[Draw]:
    """Of `draws`: some of its instances each, or a range of the triangles of one."""
    own_count, first_instance = draw.mesh.triangle_count, draw.constants["first_instance"]
    at_once = max(triangle_count // max(own_count, 1), 1)
    for k in range(0, draw.instance_count, at_once):
        constants = {"first_instance": first_instance + k, "first_triangle": 0}
        if own_count <= triangle_count:
            yield replace(draw, instance_count=min(at_once, draw.instance_count - k), constants=constants)
            continue
        for first in range(0, own_count, triangle_count):
            triangle_range = first, min(triangle_count, own_count - first)
            yield replace(draw, instance_count=1, constants={**constants, "first_triangle": first}, triangle_range=triangle_range)


class WorkTable:
    """Which triangles a dispatch walks: texel g tells work group g its instance, first triangle, the mesh's triangle count,
    and whether back faces count. Triangle numbers are exact up to 2^24 a mesh."""

    def __init__(self, texture: Texture, group_count: int, triangle_count: int) -> None:
        self.texture, self.group_count, self.triangle_count = texture, group_count, triangle_count

    def release(self) -> None:
        self.texture.release()
