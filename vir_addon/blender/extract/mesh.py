"""One evaluated Blender mesh -> `core.scene.Mesh`, through those of Blender's accessors that are fast.

For a mesh of 2 million triangles the paths used here take 2 to 20 ms each; `loop_triangles` takes 300 to 600 ms, so it is read only
for faces of more than four corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.mesh_topology import has_outside
from ...core.scene import Mesh

_BLOCK = 1 << 14
"""quads looked at together: temporaries stay in the cache"""

_LARGEST_COORDINATE = 1e15
"""Beyond it a coordinate is as good as infinite: products of a few of them no longer fit into single precision. Blender itself turns an
infinite coordinate into the largest finite number on some ways in."""


@dataclass(frozen=True)
class ExtractedMesh:
    mesh: Mesh | None
    """None: no triangles"""
    dropped_vertex_count: int = 0
    """vertices with a coordinate that is not a number, infinite or absurdly large"""
    dropped_triangle_count: int = 0
    """the triangles at them"""
    corners: np.ndarray | None = None
    """(triangle_count, 3) int32 Blender's corners of the mesh's triangles; None: three after three"""
    is_kept: np.ndarray | None = None
    """bool, which of Blender's triangles the mesh has; None: all"""


def extract_mesh(data: bpy.types.Mesh, name: str) -> ExtractedMesh:
    """Copies: nothing in the result refers to Blender's memory."""
    if len(data.polygons) == 0:
        return ExtractedMesh(None)
    positions = _read_positions(data)
    corner_vertices = _read_corner_vertices(data)
    triangle_corners = _triangulate(data, positions, corner_vertices)
    triangles = corner_vertices.reshape(-1, 3) if triangle_corners is None else np.take(corner_vertices, triangle_corners)
    point_normals, corner_normals = _read_normals(data, triangle_corners)

    dropped_vertex_count, dropped_triangle_count, keep = 0, 0, None
    is_usable = np.abs(positions) <= _LARGEST_COORDINATE
    if not is_usable.all():
        is_bad = ~is_usable.all(axis=1)
        dropped_vertex_count = int(is_bad.sum())
        keep = ~is_bad[triangles].any(axis=1)
        dropped_triangle_count = len(keep) - int(np.count_nonzero(keep))
        triangles = triangles[keep]
        corner_normals = None if corner_normals is None else corner_normals[keep]
        if triangle_corners is None:
            triangle_corners = np.arange(len(corner_vertices), dtype=np.int32).reshape(-1, 3)
        triangle_corners = triangle_corners[keep]
        if len(triangles) == 0:
            return ExtractedMesh(None, dropped_vertex_count, dropped_triangle_count)
        # No triangle uses these vertices any more; a finite stand-in keeps them from spoiling bounds.
        positions[is_bad] = positions[triangles[0, 0]]
    mesh = Mesh(
        name=name,
        positions_os=positions,
        triangles=triangles,
        point_normals_os=_mend_point_normals(point_normals, positions, triangles),
        corner_normals_os=_mend_corner_normals(corner_normals, positions, triangles),
        is_closed=dropped_vertex_count == 0 and has_outside(positions, triangles),
    )
    return ExtractedMesh(mesh, dropped_vertex_count, dropped_triangle_count, triangle_corners, keep)


def _read_positions(data: bpy.types.Mesh) -> np.ndarray:
    """(vertex_count, 3) float32"""
    positions = np.empty((len(data.vertices), 3), dtype=np.float32)
    data.attributes["position"].data.foreach_get("vector", positions.reshape(-1))
    return positions


def _read_corner_vertices(data: bpy.types.Mesh) -> np.ndarray:
    """(corner_count,) int32: the vertex of every corner of every face, face after face"""
    corner_vertices = np.empty(len(data.loops), dtype=np.int32)
    data.attributes[".corner_vert"].data.foreach_get("value", corner_vertices)
    return corner_vertices


def _triangulate(data: bpy.types.Mesh, positions: np.ndarray, corner_vertices: np.ndarray) -> np.ndarray | None:
    """(triangle_count, 3) int32 corners, as Blender's own tessellation makes them; None: all faces are triangles, in order."""
    face_count = len(data.polygons)
    if len(corner_vertices) == 3 * face_count:  # no face has fewer than three corners, so none has more
        return None
    face_of_triangle = np.empty(len(data.loop_triangles), dtype=np.int32)
    data.loop_triangle_polygons.foreach_get("value", face_of_triangle)
    # A face of n corners makes n - 2 triangles. (Reading the faces' own sizes takes ten times longer.)
    triangles_per_face = np.bincount(face_of_triangle, minlength=face_count).astype(np.int32)
    if triangles_per_face.min() == 2 == triangles_per_face.max():
        return _split_quads(np.arange(0, 4 * face_count, 4, dtype=np.int32), positions, corner_vertices).reshape(-1, 3)
    first_corner = np.zeros(face_count, dtype=np.int32)
    np.cumsum(triangles_per_face[:-1] + 2, out=first_corner[1:])
    first_triangle = np.zeros(face_count, dtype=np.int32)
    np.cumsum(triangles_per_face[:-1], out=first_triangle[1:])

    corners = np.empty((len(face_of_triangle), 3), dtype=np.int32)
    is_triangle = triangles_per_face == 1
    corners[first_triangle[is_triangle]] = first_corner[is_triangle, None] + np.arange(3, dtype=np.int32)
    is_quad = triangles_per_face == 2
    halves = _split_quads(first_corner[is_quad], positions, corner_vertices)
    corners[first_triangle[is_quad]] = halves[:, 0]
    corners[first_triangle[is_quad] + 1] = halves[:, 1]
    of_larger_face = np.flatnonzero(triangles_per_face[face_of_triangle] > 2)
    corners[of_larger_face] = _read_loop_triangles(data, of_larger_face)
    return corners


