"""The benchmarks at sizes that take seconds: that they run, with every method, and fill the tables they promise. No time is judged."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from tests import cycles
from tests.benchmarks import peers, reflections
from tests.benchmarks.__main__ import NAMES, states
from tests.benchmarks.head_scene import build_head_scene
from tests.benchmarks.memory import forget_peak
from tests.benchmarks.options import Options
from tests.benchmarks.speed import Asked, verdict_rows
from tests.benchmarks.timing import take_turns
from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.settings import Method, ReflectionMethod
from vir_addon.device.open import open_device

QUICKEST = ("closed_surface", "growth_views")
SPEED_SCENES = ("closed_surface", "model", "colonnade", "furnished_room", "forest")


@pytest.mark.parametrize(("count", "rounds"), [(1, 3), (2, 2), (5, 10), (8, 8)])
def test_nobody_always_follows_the_same_one(count, rounds):
    done: list[int] = []
    results = take_turns({str(job): lambda job=job: done.append(job) for job in range(count)}, rounds)
    assert all(len(each) == rounds for each in results.values())
    turns = [done[start : start + count] for start in range(0, len(done), count)]
    assert all(sorted(turn) == list(range(count)) for turn in turns)
    followers = Counter(pair for turn in turns for pair in pairwise(turn))
    assert len(followers) == count * (count - 1) and len(set(followers.values())) <= 1


@pytest.mark.parametrize("name", [name if name in QUICKEST else pytest.param(name, marks=pytest.mark.slow) for name in NAMES])
def test_runs_and_fills_its_tables(name, tmp_path):
    *_, tables = states(name, Options(tmp_path, "moderngl", is_quick=True, rounds=1))
    # of pictures as coarse as these nobody's error need come down to what is asked
    may_be_empty = {"VIR / this"}
    if not forget_peak():
        may_be_empty.add("peak, MiB")
    if not any(row.get("renderer") == peers.EEVEE for table in tables for row in table.rows):
        may_be_empty |= {"to EEVEE's best, s", "to EEVEE's best, processors, s"}
    for table in tables:
        assert table.rows
        empty = [column.heading for column in table.columns if not any(column.show(row) for row in table.rows)]
        assert set(empty) <= may_be_empty, f"{table.title}: no row has {empty}"
        assert table.to_markdown().count("\n| ") == len(table.rows) + 1
    if name in SPEED_SCENES:
        methods, verdict = tables
        # what was stopped says so behind its name
        assert {row["method"].partition(",")[0] for row in methods.rows} >= {method.value for method in AUTO_METHODS}
        assert verdict.rows[0]["compared"] == "auto" and verdict.rows[0]["ratio"] > 0
    if name.startswith(("growth", "peers")):
        assert len(list(tmp_path.glob("*.png"))) == 1


def test_the_verdict_knows_the_fastest_and_how_far_auto_is_from_it():
    methods = [Method.MVR, Method.MICRO, Method.IVIR]
    rows = [{"speedup": ratio, "cpu_speedup": ratio} for ratio in (1.0, 4.0, 3.0)]
    auto, fastest, with_points, distance = verdict_rows(rows, methods, Method.IVIR, Asked(of_auto=True, must=2.0, aim=3.5))
    assert (auto["method"], auto["ratio"], auto["must"], auto["aim"]) == ("ivir", 3.0, 2.0, 3.5)
    assert (fastest["method"], fastest["ratio"]) == ("micro", 4.0) and "must" not in fastest
    assert with_points["method"] == "ivir"
    assert distance["ratio"] == pytest.approx(4 / 3)


def test_time_to_an_error_is_read_from_the_curve():
    rows = [{"seconds": 1.0, "rmse": 0.08}, {"seconds": 16.0, "rmse": 0.02}]
    # an error that falls with the root of the time: half of it at four times the time
    assert peers.seconds_to_reach(rows, 0.04) == pytest.approx(4.0)
    assert peers.seconds_to_reach(rows, 0.1) == 1.0
    assert math.isinf(peers.seconds_to_reach(rows, 0.01))


def curve(renderer, *points):
    return [{"renderer": renderer, "seconds": seconds, "cpu_seconds": 2 * seconds, "rmse": rmse} for seconds, rmse in points]


VIR_CURVE = curve(peers.VIR_AUTO, (1.0, 0.08), (16.0, 0.02))
CYCLES_CURVE = curve(peers.CYCLES, (10.0, 0.08), (160.0, 0.02))


def test_finer_errors_are_read_from_the_same_curve():
    vir, reference = peers.summary(VIR_CURVE + CYCLES_CURVE)
    assert vir["cpu_seconds_to_0.02"] == pytest.approx(32.0) and reference["cpu_seconds_to_0.02_share"] == pytest.approx(0.1)
    assert math.isinf(vir["cpu_seconds_to_0.01"]) and reference["cpu_seconds_to_0.01_share"] is None


def test_two_pictures_of_cycles_are_those_that_it_renders_one_by_one():
    """With persistent data, and a light whose shadows are switched off instead of every object's."""
    scene = build_head_scene(1)
    light, samples = bpy.data.objects["Key"], 2
    cycles.prepare(scene, (48, 27))
    shadowed, unshadowed, taken = cycles.render_pair(scene, light, samples, seed=4)
    for image, has_shadows in ((shadowed, True), (unshadowed, False)):
        np.testing.assert_array_equal(image, cycles.render(scene, samples, seed=4, has_shadows=has_shadows)[0])
    assert (shadowed < unshadowed).any() and taken.shape == (2, 2) and (taken > 0).all()
    assert light.data.use_shadow and not scene.render.use_persistent_data


