"""Times beside the quality slider are the plan's own where it was made, and between its steps they lie between them."""

import pytest

from tests.scenes import area_light, box, bumpy_sphere, floor, mirror, perspective_camera, point_light, snapshot
from vir_addon.core import light_plan
from vir_addon.core import plan as planning
from vir_addon.core.forecast import make_forecast, predict_error
from vir_addon.core.plan import PlannedOnce, plan
from vir_addon.core.quality import MAP_RESOLUTIONS_PX, map_resolution_of_views
from vir_addon.core.settings import Effect, Settings


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


@pytest.fixture(scope="module")
def lamps():
    """A picture and surfaces that take long however few views there are."""
    lights = [point_light(f"lamp {k}", (0.5 * (k % 6) - 1.25, 0.5 * (k // 6) - 1.0, 2.0), 0.1) for k in range(6)]
    meshes = [floor(4.0), *(box(f"box {k}", (0.6 * k - 1.5, 0.4 * k - 1, 0.3), (0.2, 0.2, 0.3)) for k in range(6))]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), 960, 540)
    return snapshot([*meshes, bumpy_sphere("ball", (0, 0, 1.2), 0.6, 200)], lights, camera, 960, 540)


def test_what_every_picture_takes_counts_once(lamps):
    forecast = make_forecast(lamps, plan(lamps, Settings()))
    for count in (1, 2, 5, 16, 24, 31, 32, 48, 65, 96, 127, 128, 192, 256, 1024):
        settings = Settings(view_count=count, map_resolution_px=map_resolution_of_views(count))
        assert forecast.compute_ms(count, settings.map_resolution_px) == pytest.approx(plan(lamps, settings).predicted_ms, rel=0.12)


def test_faces_are_fitted_once_for_every_map_resolution(lamps, monkeypatch):
    planned = plan(lamps, Settings())
    fitted = []

    def noting(snapshot, light, *rest):
        fitted.append(light.name)
        return fit_light(snapshot, light, *rest)

    fit_light = light_plan.fit_light
    monkeypatch.setattr(light_plan, "fit_light", noting)
    make_forecast(lamps, planned)
    assert len(fitted) == len(lamps.lights) * len(MAP_RESOLUTIONS_PX)


def test_shared_faces_do_not_change_plans(lamps):
    shared = PlannedOnce()
    for count, resolution_px in ((8, 512), (64, 1024), (128, 1024)):
        settings = Settings(view_count=count, map_resolution_px=resolution_px)
        assert plan(lamps, settings, once=shared).passes == plan(lamps, settings).passes


@pytest.fixture(scope="module")
def mirrors():
    """Two of them, so that there is more than one bounce to choose from."""
    meshes = [floor(4.0), *(bumpy_sphere(f"ball {k}", (1.5 * k - 0.75, 0, 0.6), 0.5, 12) for k in range(2))]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), 96, 54)
    return snapshot(meshes, [point_light("lamp", (0, 0, 4), 0.2)], camera, 96, 54, materials=[mirror() for _ in meshes])


REFLECTING = (Effect.SHADOW, Effect.REFLECTION)


def test_reflectors_are_chosen_once(mirrors, monkeypatch):
    planned = plan(mirrors, Settings(effects=REFLECTING))
    chosen = []

    def noting(*args):
        chosen.append(args)
        return choose_reflectors(*args)

    choose_reflectors = planning.choose_reflectors
    monkeypatch.setattr(planning, "choose_reflectors", noting)
    make_forecast(mirrors, planned)
    assert len(chosen) == 1


def test_shared_reflectors_do_not_change_plans(mirrors):
    shared = PlannedOnce()
    for count, resolution_px in ((8, 512), (256, 2048), (64, 1024)):
        settings = Settings(effects=REFLECTING, view_count=count, map_resolution_px=resolution_px)
        own, sharing = plan(mirrors, settings), plan(mirrors, settings, once=shared)
        assert own.reflections.runs and own.reflections.bounces == sharing.reflections.bounces
        assert [(line.name, line.runs, line.reason) for line in own.reflections.lines] == [
            (line.name, line.runs, line.reason) for line in sharing.reflections.lines
        ]
        assert (own.predicted_ms, own.batch_count, own.eye_sample_count) == (
            sharing.predicted_ms,
            sharing.batch_count,
            sharing.eye_sample_count,
        )


def test_more_views_mean_less_error():
    assert predict_error(0.02, 64, 64) == 0.02
    assert predict_error(0.02, 64, 256) < 0.02 < predict_error(0.02, 64, 16)
