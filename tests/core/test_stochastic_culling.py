"""How many triangles stochastic culling leaves, against the probability that the papers give it."""

import numpy as np
import pytest

from tests.scenes import floor, perspective_camera, prepared_renderer, render_batches, snapshot, sun_light
from vir_addon.core.errors import UsageError
from vir_addon.core.scene import Mesh
from vir_addon.core.settings import Method, PointStorage, Settings

TRIANGLE_COUNT = 40_000
LARGEST_AREA_M2 = 6e-4


def level_triangles():
    """Of all areas from nothing to LARGEST_AREA_M2, level at different heights. To a sun that shines straight down their areas in texels
    are those in square metres over a texel's."""
    generator = np.random.default_rng(11)
    area = generator.uniform(0, LARGEST_AREA_M2, TRIANGLE_COUNT)
    centre = generator.uniform((-1, -1, 0.5), (1, 1, 0.9), (TRIANGLE_COUNT, 3))
    turn = generator.uniform(0, 2 * np.pi, TRIANGLE_COUNT)[:, None] + np.arange(3) * 2 * np.pi / 3
    # an equilateral triangle of this circumradius has that area
    radius = np.sqrt(area * 4 / (3 * np.sqrt(3)))[:, None, None]
    corners = centre[:, None] + radius * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    return Mesh("level", corners.reshape(-1, 3).astype(np.float32), np.arange(3 * TRIANGLE_COUNT, dtype=np.int32).reshape(-1, 3)), area


@pytest.mark.parametrize("method", [Method.IVIR, Method.HYBRID])
def test_as_many_triangles_are_culled_as_published(device, method):
    """1 - 10 A of those below a tenth of a texel (Gavane and Watson 2022), 1 - 8 A of those below an eighth (2020)."""
    mesh, area_m2 = level_triangles()
    camera = perspective_camera((0.0, -6.0, 4.0), (0.0, 0.0, 0.0), 64, 36)
    scene = snapshot([mesh, floor(3.0)], [sun_light(angle_rad=0.02)], camera, 64, 36)
    culled = {}
    for threshold in (1 / 10, 1 / 8):
        arguments = {"method": method, "culling_area_texels": threshold, "view_count": 8, "map_resolution_px": 64}
        for storage in PointStorage:
            with prepared_renderer(scene, device, points=storage, **arguments) as renderer:
                render_batches(renderer)
                (work,) = renderer.works
                ((fitted, _, _),) = work.faces
                culled.setdefault(threshold, set()).add(work.statistics.culled_triangle_count)
        area_texels = area_m2 / np.prod(fitted.views.texel_tangent)
        assert 2 * threshold < area_texels.max() < 20 * threshold
        chance = np.maximum(1 - area_texels / threshold, 0)
        sigma = np.sqrt((chance * (1 - chance)).sum())
        print(f"{threshold}: {culled[threshold]} culled, {chance.sum():.0f} +- {sigma:.0f} expected")
        (count,) = culled[threshold]
        assert abs(count - chance.sum()) <= 4 * sigma
    assert max(culled[1 / 8]) > max(culled[1 / 10])


@pytest.mark.parametrize("area", [0.0, -0.1, 1.5, float("nan")])
def test_what_is_larger_than_a_texel_is_never_culled(area):
    with pytest.raises(UsageError, match="at most 1 texel"):
        Settings(culling_area_texels=area)