def test_a_render_of_cycles_that_fails_leaves_the_scene_as_it_was(monkeypatch):
    scene = build_head_scene(1)
    light = bpy.data.objects["Key"]
    with monkeypatch.context() as patched:
        patched.setattr(cycles, "render", lambda *_: (np.zeros((1, 1), np.float32), 0.0, 0.0) if light.data.use_shadow else 1 / 0)
        with pytest.raises(ZeroDivisionError):
            cycles.render_pair(scene, light, samples=1)
    assert light.data.use_shadow and not scene.render.use_persistent_data
    cycles.prepare(scene, (48, 27))
    scene.camera = None
    with pytest.raises(RuntimeError, match="camera"):
        cycles.render(scene, samples=1, has_shadows=False)
    assert all(shown.visible_shadow for shown in scene.objects)


def test_without_eevee_nothing_is_compared_with_it():
    rows = peers.summary(VIR_CURVE + CYCLES_CURVE)
    assert [row["renderer"] for row in rows] == [peers.VIR_AUTO, peers.CYCLES]
    for row in rows:
        assert {key: value for key, value in row.items() if key.startswith("eevee_")} == dict.fromkeys(
            ("eevee_seconds", "eevee_cpu_seconds", "eevee_seconds_share", "eevee_cpu_seconds_share")
        )
    assert rows[1]["seconds_share"] == pytest.approx(0.1)


def test_others_are_compared_with_auto_and_eevee_with_its_quickest_good_run():
    others = curve("VIR micro", (0.1, 0.02))  # nobody knew beforehand
    rows = peers.summary(VIR_CURVE + others + curve(peers.EEVEE, (1.0, 0.09), (8.0, 0.0408), (20.0, 0.0415), (80.0, 0.04)))
    vir, micro, eevee = rows
    assert vir["eevee_seconds"] == pytest.approx((0.08 / 0.0408) ** 2)
    assert eevee["eevee_seconds"] == 8.0 and eevee["eevee_cpu_seconds"] == 16.0 and eevee["best_rmse"] == 0.04
    assert eevee["eevee_seconds_share"] == pytest.approx(vir["eevee_seconds"] / 8.0)
    assert micro["seconds_share"] > 1 and vir["seconds_share"] == 1


def test_shading_is_compared_with_that_of_cubes_that_are_shaded_whole():
    device = open_device("moderngl")
    try:
        drawn, small, packed, wide, *others = reflections.measure(2, 20_000, 64, 1, device)
    finally:
        device.close()
    assert drawn["method"] == ReflectionMethod.MVR.value
    # both share a cube, 32 wide in a picture of 64; those as wide as reflectors are in the picture are 64 wide at least
    assert small["texels"] == 4 * drawn["texels"] == 6 * 64 * 64
    assert all(row["shaded"] == row["surface_texels"] for row in (drawn, small))
    assert packed["shaded"] == wide["shaded"] > packed["samples"] > 0 and wide["memory_mib"] > packed["memory_mib"]
    for row in others:
        assert row["texels"] == small["texels"] and row["shaded"] < row["ray_count"]
        assert row["shading_ratio"] == pytest.approx(drawn["shaded"] / row["shaded"])
        assert row["small_ratio"] == pytest.approx(small["shaded"] / row["shaded"])
