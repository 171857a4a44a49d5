"""Light linking in pictures: what does not cast leaves no shadow, what is not lit is 1, and nothing else changes."""

import dataclasses

import numpy as np
import pytest

from tests.ray_tracing import bracket_pass
from tests.scenes import (
    METHODS,
    area_light,
    box,
    bumpy_sphere,
    floor,
    perspective_camera,
    prepared_renderer,
    render_batches,
    render_passes,
    rmse,
    snapshot,
)

WIDTH, HEIGHT = 28, 16
BALL, BOX, FLOOR = 0, 1, 2


def still_life(*lights, width=WIDTH, height=HEIGHT, **arguments):
    meshes = [bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 7, smooth=False), box("box", (-0.7, 0.3, 0.6), (0.4, 0.5, 0.6)), floor(4.0)]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), width, height)
    return snapshot(meshes, lights, camera, width, height, **arguments)


def light(name="Key", eye=(2.0, -2.0, 4.0), **fields):
    return area_light(name, eye, (0, 0, 0.5), **fields)


def only(*instances):
    return np.isin(np.arange(3), instances)


CASES = {
    "a blocker excluded": lambda: still_life(light(blockers=only(BOX, FLOOR))),
    "a receiver excluded": lambda: still_life(light(receivers=only(BOX, FLOOR))),
    "one casts onto the other": lambda: still_life(light(blockers=only(BALL), receivers=only(FLOOR))),
    "visible_shadow off": lambda: still_life(light(), casts_shadow=[True, False, True]),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_linked_pass_lies_within_a_texel_of_the_truth(device, name, method):
    scene = CASES[name]()
    with prepared_renderer(scene, device, method=method, view_count=16, map_resolution_px=512) as renderer:
        render_batches(renderer)
        image = renderer.read_passes()["VIR Shadow Key"]
        (work,) = renderer.works
        positions = device.run(device.read, renderer.eye.buffers[0].positions)
        truth = bracket_pass(scene, work.light, work.samples_m, work.sample_weights, [fitted for fitted, _, _ in work.faces], positions)
    instance = positions[..., 3].astype(np.int64)
    linked = work.light.receivers if work.light.receivers is not None else np.ones(3, bool)
    lit = (instance >= 0) & linked[instance]
    assert (image[~lit] == 1).all() and lit.sum() > 100
    assert (np.maximum(truth.low - image, image - truth.high)[lit] > 2e-3).sum() <= 2
    assert rmse(image[lit], truth.exact[lit]) < 0.02
    assert truth.exact[lit].std() > 0.1


@pytest.mark.parametrize("method", METHODS)
def test_shadows_of_one_light_are_not_those_of_another(device, method):
    """Each light sees its own links, alone and beside the other; together they are weighed without what a light does not reach."""
    arguments = {"method": method, "view_count": 16, "map_resolution_px": 256}
    size = {"width": 64, "height": 36}
    key, rim = light(blockers=only(BOX, FLOOR)), light("Rim", (-3.0, -1.0, 4.0), receivers=only(BALL, FLOOR), strength=40.0)
    both = render_passes(still_life(key, rim, **size), device, **arguments)
    for alone in (key, rim):
        name = f"VIR Shadow {alone.name}"
        np.testing.assert_array_equal(render_passes(still_life(alone, **size), device, **arguments)[name], both[name])
        unlinked = dataclasses.replace(alone, blockers=None, receivers=None)
        assert rmse(render_passes(still_life(unlinked, **size), device, **arguments)[name], both[name]) > 0.05
    with prepared_renderer(still_life(key, rim, **size), device, **arguments) as renderer:
        instance = device.run(device.read, renderer.eye.buffers[0].positions)[..., 3]
    on_box = instance == BOX
    assert on_box.sum() > 50
    # only Key lights the box
    np.testing.assert_allclose(both["VIR Shadow"][on_box], both["VIR Shadow Key"][on_box], atol=1e-6)
