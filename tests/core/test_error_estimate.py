"""What a render says about its own error, against the error.

Of a round of b well distributed samples the error is c b^-p, with p = 1 for a light that is a line and 3/4 for one with an area, on which
shadow edges are curves. The estimate takes n rounds for independent, c b^-p n^-1/2, while together they err by c (b n)^-p. So
the estimate is too large by n^(p - 1/2): at least 1, and sqrt(n) at most.
"""

import dataclasses

import numpy as np
import pytest

from tests.scenes import CENTRES_ONLY, area_light, camera_from_above, floor, prepared_renderer, rectangle, render_pass, rmse, snapshot
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.scene import LightShape, PixelFilter
from vir_addon.core.settings import Method, Resolve, Settings

WIDTH, HEIGHT = 96, 54
REFERENCE_VIEWS = 1024
MAP_PX = 256


def cards():
    return [
        rectangle("level", (-1.2, -0.8, 0.6), (1.0, 0.3, 0), (-0.3, 0.9, 0)),
        rectangle("slanted", (0.2, -0.3, 1.0), (0.7, -0.2, 0.1), (0.15, 0.6, -0.1)),
        rectangle("strip", (0.9, 0.6, 0.3), (0.8, 0.1, 0), (-0.05, 0.08, 0)),
    ]


def leaves():
    generator = np.random.default_rng(3)
    made = []
    for number, angle in enumerate(generator.uniform(0, 6, 80)):
        along, across = np.array([np.cos(angle), np.sin(angle), 0.1]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        made.append(rectangle(f"leaf {number}", (*generator.uniform(-1.5, 1.5, 2), generator.uniform(0.2, 1)), 0.2 * along, 0.08 * across))
    return made


LIGHTS = {
    "square": area_light(eye=(1, -1, 5)),
    "ellipse": area_light(eye=(-1, -1, 4), size_m=(2.0, 0.7), shape=LightShape.ELLIPSE),
    "small": area_light(eye=(1, -1, 5), size_m=(0.1, 0.1)),
    "line": area_light(eye=(0, -1, 4), size_m=(3.0, 0.05)),
}
CASES = [
    (cards, "square", CENTRES_ONLY),
    (cards, "line", CENTRES_ONLY),
    (cards, "small", PixelFilter()),
    (leaves, "ellipse", CENTRES_ONLY),
    (leaves, "square", PixelFilter()),
]


def made(scene, device, view_count, **changes):
    work = plan(scene, Settings(method=Method.MVR, view_count=view_count, map_resolution_px=MAP_PX))
    for progress in render(scene, dataclasses.replace(work, **changes), device):
        if progress.batches_done == work.batch_count:
            (statistics,) = progress.statistics.passes
            assert statistics.error_estimate == progress.error_estimate
            return progress.passes["VIR Shadow Key"], progress.error_estimate, work.batch_count * work.eye_samples_per_batch


@pytest.mark.parametrize(("things", "light", "pixel_filter"), CASES, ids=lambda case: getattr(case, "__name__", str(case))[:12])
def test_estimate_bounds_the_error_closely(device, things, light, pixel_filter):
    """Everything in the picture is lit by some of the light: where a pass jumps between surfaces that receive light and those that do
    not there is no ratio to estimate."""
    scene = snapshot([floor(), *things()], [LIGHTS[light]], camera_from_above((0, 0), 4.0, WIDTH, HEIGHT), WIDTH, HEIGHT)
    scene = dataclasses.replace(scene, pixel_filter=pixel_filter)
    # as many eye samples as batches: the reference must not share the few offsets of what it judges
    reference, _, _ = made(scene, device, REFERENCE_VIEWS, eye_sample_count=REFERENCE_VIEWS // 8)
    assert reference.std() > 0.1
    estimates = []
    for view_count in (32, 64, 128):
        image, estimate, round_count = made(scene, device, view_count)
        error = rmse(image, reference)
        print(f"{view_count} views: estimate {estimate:.4f}, error {error:.4f}, ratio {estimate / error:.2f}")
        assert 1 <= estimate / error <= np.sqrt(round_count), view_count
        estimates.append(estimate)
    assert estimates[0] > estimates[1] > estimates[2]


def test_estimate_falls_as_one_over_the_root_of_the_batches(device):
    """From batch to batch of one render, as it is shown while it runs."""
    scene = snapshot([floor(), *leaves()], [LIGHTS["ellipse"]], camera_from_above((0, 0), 4.0, WIDTH, HEIGHT), WIDTH, HEIGHT)
    work = plan(scene, Settings(method=Method.MVR, view_count=256, map_resolution_px=MAP_PX))
    # one round a batch: there is none to tell the first one's spread by
    work = dataclasses.replace(work, eye_samples_per_batch=1)
    estimates = np.array([progress.error_estimate for progress in render(scene, work, device)])
    assert len(estimates) == 32 and np.isinf(estimates[0]) and np.isfinite(estimates[1:]).all()
    batches = np.arange(1, 33)
    scaled = estimates[3:] * np.sqrt(batches[3:])
    assert scaled.max() / scaled.min() < 1.2, scaled


def test_estimate_is_that_of_the_ratio_of_all_rounds(device):
    """The device never has all rounds at once: the deviations that it adds up on the way come to those from the ratio in the end."""
    scene = snapshot([floor(), *leaves()], [LIGHTS["ellipse"]], camera_from_above((0, 0), 4.0, WIDTH, HEIGHT), WIDTH, HEIGHT)
    settings = {"method": Method.MVR, "view_count": 24, "map_resolution_px": MAP_PX, "resolve": Resolve.FULL}
    with prepared_renderer(scene, device, **settings) as renderer:
        assert renderer.plan.eye_samples_per_batch == 1
        (work,) = renderer.works
        sums = []
        for batch in range(renderer.plan.batch_count):
            device.run(renderer.render_batch, batch)
            sums.append(np.stack(device.run(work.accumulator.read)[:2]).astype(np.float64) * (batch + 1))
        estimate = device.run(work.accumulator.compute_error)
    shadowed, delivered = np.diff(sums, axis=0, prepend=0).swapaxes(0, 1)
    lit = delivered.sum(axis=0) > 0
    ratio = shadowed.sum(axis=0)[lit] / delivered.sum(axis=0)[lit]
    rounds = len(shadowed)
    deviations = ((shadowed[:, lit] - ratio * delivered[:, lit]) ** 2).sum(axis=0)
    expected = np.sqrt((rounds / (rounds - 1) * deviations / delivered.sum(axis=0)[lit] ** 2).mean())
    print(f"{rounds} rounds: estimate {estimate:.5f}, all at once {expected:.5f}")
    assert rounds == renderer.plan.batch_count > 4
    assert estimate == pytest.approx(expected, rel=0.03)


def test_nothing_uncertain_is_no_error(device):
    scene = snapshot([floor()], [LIGHTS["square"]], camera_from_above((0, 0), 4.0, WIDTH, HEIGHT), WIDTH, HEIGHT)
    image, estimate, _ = made(scene, device, 16)
    assert (image == 1).all() and estimate == pytest.approx(0, abs=1e-4)
    assert (render_pass(scene, device, view_count=8) == 1).all()
