"""A camera whose window is the other way round sees the same picture the other way round."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import area_light, box, camera_from_above, floor, matte, mirror, perspective_camera, render_passes, snapshot
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.frustum import instances_in_picture
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, shadow_pass_name
from vir_addon.core.settings import Effect, Method

WIDTH, HEIGHT = 96, 54
CAMERAS = {
    "perspective": perspective_camera((0.3, -6.0, 3.0), (0.0, 0.0, 0.5), WIDTH, HEIGHT, 0.3),
    "sheared": dataclasses.replace(perspective_camera((0.3, -6.0, 3.0), (0.0, 0.0, 0.5), WIDTH, HEIGHT, 0.3), skew=0.3),
    "orthographic": camera_from_above((0.2, 0.1), 4.0, WIDTH, HEIGHT),
}
MIRRORS = {"x": (slice(None), slice(None, None, -1)), "y": (slice(None, None, -1),), "both": (slice(None, None, -1),) * 2}


def boxes(camera):
    """Wholly within the picture, as is all of the scene. What is left of a closed one without its front faces is its inside."""
    meshes = [box("low", (0.0, 0.0, 0.5), (0.4, 0.3, 0.5)), box("high", (0.6, -0.3, 1.2), (0.2, 0.2, 0.2)), floor(1.0)]
    light = area_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 0.0))
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT, materials=[mirror(), matte(), matte()], world=World())


def mirrored(scene, axes):
    left, right, bottom, top = scene.camera.window
    across, up = (left, right) if axes == "y" else (right, left), (bottom, top) if axes == "x" else (top, bottom)
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, window=(*across, *up)))


@pytest.mark.parametrize("axes", MIRRORS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_mirrored_camera_sees_the_mirrored_picture(device, camera, axes):
    """Colours of reflections as well, which tell what is seen at every pixel; reflections themselves have other noise there."""
    scene = boxes(CAMERAS[camera])
    arguments = {"method": Method.MVR, "view_count": 8, "map_resolution_px": 256, "reflection_sample_count": 1, "effects": tuple(Effect)}
    upright, turned = (render_passes(each, device, **arguments) for each in (scene, mirrored(scene, axes)))
    for name in (shadow_pass_name("Key"), REFLECTION_COLOR_PASS_NAME):
        assert upright[name].std() > 0.05
        np.testing.assert_allclose(turned[name][MIRRORS[axes]], upright[name], atol=1e-6)


@pytest.mark.parametrize("axes", MIRRORS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_mirrored_camera_has_the_same_things_in_its_picture(camera, axes):
    scene = boxes(CAMERAS[camera])
    aside = scene.instances.world_from_object.copy()
    aside[1, 0, 3] = 9.0
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, world_from_object=aside))
    for each in (scene, mirrored(scene, axes)):
        np.testing.assert_array_equal(instances_in_picture(each, compute_bounds(each)), [True, False, True])
