"""The benchmarks at sizes that take seconds: that they run, with every method, and fill the tables they promise. No time is judged."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("bpy")

from tests.benchmarks import peers
from tests.benchmarks.__main__ import BENCHMARKS, NAMES, PEERS
from tests.benchmarks.options import Options
from tests.benchmarks.speed import Asked, verdict_rows
from vir_addon.core.plan import AUTO_METHODS
from vir_addon.core.settings import Method

QUICKEST = ("closed_surface", "forest", "growth_views")
SPEED_SCENES = ("closed_surface", "model", "colonnade", "furnished_room", "forest")


@pytest.mark.parametrize("name", [name if name in QUICKEST else pytest.param(name, marks=pytest.mark.slow) for name in NAMES])
def test_runs_and_fills_its_tables(name, tmp_path):
    tables = (BENCHMARKS | PEERS)[name](Options(tmp_path, "moderngl", is_quick=True, rounds=1))
    for table in tables:
        assert table.rows
        # of pictures as coarse as these nobody's error need come down to what is asked
        empty = [column.heading for column in table.columns if not any(column.show(row) for row in table.rows)]
        assert not empty or set(empty) == {"VIR / this"}, f"{table.title}: no row has {empty}"
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
