"""What a scene does not call for is not done, and the plan says why."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import area_light, box, bumpy_sphere, floor, perspective_camera, render_passes, snapshot
from vir_addon.core.errors import SceneError, UsageError
from vir_addon.core.plan import plan
from vir_addon.core.scene import LightShape
from vir_addon.core.settings import Method, PointStorage, Settings

WIDTH, HEIGHT = 48, 27


def scene_with(*lights, **arguments):
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    return snapshot(meshes, lights, camera, WIDTH, HEIGHT, **arguments)


def planned(scene, **settings):
    (only,) = plan(scene, Settings(**settings)).passes
    return only


SKIPPED = {
    "casts no shadow": (area_light(casts_shadow=False), 1.0),
    "has no strength": (area_light(strength=0.0), 1.0),
    "faces away": (area_light(eye=(0, 0, 5), target=(0, 0, 9)), 0.0),
    "light linking leaves it nothing": (area_light(receivers=np.zeros(2, bool)), 1.0),
    "nothing casts its shadow": (area_light(blockers=np.zeros(2, bool)), 1.0),
}


@pytest.mark.parametrize("reason", SKIPPED)
def test_no_work_for_nothing(device, reason):
    light, surface_value = SKIPPED[reason]
    scene = scene_with(light)
    line = planned(scene)
    assert not line.runs and line.view_count == 0 and line.predicted_ms == 0
    assert reason in line.reason
    image = render_passes(scene, device)["VIR Shadow Key"]
    assert set(np.unique(image)) <= {1.0, surface_value}
    assert (image == surface_value).any() and image[-1, 0] == 1


def test_other_kinds_of_light_are_named(device):
    point = dataclasses.replace(area_light("Bulb"), shape=LightShape.POINT)
    scene = scene_with(point, area_light())
    lines = {line.light_name: line for line in plan(scene, Settings()).passes}
    assert not lines["Bulb"].runs and "point light" in lines["Bulb"].reason
    assert lines["Key"].runs
    with pytest.raises(SceneError, match=r"'Bulb' \(point\)"):
        plan(scene_with(point), Settings())


def test_light_without_size_gets_one_view():
    line = planned(scene_with(area_light(size_m=(0.0, 0.0))), view_count=64)
    assert line.runs and line.view_count == 1 and "one view" in line.reason
    assert planned(scene_with(area_light(size_m=(1.0, 0.0))), view_count=64).view_count == 64


def test_unknown_light_is_answered_with_those_there_are():
    with pytest.raises(UsageError, match=r"'Sun'.*'Fill', 'Key'"):
        plan(scene_with(area_light(), area_light("Fill")), Settings(light_names=("Sun",)))


def test_no_light_at_all():
    with pytest.raises(SceneError, match="no light"):
        plan(scene_with(), Settings())


@pytest.mark.parametrize("method", list(Method))
def test_method_is_decided(method):
    line = planned(scene_with(area_light()), method=method)
    assert line.method is not Method.AUTO
    assert (line.points is None) == (line.method is Method.MVR)
    assert line.method.value in line.reason


def fine_scene(row_count, *lights):
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 0.8, row_count)]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    return snapshot(meshes, lights or [area_light()], camera, WIDTH, HEIGHT)


MORE_WORK = {
    "views": ({"view_count": 16}, {"view_count": 64}),
    "texels": ({"map_resolution_px": 256}, {"map_resolution_px": 1024}),
    "generations": ({"points": PointStorage.BUFFERED}, {"points": PointStorage.BUFFERLESS}),
}


@pytest.mark.parametrize("method", [Method.MVR, Method.IVIR])
@pytest.mark.parametrize("more", MORE_WORK)
def test_more_work_is_predicted_to_take_longer(method, more):
    few, many = (planned(fine_scene(40), method=method, **arguments).predicted_ms for arguments in MORE_WORK[more])
    assert few == many if (more, method) == ("generations", Method.MVR) else 0 < few < many


def test_rasterizing_is_predicted_to_take_as_long_as_there_are_views():
    few, many = (planned(fine_scene(40), method=Method.MVR, view_count=view_count).predicted_ms for view_count in (16, 64))
    assert many == pytest.approx(4 * few)


@pytest.mark.parametrize("method", [Method.MVR, Method.IVIR])
def test_more_triangles_are_predicted_to_take_longer(method):
    predicted = [planned(fine_scene(row_count), method=method).predicted_ms for row_count in (10, 40, 160)]
    assert predicted == sorted(predicted) and predicted[-1] > 1.1 * predicted[0]


def test_predictions_add_up():
    """Of all passes that run, and of the eye, which is there once."""
    lights = [area_light("Key"), area_light("Fill", strength=0.0), area_light("Rim", (3, 0, 3))]
    alone = [plan(fine_scene(40, light), Settings()) for light in lights]
    eye_ms = alone[0].predicted_ms - alone[0].passes[0].predicted_ms
    assert eye_ms > 0
    together = plan(fine_scene(40, *lights), Settings())
    assert together.predicted_ms == pytest.approx(sum(one.passes[0].predicted_ms for one in alone) + eye_ms)


@pytest.mark.parametrize("row_count", [4, 400])
def test_auto_takes_what_is_predicted_to_be_faster(row_count):
    scene = fine_scene(row_count)
    by_method = {method: planned(scene, method=method).predicted_ms for method in (Method.MVR, Method.IVIR)}
    line = planned(scene)
    assert line.predicted_ms == min(by_method.values()) == by_method[line.method]
    assert "times faster" in line.reason


@pytest.mark.parametrize("arguments", [{"view_count": 0}, {"view_count": 5000}, {"map_resolution_px": 8}, {"point_buffer_mib": 0}])
def test_settings_out_of_range(arguments):
    with pytest.raises(UsageError):
        Settings(**arguments)
