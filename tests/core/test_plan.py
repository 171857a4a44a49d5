"""What a scene does not call for is not done, and the plan says why."""

import numpy as np
import pytest

from tests.scenes import area_light, box, floor, perspective_camera, point_light, render_passes, snapshot, spot_light
from vir_addon.core.errors import SceneError, UsageError
from vir_addon.core.plan import plan
from vir_addon.core.settings import Method, Settings

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
    "does not shine on": (spot_light(eye=(0, 0, 5), target=(0, 0, 9)), 0.0),
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


def test_kinds_of_light_are_named():
    scene = scene_with(area_light(), point_light("Bulb", radius_m=0.25), spot_light("Beam", cone_rad=np.radians(40)))
    lines = {line.light_name: line for line in plan(scene, Settings()).passes}
    assert all(line.runs for line in lines.values())
    assert "1 x 1 m rectangle" in lines["Key"].reason
    assert "point light of 0.25 m radius" in lines["Bulb"].reason
    assert "spot of 40 degrees" in lines["Beam"].reason


def test_faces_cost():
    """A lamp among what it lights takes a cube, and its prediction says so."""
    above, among = (planned(scene_with(point_light(eye=(0, 0, height))), method=Method.MVR) for height in (9.0, 0.5))
    assert among.predicted_ms > 1.5 * above.predicted_ms


def test_light_without_size_gets_one_view():
    for light in (area_light(size_m=(0.0, 0.0)), point_light(radius_m=0.0), spot_light(radius_m=0.0)):
        line = planned(scene_with(light), view_count=64)
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


@pytest.mark.parametrize("arguments", [{"view_count": 0}, {"view_count": 5000}, {"map_resolution_px": 8}, {"point_buffer_mib": 0}])
def test_settings_out_of_range(arguments):
    with pytest.raises(UsageError):
        Settings(**arguments)
