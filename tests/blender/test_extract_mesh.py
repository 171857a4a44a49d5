"""Triangles, normals and closedness against Blender's own slow accessors and against shapes with a known answer."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import bmesh  # noqa: E402  (bpy decides whether this file runs)

from vir_addon.blender.extract.mesh import extract_mesh  # noqa: E402
from vir_addon.core.mesh_topology import faces_outward, is_closed  # noqa: E402

pytestmark = pytest.mark.usefixtures("scene")

L_SHAPE = [(0, 0, 0), (3, 0, 0), (3, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0)]


def mesh_of(vertices, faces):
    data = bpy.data.meshes.new("test")
    data.from_pydata(vertices, [], faces)
    return data


def primitive(create, **arguments):
    made = bmesh.new()
    getattr(bmesh.ops, create)(made, **arguments)
    data = bpy.data.meshes.new(create)
    made.to_mesh(data)
    made.free()
    return data


def shade(data, is_smooth: bool):
    data.polygons.foreach_set("use_smooth", np.full(len(data.polygons), is_smooth))
    return data


def blenders_triangles(data) -> np.ndarray:
    triangles = np.empty(3 * len(data.loop_triangles), dtype=np.int32)
    data.loop_triangles.foreach_get("vertices", triangles)
    return triangles.reshape(-1, 3)


def area_of(mesh) -> float:
    first, second, third = (mesh.positions_os[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(second - first, third - first), axis=1).sum())


def crumpled_grid():
    data = primitive("create_grid", x_segments=200, y_segments=200, size=1.0)
    positions = np.random.default_rng(5).normal(size=3 * len(data.vertices)).astype(np.float32)
    data.vertices.foreach_set("co", positions)
    return data


MESHES = {
    "triangles": lambda: primitive("create_icosphere", subdivisions=2, radius=1.0),
    "quads": lambda: primitive("create_grid", x_segments=7, y_segments=5, size=1.0),
    "triangles and quads": lambda: primitive("create_uvsphere", u_segments=8, v_segments=6, radius=1.0),
    "quads and two large faces": lambda: primitive("create_cone", cap_ends=True, segments=9, radius1=1.0, radius2=1.0, depth=2.0),
    "mostly large faces": lambda: mesh_of([*L_SHAPE, *((x, y, 1) for x, y, _ in L_SHAPE)], [range(6), range(11, 5, -1)]),
    "concave quads": lambda: mesh_of(
        [(0, 0, 0), (1, 1, 0), (0, 0.2, 0), (-1, 1, 0), (4, 2, 0), (5, 3, 1)], [(0, 1, 2, 3), (1, 2, 3, 0), (2, 3, 0, 1), (1, 4, 5)]
    ),
    "a crumpled grid": crumpled_grid,
}


@pytest.mark.parametrize("make", MESHES.values(), ids=MESHES.keys())
def test_triangles_are_blenders_own(make):
    data = make()
    mesh = extract_mesh(data, "test").mesh
    assert np.array_equal(mesh.triangles, blenders_triangles(data))
    positions = np.empty(3 * len(data.vertices), dtype=np.float32)
    data.vertices.foreach_get("co", positions)
    assert np.array_equal(mesh.positions_os, positions.reshape(-1, 3))
    assert mesh.triangles.dtype == np.int32


@pytest.mark.parametrize("start", range(6))
def test_concave_face_keeps_its_area(start):
    """An L of area 5: a fan from a wrong corner would cover more."""
    mesh = extract_mesh(mesh_of(L_SHAPE, [[*range(start, 6), *range(start)]]), "L").mesh
    assert area_of(mesh) == pytest.approx(5.0)


def test_smooth_mesh_has_one_normal_a_vertex():
    mesh = extract_mesh(shade(primitive("create_icosphere", subdivisions=3, radius=2.0), True), "ball").mesh
    assert mesh.corner_normals_os is None
    assert np.allclose(mesh.point_normals_os, mesh.positions_os / 2.0, atol=0.01)


def test_flat_mesh_has_no_normals():
    mesh = extract_mesh(shade(primitive("create_icosphere", subdivisions=3, radius=2.0), False), "ball").mesh
    assert mesh.corner_normals_os is None
    assert mesh.point_normals_os is None


def test_sharp_edges_give_normals_per_corner():
    data = shade(primitive("create_cube", size=2.0), True)
    data.polygons[0].use_smooth = False
    mesh = extract_mesh(data, "cube").mesh
    assert mesh.point_normals_os is None
    assert mesh.corner_normals_os.shape == (12, 3, 3)
    expected = np.empty((len(data.loops), 3), dtype=np.float32)
    data.corner_normals.foreach_get("vector", expected.reshape(-1))
    for triangle, normals in zip(data.loop_triangles, mesh.corner_normals_os, strict=True):
        assert np.array_equal(normals, expected[list(triangle.loops)])


def test_custom_normals_are_kept():
    data = shade(primitive("create_icosphere", subdivisions=1, radius=1.0), True)
    data.normals_split_custom_set_from_vertices([(0.0, 0.6, 0.8)] * len(data.vertices))
    mesh = extract_mesh(data, "ball").mesh
    assert np.allclose(mesh.corner_normals_os, (0.0, 0.6, 0.8), atol=1e-3)


def test_loose_vertices_and_edges_are_nothing():
    data = bpy.data.meshes.new("loose")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1)], [])
    assert extract_mesh(data, "loose").mesh is None


@pytest.mark.parametrize("is_smooth", [False, True])
@pytest.mark.parametrize("broken", [np.nan, -np.inf, np.finfo(np.float32).max])
def test_vertices_that_are_not_finite_are_dropped_with_their_triangles(broken, is_smooth):
    data = shade(primitive("create_grid", x_segments=10, y_segments=10, size=1.0), is_smooth)
    positions = np.empty(3 * len(data.vertices), dtype=np.float32)
    data.attributes["position"].data.foreach_get("vector", positions)
    positions[3 * 60 + 2] = broken  # not through `co`, which makes an infinite number a finite one
    data.attributes["position"].data.foreach_set("vector", positions)
    data.update()
    extracted = extract_mesh(data, "grid")
    assert extracted.dropped_vertex_count == 1
    mesh = extracted.mesh
    assert 60 not in mesh.triangles
    assert 194 <= mesh.triangle_count < 200
    assert np.isfinite(mesh.positions_os).all()
    assert np.abs(mesh.bounds_os).max() == pytest.approx(1.0)
    if is_smooth:
        assert np.isfinite(mesh.point_normals_os).all()
        assert np.allclose(np.linalg.norm(mesh.point_normals_os, axis=1), 1.0, atol=1e-5)


def test_sharp_mesh_beside_a_broken_vertex_keeps_unit_normals():
    data = shade(primitive("create_grid", x_segments=10, y_segments=10, size=1.0), True)
    data.polygons[0].use_smooth = False
    data.vertices[60].co.z = np.nan
    mesh = extract_mesh(data, "grid").mesh
    assert mesh.corner_normals_os.shape == (mesh.triangle_count, 3, 3)
    assert np.allclose(np.linalg.norm(mesh.corner_normals_os, axis=2), 1.0, atol=1e-4)


def test_mesh_of_broken_vertices_only_has_no_triangles():
    extracted = extract_mesh(mesh_of([(np.nan, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]), "broken")
    assert extracted.mesh is None
    assert extracted.dropped_vertex_count == 1


CUBE = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)],
    dtype=np.int32,
)


def test_cube_is_closed():
    assert is_closed(CUBE, 8)
    assert is_closed(CUBE[:, [0, 2, 1]], 8)


@pytest.mark.parametrize("face", range(12))
def test_cube_without_a_face_or_with_one_turned_over_is_open(face):
    assert not is_closed(np.delete(CUBE, face, axis=0), 8)
    turned = CUBE.copy()
    turned[face] = turned[face, [0, 2, 1]]
    assert not is_closed(turned, 8)


def test_closedness_of_several_islands():
    two = np.concatenate([CUBE, CUBE + 8])
    assert is_closed(two, 16)
    assert not is_closed(two[:-1], 16)
    with_hole_and_its_reverse_elsewhere = np.concatenate([CUBE[:-1], (CUBE + 8)[:, [0, 2, 1]][:-1]])
    assert not is_closed(with_hole_and_its_reverse_elsewhere, 16)


def test_three_sheets_at_an_edge_are_open_and_four_are_closed():
    sharing_an_edge = CUBE + 8
    sharing_an_edge = np.where(sharing_an_edge == 8, 0, np.where(sharing_an_edge == 9, 1, sharing_an_edge))
    assert is_closed(np.concatenate([CUBE, sharing_an_edge]), 16)
    assert not is_closed(np.concatenate([CUBE, [(0, 1, 8)]]), 16)


def test_vertices_that_only_coincide_do_not_close():
    data = primitive("create_cube", size=2.0)
    assert extract_mesh(data, "cube").mesh.is_closed
    split = bmesh.new()
    split.from_mesh(data)
    bmesh.ops.split_edges(split, edges=split.edges)
    split.to_mesh(data)
    split.free()
    assert not extract_mesh(data, "cube").mesh.is_closed


CUBE_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)


def test_which_way_faces_look():
    inside_out = CUBE[:, [0, 2, 1]]
    far = CUBE_CORNERS * np.float32(1e-2) + np.float32(1e3)
    for corners in (CUBE_CORNERS, CUBE_CORNERS - np.float32(0.5), far):
        assert faces_outward(corners, CUBE) is not faces_outward(corners, inside_out)
    outward = CUBE if faces_outward(CUBE_CORNERS, CUBE) else inside_out
    inward = outward[:, [0, 2, 1]]
    both = np.concatenate([3 * CUBE_CORNERS, CUBE_CORNERS + 5])
    assert faces_outward(both, np.concatenate([outward, outward + 8]))
    assert not faces_outward(both, np.concatenate([outward, inward + 8]))
    assert not faces_outward(both, np.concatenate([inward, outward + 8])[::-1])


def test_a_mesh_turned_inside_out_keeps_its_back_faces():
    data = primitive("create_uvsphere", u_segments=16, v_segments=8, radius=1.0)
    assert extract_mesh(data, "ball").mesh.is_closed
    data.flip_normals()
    assert not extract_mesh(data, "ball").mesh.is_closed


def test_a_missing_triangle_among_many_is_noticed():
    """More triangles than are looked at together, and more vertices than have their numbers kept."""
    data = primitive("create_icosphere", subdivisions=7, radius=1.0)
    mesh = extract_mesh(data, "ball").mesh
    assert mesh.triangle_count == 81920
    assert mesh.is_closed
    for missing in (0, 40000, 81919):
        assert not is_closed(np.delete(mesh.triangles, missing, axis=0), mesh.vertex_count)
