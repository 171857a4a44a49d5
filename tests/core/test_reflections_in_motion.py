"""Reflections of a still scene that a camera moves through change no more than they should."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.core.test_reflections import box_colors, camera_rays, colored_box, mirrored_colors
from tests.scenes import box, bumpy_sphere, matte, mirror, perspective_camera, prepared_renderer, render_batches, snapshot
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.scene import FilterShape, Mesh, PixelFilter
from vir_addon.core.settings import Effect, ReflectionMethod

WIDTH, HEIGHT, HALF_M, RADIUS_M = 96, 54, 3.0, 0.8
STEPS, TURN_RAD = 20, np.radians(1.0)
SPARSE = {"points_per_eye_pixel": 0.05}
"""so that fewer triangles are enough for half of them to be left out"""


def camera_at(step):
    """So far away that the sphere's cube gets a step smaller on the way."""
    angle = TURN_RAD * step / STEPS
    return perspective_camera((-2.626 * np.cos(angle), -2.626 * np.sin(angle) - 0.4, 0.5), (0, 0, 0), WIDTH, HEIGHT, 0.4)


def finely_divided(wall, count):
    """The same rectangle of 2 count^2 triangles."""
    corner, side_u, _, side_v = wall.positions_os.astype(np.float64)
    u, v = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1), indexing="ij")
    positions = corner + u.reshape(-1, 1) * (side_u - corner) + v.reshape(-1, 1) * (side_v - corner)
    first = ((count + 1) * np.arange(count)[:, None] + np.arange(count)).reshape(-1)
    right, above, both = first + count + 1, first + 1, first + count + 2
    triangles = np.concatenate([np.column_stack([first, right, both]), np.column_stack([first, both, above])])
    return Mesh(wall.name, positions.astype(np.float32), triangles.astype(np.int32))


@pytest.mark.parametrize(
    ("method", "count", "choices"),
    [(ReflectionMethod.MVR, 50, {}), pytest.param(ReflectionMethod.EPR, 200, SPARSE, marks=pytest.mark.slow)],
)
def test_reflections_flicker_hardly_more_than_rays_of_each_frame_do(device, method, count, choices):
    """A degree in twenty steps around a mirror sphere in a coloured box of fine triangles: edges move over as many pixels as they should,
    and over each of them once. One pixel in two thousand a frame may change back, one in two hundred where the map's size does."""
    walls, materials = colored_box(HALF_M)
    walls = [finely_divided(wall, count) for wall in walls]
    ball = bumpy_sphere("ball", (0, 0, 0), RADIUS_M, 96, bump_share=0.0)
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 1, "bounces": 1, "reflection_method": method, **choices}
    own, true, sizes = [], [], []
    for step in range(STEPS + 1):
        camera = camera_at(step)
        scene = snapshot([*walls, ball], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror()], world=World())
        with prepared_renderer(scene, device, **settings) as renderer:
            render_batches(renderer)
            passes, statistics = renderer.read_passes(), renderer.reflections.statistics
            sizes.append(renderer.reflections.planned.maps[0].width_px)
        assert method is ReflectionMethod.MVR or statistics.cloud_triangle_count < 0.5 * scene.instanced_triangle_count
        # not at its rim
        colors, _, distance = mirrored_colors(camera, WIDTH, HEIGHT, RADIUS_M, HALF_M)
        judged = distance < 0.95 * RADIUS_M
        assert (passes[REFLECTION_COLOR_PASS_NAME][judged] > 0.99).all()
        own.append(np.where(judged[..., None], passes[REFLECTION_PASS_NAME], np.nan))
        true.append(np.where(judged[..., None], colors, np.nan))
    assert set(sizes) == {96, 128}
    in_all = np.isfinite([own, true]).all(axis=(0, 1, 4))
    assert in_all.mean() > 0.1
    changed = np.abs(np.diff(np.array(own)[:, in_all], axis=0)).max(axis=-1) > 0.1
    moved, should_move = (np.abs(frames[-1] - frames[0])[in_all].max(axis=-1) > 0.1 for frames in (own, true))
    # not frame by frame: an edge that lies a tenth of a pixel aside passes a pixel some frames sooner or later
    assert should_move.sum() > 10
    assert 0.5 * should_move.sum() < moved.sum() < 2 * should_move.sum()
    again = np.maximum(changed.sum(axis=0) - moved, 0)
    is_resized = np.diff(sizes) != 0
    assert is_resized.sum() == 1
    assert again.sum() / changed.size < 0.0005
    assert changed[is_resized].mean() < 0.005


ROOM_HALF_M, TILE_M, TILE_COLOR, RAYS = 5.0, 0.5, (0.05, 0.05, 0.05), 8


def posts():
    """(n, 2, 3) lower and upper corners: as wide as a texel or two of the sphere's cube."""
    k = np.arange(14)
    angles, away = 2 * np.pi * k / 14 + 0.1, 1.5 + 0.45 * (k % 3)
    middles = np.column_stack([away * np.cos(angles), away * np.sin(angles), -1.0 + 0.4 * (k % 4)])
    halves = np.column_stack([0.03 + 0.02 * (k % 3), 0.03 + 0.02 * (k % 3), np.full(14, 0.9)])
    return np.stack([middles - halves, middles + halves], axis=1)