def _split_quads(first_corner: np.ndarray, positions: np.ndarray, corner_vertices: np.ndarray) -> np.ndarray:
    """(quad_count, 2, 3) int32 corners. Cut from the first to the third corner, unless that diagonal lies outside a concave quad."""
    halves = np.empty((len(first_corner), 6), dtype=np.int32)
    axes = np.ascontiguousarray(positions.T)
    for start in range(0, len(first_corner), _BLOCK):
        first = first_corner[start : start + _BLOCK]
        # Coordinates that are infinite, or nearly, overflow: how their quads are cut does not matter.
        with np.errstate(over="ignore", invalid="ignore"):
            other_cut = _is_first_diagonal_outside(axes, [np.take(corner_vertices, first + k) for k in range(4)]).astype(np.int32)
        block = halves[start : start + _BLOCK]
        # Corners 0 1 2 and 0 2 3, or 0 1 3 and 1 2 3.
        block[:, 0] = first
        block[:, 1] = first + 1
        block[:, 2] = first + 2 + other_cut
        block[:, 3] = first + other_cut
        block[:, 4] = first + 2
        block[:, 5] = first + 3
    return halves.reshape(-1, 2, 3)


def _is_first_diagonal_outside(axes: np.ndarray, vertices: list[np.ndarray]) -> np.ndarray:
    """(quad_count,) bool: do the second and the fourth corner lie on the same side of the diagonal from the first to the third?

    axes: (3, vertex_count) float32; one axis at a time is several times faster than rows of three.
    """
    second_fourth, diagonal_squared, second_along, fourth_along = np.zeros((4, len(vertices[0])), dtype=np.float32)
    # (s x d) . (f x d) = (s . f) (d . d) - (s . d) (f . d), Lagrange's identity.
    for axis in axes:
        origin, second, third, fourth = (np.take(axis, corner) for corner in vertices)
        second -= origin
        third -= origin
        fourth -= origin
        second_fourth += second * fourth
        diagonal_squared += third * third
        second_along += second * third
        fourth_along += fourth * third
    return second_fourth * diagonal_squared > second_along * fourth_along


def _read_loop_triangles(data: bpy.types.Mesh, which: np.ndarray) -> np.ndarray:
    """(len(which), 3) int32 corners of Blender's own triangles; one by one where they are few, since all of them take long."""
    if len(which) * 8 < len(data.loop_triangles):
        triangles = data.loop_triangles
        return np.array([triangles[index].loops[:] for index in which.tolist()], dtype=np.int32).reshape(-1, 3)
    every = np.empty((len(data.loop_triangles), 3), dtype=np.int32)
    data.loop_triangles.foreach_get("loops", every.reshape(-1))
    return every[which]


def _read_normals(data: bpy.types.Mesh, triangle_corners: np.ndarray | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(vertex_count, 3) and (triangle_count, 3, 3) float32, at most one of them; neither for a flat shaded mesh."""
    if data.normals_domain == "POINT":
        point_normals = np.empty((len(data.vertices), 3), dtype=np.float32)
        data.vertex_normals.foreach_get("vector", point_normals.reshape(-1))
        return point_normals, None
    if data.normals_domain == "CORNER":
        normals = np.empty((len(data.loops), 3), dtype=np.float32)
        data.corner_normals.foreach_get("vector", normals.reshape(-1))
        return None, normals.reshape(-1, 3, 3) if triangle_corners is None else normals[triangle_corners]
    return None, None


def _face_normals(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(triangle_count, 3) float32, length 1; +z for a triangle without area"""
    first, second, third = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0.0, normals / np.maximum(lengths, np.finfo(np.float64).tiny), (0.0, 0.0, 1.0)).astype(np.float32)


def _is_not_unit(normals: np.ndarray) -> np.ndarray:
    """normals without the last axis, bool. Also True where a component is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("...i,...i->...", normals, normals)
    return ~((squares > 0.5) & (squares < 2.0))


def _mend_point_normals(normals: np.ndarray | None, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Vertices beside dropped ones, or with broken custom normals, get the normal of one of their triangles."""
    if normals is None or not (is_bad := _is_not_unit(normals)).any():
        return normals
    normals[is_bad] = (0.0, 0.0, 1.0)
    at_bad = triangles[is_bad[triangles].any(axis=1)]
    face_normals = _face_normals(positions, at_bad)
    for corner in range(3):
        touches = is_bad[at_bad[:, corner]]
        normals[at_bad[touches, corner]] = face_normals[touches]
    return normals


def _mend_corner_normals(normals: np.ndarray | None, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    if normals is None or not (is_bad := _is_not_unit(normals)).any():
        return normals
    normals[is_bad] = np.broadcast_to(_face_normals(positions, triangles)[:, None, :], normals.shape)[is_bad]
    return normals
