"""Large triangles become points in lists of a fixed size, however many tiles they take."""

import numpy as np
import pytest

from tests.scenes import area_light, box, leaves, perspective_camera, point_light, prepared_renderer, render_batches, render_pass, snapshot
from vir_addon.core.methods import part_cutting, shared
from vir_addon.core.methods.ivir import TILE_CELLS
from vir_addon.core.methods.shared import Counters, Counts
from vir_addon.core.settings import Method, PointStorage

WIDTH, HEIGHT = 96, 54
SETTINGS = {"method": Method.IVIR, "view_count": 8, "map_resolution_px": 128}


def lamp_at_the_ceiling():
    """It touches: no lattice is fine enough there."""
    meshes = [box("room", (0, 0, 1.35), (3, 2.5, 1.35), inside_out=True), box("table", (0.5, 0.2, 0.4), (0.6, 0.4, 0.4))]
    camera = perspective_camera((-2.8, -2.3, 1.6), (1, 1, 1), WIDTH, HEIGHT)
    return snapshot(meshes, [point_light(eye=(0, 0, 2.65), radius_m=0.1)], camera, WIDTH, HEIGHT)


def large_leaves():
    """In a hundred work groups."""
    mesh = leaves("leaves", (0, 0, 1.5), 1.5, 3_200, 0.5)
    camera = perspective_camera((0.5, -5.0, 3.5), (0, 0, 0.8), WIDTH, HEIGHT)
    return snapshot([mesh], [area_light(eye=(0.5, -0.5, 6.0), target=(0, 0, 0))], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("storage", PointStorage)
def test_lists_keep_their_size(device, monkeypatch, storage):
    monkeypatch.setattr(shared, "TILE_CAPACITY", 1 << 11)
    with prepared_renderer(lamp_at_the_ceiling(), device, points=storage, **SETTINGS) as renderer:
        render_batches(renderer)
        ((_, _, method),) = renderer.works[0].faces[:1]
        scratch = method.shared.point_scratch
        assert scratch.tiles.texel_count == shared.TEXELS_PER_TILE * shared.TILE_CAPACITY
        assert scratch.parts.texel_count == shared.TEXELS_PER_PART * shared.FIRST_PART_CAPACITY
        assert method.point_count > TILE_CELLS**2 * shared.TILE_CAPACITY, "one list is enough"


@pytest.mark.parametrize("storage", PointStorage)
@pytest.mark.parametrize("made", [lamp_at_the_ceiling, large_leaves])
def test_short_lists_make_the_same_picture(device, monkeypatch, made, storage):
    """So short that a few work groups are enough for the list of parts, and a few parts for that of tiles."""
    scene = made()
    image = render_pass(scene, device, points=storage, **SETTINGS)
    runs = []
    cutting = part_cutting.PartCutter.cutting

    def counted(cutter, kernel, run_tiles, part_count, **bindings):
        runs.append(part_count)
        return cutting(cutter, kernel, run_tiles, part_count, **bindings)

    monkeypatch.setattr(part_cutting.PartCutter, "cutting", counted)
    monkeypatch.setattr(shared, "TILE_CAPACITY", 1 << 11)
    monkeypatch.setattr(shared, "FIRST_PART_CAPACITY", 1 << 13)
    monkeypatch.setattr(part_cutting, "MOST_PART_CAPACITY", 1 << 13)
    np.testing.assert_array_equal(render_pass(scene, device, points=storage, **SETTINGS), image)
    assert 0 < max(runs) <= 1 << 12
    if made is large_leaves:
        assert len(runs) > 1


def test_counters_count_on_where_32_bits_end(device):
    counters = device.run(Counters, device)
    try:
        for step in (3, 1 << 31, 1 << 31, 1 << 31):
            before = device.run(counters.read)
            device.run(device.fill, counters.texture, (before.points + step) % (1 << 32))
            assert device.run(counters.read).points == before.points + step
        device.run(counters.clear)
        assert device.run(counters.read) == Counts()
    finally:
        device.run(counters.release)
