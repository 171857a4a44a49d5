"""A pair of passes of each reflecting object."""

from __future__ import annotations

import numpy as np

from tests.core.test_reflections import colored_box
from tests.scenes import bumpy_sphere, mirror, perspective_camera, render_passes, snapshot
from vir_addon.core.material import World
from vir_addon.core.pass_set import PASS_NAME_BYTES_MAX, REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME, reflector_pass_names
from vir_addon.core.settings import Effect

WIDTH, HEIGHT = 64, 36


def test_passes_of_reflectors_add_up(device):
    """Two balls of which one covers a part of the other, in a coloured box."""
    walls, materials = colored_box(3.0)
    balls = [
        bumpy_sphere("ball.001", (0.5, 0.3, 0), 0.6, 32, bump_share=0.0),
        bumpy_sphere("far", (1.5, -0.5, 0.1), 0.6, 32, bump_share=0.0),
    ]
    camera = perspective_camera((-2.6, 0.4, 0.3), (0.5, 0, 0), WIDTH, HEIGHT, 0.5)
    scene = snapshot(
        [*walls, *balls], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror((0.9, 0.8, 0.7)), mirror((0.5, 0.5, 0.6))], world=World()
    )
    passes = render_passes(scene, device, reflection_sample_count=4, effects=(Effect.REFLECTION,), per_reflector=True)
    names = {name: (f"VIR Reflection {name}", f"VIR Reflection Color {name}") for name in ("ball_001", "far")}
    assert set(passes) == {REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME, *(name for pair in names.values() for name in pair)}
    products = {name: passes[reflection] * passes[color] for name, (reflection, color) in names.items()}
    assert all((product.max(axis=-1) > 0).sum() > 50 for product in products.values())
    np.testing.assert_allclose(sum(products.values()), passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME], atol=1e-5)
    np.testing.assert_allclose(sum(passes[color] for _, color in names.values()), passes[REFLECTION_COLOR_PASS_NAME], atol=1e-5)
    near = passes["VIR Reflection Color ball_001"]
    np.testing.assert_allclose(np.median(near[near.max(axis=-1) > 0.89], axis=0), (0.9, 0.8, 0.7), atol=1e-3)
    # whole samples are one's or the other's
    share = near[..., 0] / 0.9 + passes["VIR Reflection Color far"][..., 0] / 0.5
    assert share.max() < 1.001


def test_names_of_reflectors_passes_are_all_different_and_fit():
    objects = ["Color", "Color A", "A", "A.b", "A_b", "x" * 80, "x" * 79 + "y"]
    names = reflector_pass_names(objects)
    assert names == reflector_pass_names(objects[::-1])
    flat = [name for pair in names.values() for name in pair]
    assert len({REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME, *flat}) == 2 * len(objects) + 2
    assert all(len(name.encode()) <= PASS_NAME_BYTES_MAX and "." not in name for name in flat)