def tiles(count):
    """Every other one of a floor, a little above it."""
    place = np.array([(i, j) for i in range(count) for j in range(count) if (i + j) % 2 == 0])
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    xy = TILE_M * (place[:, None] + square).reshape(-1, 2) - ROOM_HALF_M
    first = 4 * np.arange(len(place))[:, None]
    triangles = (first[:, :, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    positions = np.column_stack([xy, np.full(len(xy), 0.01 - ROOM_HALF_M)])
    return Mesh("tiles", positions.astype(np.float32), triangles.astype(np.int32))


def meetings(boxes, origins, directions):
    """(n, box_count) distances to where rays enter boxes, infinite where they miss them."""
    with np.errstate(divide="ignore"):
        lower, upper = ((boxes[None, :, side] - origins[:, None]) / directions[:, None] for side in (0, 1))
    entered, left = np.minimum(lower, upper).max(axis=-1), np.maximum(lower, upper).min(axis=-1)
    return np.where((entered <= left) & (entered > 0), entered, np.inf)


def furnished_colors(camera, offset_px, post_colors):
    """(height, width, 3) what the sphere shows of the room with posts and tiles, nan where it does not show or a post is before it."""
    left, right, bottom, top = camera.window
    moved_x, moved_y = offset_px[0] * (right - left) / WIDTH, offset_px[1] * (top - bottom) / HEIGHT
    window = (left + moved_x, right + moved_x, bottom + moved_y, top + moved_y)
    eye, directions = camera_rays(dataclasses.replace(camera, window=window), WIDTH, HEIGHT)
    colors = np.full((HEIGHT, WIDTH, 3), np.nan)
    along = -directions @ eye
    distance = np.linalg.norm(eye + along[..., None] * directions, axis=-1)
    shown = distance < 0.95 * RADIUS_M
    incoming = directions[shown]
    traveled = along[shown] - np.sqrt(RADIUS_M**2 - distance[shown] ** 2)
    at = eye + traveled[:, None] * incoming
    outgoing = incoming - 2 * (incoming * at).sum(axis=1, keepdims=True) * at / RADIUS_M**2
    found, _ = box_colors(at, outgoing, ROOM_HALF_M)
    to_floor = np.where(outgoing[:, 2] < 0, (0.01 - ROOM_HALF_M - at[:, 2]) / np.minimum(outgoing[:, 2], -1e-12), np.inf)
    tile = np.floor((at[:, :2] + np.minimum(to_floor, 1e6)[:, None] * outgoing[:, :2] + ROOM_HALF_M) / TILE_M)
    on_floor = (tile >= 0).all(axis=1) & (tile < 2 * ROOM_HALF_M / TILE_M).all(axis=1) & (tile.sum(axis=1) % 2 == 0)
    found = np.where((on_floor & np.isfinite(to_floor))[:, None], TILE_COLOR, found)
    to_posts = meetings(posts(), at, outgoing)
    found = np.where(np.isfinite(to_posts).any(axis=1)[:, None], post_colors[to_posts.argmin(axis=1)], found)
    is_hidden = meetings(posts(), np.broadcast_to(eye, at.shape), incoming).min(axis=1) < traveled
    colors[shown] = np.where(is_hidden[:, None], np.nan, found)
    return colors


@pytest.mark.slow
@pytest.mark.parametrize(("method", "count", "choices"), [(ReflectionMethod.MVR, 1, {}), (ReflectionMethod.EPR, 40, SPARSE)])
def test_thin_things_in_a_mirror_change_hardly_more_than_in_the_true_pictures(device, method, count, choices):
    """Posts and tiles in a mirror sphere with a cube of 64 texels a side, a degree in twenty steps, eight rays of a pixel: all changes from
    frame to frame together. Those of true pictures a tenth of a pixel aside are up to 1.04 times as large."""
    walls, wall_materials = colored_box(ROOM_HALF_M)
    walls = [finely_divided(wall, count) for wall in walls]
    post_colors = np.random.default_rng(3).uniform(0, 1, (14, 3))
    boxes = [box(f"post {k}", low / 2 + high / 2, high / 2 - low / 2) for k, (low, high) in enumerate(posts())]
    ball = bumpy_sphere("ball", (0, 0, 0), RADIUS_M, 96, bump_share=0.0)
    materials = [*wall_materials, *(matte((0, 0, 0), color) for color in post_colors), matte((0, 0, 0), TILE_COLOR), mirror()]
    own, true = [], []
    for step in range(STEPS + 1):
        angle = TURN_RAD * (step / STEPS + 0.2)
        camera = perspective_camera((-4.2 * np.cos(angle), -4.2 * np.sin(angle) - 0.4, 0.5), (0, 0, 0), WIDTH, HEIGHT, 0.4)
        meshes = [*walls, *boxes, tiles(round(2 * ROOM_HALF_M / TILE_M)), ball]
        pixel_filter = PixelFilter(FilterShape.BOX, 1.0)
        scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=materials, world=World(), pixel_filter=pixel_filter)
        settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": RAYS, "bounces": 1, "reflection_method": method, **choices}
        with prepared_renderer(scene, device, **settings) as renderer:
            render_batches(renderer)
            own.append(renderer.read_passes()[REFLECTION_PASS_NAME])
            assert [each.width_px for each in renderer.reflections.planned.maps] == [64]
            eye = renderer.eye
            offsets_px = eye.base_offsets_px[eye.visibility_index] + eye.samples / eye.samples_per_px
        assert len(offsets_px) == RAYS
        true.append(np.mean([furnished_colors(camera, offset_px, post_colors) for offset_px in offsets_px], axis=0))
    judged = np.isfinite(true).all(axis=(0, 3))
    assert judged.mean() > 0.1
    assert np.abs(np.array(own) - true)[:, judged].mean() < 0.0125
    changes, true_changes = (np.abs(np.diff(np.array(frames)[:, judged], axis=0)).sum() for frames in (own, true))
    assert 0.9 * true_changes < changes < 1.15 * true_changes
