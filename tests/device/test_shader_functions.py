"""The functions in gpu_shaders/lib on the device, against the same mathematics in float64."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tests.device.kernels import DIRECTIONS, ENLARGED_FACES, HASHES, SHADOW_VOLUMES, TRIANGLE_FUNCTIONS
from vir_addon.core.passes.scene_data import pack_directions
from vir_addon.device.interface import LINEAR_TEXTURE_WIDTH, TextureFormat


def linear_texture(device, count, texture_format=TextureFormat.RGBA32F):
    return device.create_texture(LINEAR_TEXTURE_WIDTH, -(-count // LINEAR_TEXTURE_WIDTH), texture_format)


def read_rows(device, texture, count):
    return device.read(texture).reshape(-1, 4)[:count].astype(np.float64)


# octahedral.glsl


def some_directions(count):
    directions = np.random.default_rng(3).normal(size=(count, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    diagonals = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    equator = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 24)])
    directions = np.concatenate([axes, diagonals, equator, directions])[:count]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))


def test_directions_survive_packing_on_host_and_device(device):
    directions = some_directions(100_000)
    packed_by_host = pack_directions(directions)
    given = device.upload_array(np.column_stack([directions, packed_by_host]))
    unpacked = linear_texture(device, 2 * len(directions))
    device.compute_kernel(DIRECTIONS).dispatch_linear(len(directions), directions=given, unpacked=unpacked, direction_count=len(directions))
    rows = read_rows(device, unpacked, 2 * len(directions)).reshape(-1, 2, 4)
    packed_here = rows[:, 0, 3]
    np.testing.assert_array_equal(rows[:, 1, 3], packed_by_host)
    assert packed_by_host.max() < 1 << 24
    for who in range(2):
        assert degrees_between(rows[:, who, :3], directions).max() < 0.06
        np.testing.assert_allclose(np.linalg.norm(rows[:, who, :3], axis=1), 1, atol=1e-6)
    # float32 rounds a few to the neighbouring step
    assert (packed_here != packed_by_host).mean() < 0.005


# hash.glsl

HASH_COUNT = 1 << 19


def pcg_hash(values):
    values = np.asarray(values, np.uint32)
    state = values * np.uint32(747796405) + np.uint32(2891336453)
    word = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    return (word >> np.uint32(22)) ^ word


def hash_position(positions):
    x, y, z = np.ascontiguousarray(positions, np.float32).view(np.uint32).T
    return pcg_hash(x ^ pcg_hash(y ^ pcg_hash(z)))


def hashes_of(device):
    outputs = {
        "integer_hashes": linear_texture(device, HASH_COUNT, TextureFormat.R32UI),
        "position_hashes": linear_texture(device, HASH_COUNT, TextureFormat.R32UI),
        "unit_floats": linear_texture(device, HASH_COUNT),
    }
    device.compute_kernel(HASHES).dispatch_linear(HASH_COUNT, hash_count=HASH_COUNT, **outputs)
    read = {name: device.read(texture).reshape(HASH_COUNT, -1)[:, 0] for name, texture in outputs.items()}
    for texture in outputs.values():
        texture.release()
    return read


def test_hashes_are_the_host_s_bit_for_bit(device):
    index = np.arange(HASH_COUNT)
    positions = np.stack([index & 127, (index >> 7) & 127, index >> 14], axis=1) * np.float32(0.25) - np.float32(8.0)
    hashes = hashes_of(device)
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(hashes["integer_hashes"], pcg_hash(index))
        np.testing.assert_array_equal(hashes["position_hashes"], hash_position(positions))
    np.testing.assert_array_equal(hashes["unit_floats"], (hashes["integer_hashes"] >> 8) / np.float32(1 << 24))


@pytest.mark.parametrize("name", ["integer_hashes", "position_hashes"])
@pytest.mark.parametrize("shift", [0, 8, 16, 24])
def test_each_byte_of_a_hash_is_uniform(device_called, name, shift):
    hashes = hashes_of(device_called("moderngl"))[name]
    counts = np.bincount((hashes >> shift) & 0xFF, minlength=256)
    # the hash has no seed: either it passes for ever or it is not uniform
    assert 1e-3 < stats.chisquare(counts).pvalue < 1 - 1e-3


def test_hashes_of_neighbours_are_independent(device_called):
    hashes = hashes_of(device_called("moderngl"))["integer_hashes"]
    pairs = np.histogram2d(hashes[:-1] >> 28, hashes[1:] >> 28, bins=16)[0]
    assert stats.chi2_contingency(pairs).pvalue > 1e-3


# triangle_sampling.glsl

TRIANGLE_COUNT = 20_000
FEW_ULPS = 2e-6  # of the triangles' size, which is about 1


def some_triangles(random):
    corners = random.uniform(-1, 1, (TRIANGLE_COUNT, 3, 3))
    # slivers, which meshes are full of: the third corner close to the line through the others
    slivers = corners[: TRIANGLE_COUNT // 4]
    along = random.uniform(-0.2, 1.2, (len(slivers), 1))
    slivers[:, 2] = slivers[:, 0] + along * (slivers[:, 1] - slivers[:, 0]) + random.normal(scale=0.01, size=(len(slivers), 3))
    return corners.astype(np.float32).astype(np.float64)


@pytest.fixture(scope="module")
def answers(device):
    """Queries and what the functions answered, float64."""
    random = np.random.default_rng(4)
    corners = some_triangles(random)
    points = random.uniform(-2, 2, (TRIANGLE_COUNT, 3)).astype(np.float32)
    # rectangles from a tenth of a triangle to its size, many across its edges
    half_sizes = 10 ** random.uniform(-1.5, -0.3, (TRIANGLE_COUNT, 2))
    rectangles = np.concatenate([random.uniform(-0.9, 0.9, (TRIANGLE_COUNT, 2)), half_sizes], axis=1).astype(np.float32)
    queries = np.zeros((TRIANGLE_COUNT, 2, 4), np.float32)
    queries[:, 0, :3], queries[:, 1] = points, rectangles
    output = linear_texture(device, 5 * TRIANGLE_COUNT)
    unused = {
        "face": np.zeros((11, 4)),
        "hull": np.zeros((1, 4)),
        "hull_box": np.zeros((2, 4)),
        "eye": np.zeros((2, 4)),
        "seen_space": np.zeros((6, 4)),
        "window_bounds": np.zeros(4),
        "hull_count": 0,
    }
    device.compute_kernel(TRIANGLE_FUNCTIONS).dispatch_linear(
        TRIANGLE_COUNT,
        triangle_corners=device.upload_array(np.pad(corners.reshape(-1, 3), ((0, 0), (0, 1)))),
        queries=device.upload_array(queries.reshape(-1, 4)),
        answers=output,
        triangle_count=TRIANGLE_COUNT,
        **unused,
    )
    rows = read_rows(device, output, 5 * TRIANGLE_COUNT).reshape(-1, 5, 4)
    return {
        "corners": corners,
        "points": points.astype(np.float64),
        "rectangles": rectangles.astype(np.float64),
        "closest": rows[:, 0, :3],
        "overlaps": rows[:, 0, 3] > 0.5,
        "nearest_uv": rows[:, 1, :2],
        "corners_uv": np.stack([rows[:, 1, 2:], rows[:, 2, :2], rows[:, 2, 2:]], axis=1),
        "normal": rows[:, 3, :3],
        "area": rows[:, 3, 3],
        "third_corner": rows[:, 4, :3],
    }


def closest_in_triangles(points, corners):
    """(n, d) points and (n, 3, d) triangles -> (n, d): the nearest of the plane's and the three edges' nearest points."""
    edges = np.roll(corners, -1, axis=1) - corners
    share = ((points[:, None] - corners) * edges).sum(-1) / (edges * edges).sum(-1)
    candidates = corners + edges * np.clip(share, 0, 1)[..., None]
    nearest = np.linalg.norm(points[:, None] - candidates, axis=-1).argmin(axis=1)
    on_edge = candidates[np.arange(len(points)), nearest]
    # barycentric coordinates by least squares in the plane
    basis = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    weights = (np.linalg.pinv(basis) @ (points - corners[:, 0])[..., None])[..., 0]
    inside = (weights >= 0).all(axis=1) & (weights.sum(axis=1) <= 1)
    in_plane = corners[:, 0] + (basis @ weights[..., None])[..., 0]
    return np.where(inside[:, None], in_plane, on_edge)


def distances(a, b):
    return np.linalg.norm(a - b, axis=-1)


def test_aligned_triangles_keep_their_shape(answers):
    corners, corners_uv = answers["corners"], answers["corners_uv"]
    np.testing.assert_allclose(corners_uv.mean(axis=1), 0, atol=FEW_ULPS)
    lengths = distances(corners, np.roll(corners, -1, axis=1))
    # slivers lose some of their height to float32's normal
    np.testing.assert_allclose(distances(corners_uv, np.roll(corners_uv, -1, axis=1)), lengths, atol=1e-5)
    scaled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(answers["area"], np.linalg.norm(scaled, axis=1) / 2, atol=FEW_ULPS)
    assert distances(answers["third_corner"], corners[:, 2]).max() < 1e-5
    good = answers["area"] > 1e-3
    assert degrees_between(answers["normal"], scaled)[good].max() < 0.05


def test_triangles_lie_along_their_longest_edge_counter_clockwise(answers):
    corners_uv = answers["corners_uv"]
    edges = np.roll(corners_uv, -1, axis=1) - corners_uv
    squared = (edges**2).sum(axis=-1)
    # the first of those that are almost the longest: rounding must not choose between two
    chosen = (squared >= 0.99 * squared.max(axis=1, keepdims=True)).argmax(axis=1)
    assert 0 < (chosen != squared.argmax(axis=1)).mean() < 0.1
    assert np.abs(edges[np.arange(len(edges)), chosen, 1]).max() < 1e-5
    assert (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]).min() > 0


def test_closest_point_of_a_triangle(answers):
    expected = closest_in_triangles(answers["points"], answers["corners"])
    found = answers["closest"]
    # the point is unique, but where a sliver's height is lost in rounding it may slide along
    excess = distances(found, answers["points"]) - distances(expected, answers["points"])
    assert np.abs(excess).max() < 1e-4
    assert distances(closest_in_triangles(found, answers["corners"]), found).max() < 1e-4
    assert np.quantile(distances(found, expected), 0.99) < 1e-5


def test_nearest_point_to_a_cell(answers):
    centers, corners_uv, found = answers["rectangles"][:, :2], answers["corners_uv"], answers["nearest_uv"]
    expected = closest_in_triangles(centers, corners_uv)
    assert np.abs(distances(found, centers) - distances(expected, centers)).max() < FEW_ULPS
    assert distances(closest_in_triangles(found, corners_uv), found).max() < FEW_ULPS
    inside = distances(expected, centers) == 0
    assert inside.any() and (found[inside] == centers[inside]).all()


def clipped(polygon, center, half_size):
    """What a rectangle leaves of a convex polygon (Sutherland & Hodgman 1974), corners in order."""
    for axis in range(2):
        for sign in (-1.0, 1.0):
            inside = [sign * (p[axis] - center[axis]) <= half_size[axis] for p in polygon]
            left = []
            for k, p in enumerate(polygon):
                q = polygon[k - 1]
                if inside[k] != inside[k - 1]:
                    limit = center[axis] + sign * half_size[axis]
                    left.append(q + (p - q) * (limit - q[axis]) / (p[axis] - q[axis]))
                if inside[k]:
                    left.append(p)
            polygon = left
    return polygon


def test_rectangles_overlap_where_clipping_leaves_something(answers):
    some = slice(None, None, 5)  # the reference is slow
    margin = 1e-5  # nearer to touching than this either answer is right
    overlaps = answers["overlaps"][some]
    cases = list(zip(answers["corners_uv"][some], answers["rectangles"][some], strict=True))
    surely = np.array([bool(clipped(list(uv), r[:2], r[2:] - margin)) for uv, r in cases])
    perhaps = np.array([bool(clipped(list(uv), r[:2], r[2:] + margin)) for uv, r in cases])
    assert overlaps[surely].all()
    assert not overlaps[~perhaps].any()
    assert 0.2 < overlaps.mean() < 0.8 and (surely != perhaps).mean() < 0.01


VOLUME_COUNT = 400
FAR_M = 12.0


def shadow_points(random, center, radius, light_center, light_half, count=4000):
    """Places that a ball shadows from some point of a box of light, as far as FAR_M deep; half of them along the outline."""
    light = light_center + random.uniform(-1, 1, (count, 3)) * light_half
    offset = random.normal(size=(count, 3))
    away = (center - light_center) / np.linalg.norm(center - light_center)
    offset[::2] -= (offset[::2] @ away)[:, None] * away
    on_ball = center + radius * offset / np.linalg.norm(offset, axis=1, keepdims=True)
    places = (
        on_ball + (on_ball - light) * np.concatenate([random.uniform(0, 1, count // 2), 10 ** random.uniform(-2, 2, count // 2)])[:, None]
    )
    return places[places[:, 2] <= FAR_M + light[:, 2]]


def test_distance_to_a_shadow_volume_is_a_close_lower_bound(device):
    """Of Gavane & Watson 2022 b, figure 9, against random places of the volume."""
    random = np.random.default_rng(8)
    centers = random.uniform([-3, -3, 2], [3, 3, 8], (VOLUME_COUNT, 3))
    radii = 10 ** random.uniform(-2, 0, VOLUME_COUNT)
    eye, light_center, light_half = np.array([1.0, -4.0, 3.0]), np.array([0.2, 0.1, 0.0]), np.array([0.2, 0.1, 0.15])
    face = np.zeros((13, 4))
    face[4, :2] = 1e-3, FAR_M
    output = linear_texture(device, VOLUME_COUNT)
    device.compute_kernel(SHADOW_VOLUMES).dispatch_linear(
        VOLUME_COUNT,
        balls=device.upload_array(np.column_stack([centers, radii])),
        distances=output,
        ball_count=VOLUME_COUNT,
        face=face,
        hull=np.zeros((1, 4)),
        hull_box=np.pad([light_center, light_half], ((0, 0), (0, 1))),
        eye=np.pad([eye, np.zeros(3)], ((0, 0), (0, 1))),
        seen_space=np.zeros((6, 4)),
        window_bounds=np.zeros(4),
        hull_count=0,
    )
    found = read_rows(device, output, VOLUME_COUNT)[:, 0]
    true = np.array(
        [
            np.linalg.norm(shadow_points(random, center, radius, light_center, light_half) - eye, axis=1).min()
            for center, radius in zip(centers, radii, strict=True)
        ]
    )
    assert (found <= true + 1e-4).all()
    # of small balls the samples are dense enough to say how close it is
    small = (radii < 0.1) & (true > 1.0)
    assert small.sum() > 50
    assert np.median(found[small] / true[small]) > 0.9 and (found[small] / true[small]).min() > 0.5


# enlarged_faces.glsl


def faces_of(places):
    """(n,) int numbers of the faces of a cube that see places, (n, 3)"""
    axes = np.abs(places).argmax(axis=1)
    return 2 * axes + (np.take_along_axis(places, axes[:, None], axis=1)[:, 0] < 0)


def test_faces_that_may_see_a_triangle_are_those_of_enlarged_frusta_and_all_that_do(device):
    """Triangles around cubes' edges and corners, of a hundredth of their distance to several times that."""
    rng = np.random.default_rng(5)
    count = 20_000
    middles = rng.uniform(-1, 1, (count, 3)).round(1) + rng.normal(0, 0.02, (count, 3))
    sizes = 10 ** rng.uniform(-3, 0.5, (count, 1, 1))
    corners = (middles[:, None] + sizes * rng.normal(size=(count, 3, 3))).astype(np.float32).astype(np.float64)
    rows = np.concatenate([corners.reshape(-1, 3), np.zeros((3 * count, 1))], axis=1).astype(np.float32)
    faces = linear_texture(device, count, TextureFormat.R32UI)
    device.compute_kernel(ENLARGED_FACES).dispatch_linear(
        count, triangle_corners=device.upload_array(rows), faces=faces, triangle_count=count
    )
    found = device.read(faces).reshape(-1)[:count].astype(np.int64)
    # none that sees a place of the triangle is left out
    for weights in rng.dirichlet((0.5, 0.5, 0.5), 200):
        places = np.einsum("k,nki->ni", weights, corners)
        clear = np.sort(np.abs(places), axis=1)
        seen = faces_of(places)
        left_out = (found >> seen & 1) == 0
        # on the faces' edge itself float32 may choose either
        assert not (left_out & (clear[:, 2] > clear[:, 1] * (1 + 1e-5))).any()
    # small ones have those faces alone that are a fifth too large for a corner to be outside
    depths = np.abs(corners).max(axis=2)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    own = faces_of(corners.reshape(-1, 3)).reshape(-1, 3)
    is_within = (own == own[:, :1]).all(axis=1)
    np.testing.assert_array_equal(found[is_within], 1 << own[is_within, 0])
    is_small = ~is_within & (12.001 * edges < depths.min(axis=1))
    assert is_small.sum() > 100
    expected = np.zeros(count, np.int64)
    for face in range(6):
        depth = corners[..., face // 2] * (1 - 2 * (face % 2))
        others = np.abs(np.delete(corners, face // 2, axis=2)).max(axis=2)
        expected |= (others <= 1.2 * depth).any(axis=1).astype(np.int64) << face
    assert (found[is_small] != expected[is_small]).mean() < 0.002
    assert (found[~is_within & (11.999 * edges > depths.min(axis=1))] == 63).all()
