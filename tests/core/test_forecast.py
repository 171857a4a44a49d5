"""Times beside the quality slider are the plan's own where it was made, and between its steps they lie between them."""

import pytest

from tests.scenes import area_light, box, floor, perspective_camera, snapshot
from vir_addon.core.forecast import make_forecast, predict_error
from vir_addon.core.plan import plan
from vir_addon.core.quality import map_resolution_of_views
from vir_addon.core.settings import Settings


@pytest.fixture(scope="module")
def scene():
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), 48, 27)
    return snapshot([floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))], [area_light()], camera, 48, 27)


def test_what_was_planned_is_what_is_forecast(scene):
    settings = Settings(view_count=100, map_resolution_px=300)
    planned = plan(scene, settings)
    assert make_forecast(scene, planned).compute_ms(100, 300) == planned.predicted_ms


def test_elsewhere_it_is_near_a_plan_of_its_own(scene):
    forecast = make_forecast(scene, plan(scene, Settings()))
    for count in (8, 16, 24, 48, 96, 200, 512, 1024):
        settings = Settings(view_count=count, map_resolution_px=map_resolution_of_views(count))
        assert forecast.compute_ms(count, settings.map_resolution_px) == pytest.approx(plan(scene, settings).predicted_ms, rel=0.25)
    for resolution_px in (512, 1024, 2048):
        times = [forecast.compute_ms(count, resolution_px) for count in range(1, 1024, 20)]
        assert times == sorted(times) and times[0] > 0


def test_more_views_mean_less_error():
    assert predict_error(0.02, 64, 64) == 0.02
    assert predict_error(0.02, 64, 256) < 0.02 < predict_error(0.02, 64, 16)
