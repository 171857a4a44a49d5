"""Depth maps alone: rasterizing the surface for every view against making points once and replaying them."""

from __future__ import annotations

import itertools
import statistics
from typing import Any

from vir_addon.core.errors import UsageError
from vir_addon.core.passes.shadow_maps import MAX_BATCH_VIEWS
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .light_maps import LightMaps, planned_variant, prepared_count, replayed_count
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio, round_ratios, take_turns

BASELINE = "mvr"
VIEWS_PER_THREAD = {"serial": 1, "partially parallel": 4, "fully parallel": MAX_BATCH_VIEWS}

COLUMNS = (
    Column("variant", "method"),
    Column("prepared", "points or triangles", "{:,}"),
    Column("kept", "replayed", "{:,}"),
    Column("culled", "triangles culled", "{:,}"),
    Column("missed_share", "texels missed", "{:.3%}"),
    Column("points_ms", "prepared, ms", "{:.0f}"),
    Column("view_ms", "a view, ms", "{:.1f}"),
    Column("total_ms", "all, ms", "{:.0f}"),
    Column("cpu_ms", "processors, ms", "{:.0f}"),
    Column("speedup", "mvr / this", "{:.2f}"),
)


def variants(view_count: int, resolution_px: int) -> dict[str, Settings]:
    def settings(method: Method, **choices: Any) -> Settings:
        return Settings(method=method, view_count=view_count, map_resolution_px=resolution_px, **choices)

    found = {BASELINE: settings(Method.MVR), "micro": settings(Method.MICRO), "hybrid": settings(Method.HYBRID)}
    found["vir, watertight"] = settings(Method.VIR)
    found["vir, published"] = settings(Method.VIR, watertight=False)
    for points, (parallelism, views_per_thread) in itertools.product(PointStorage, VIEWS_PER_THREAD.items()):
        made = settings(Method.VWSS, points=points, watertight=False, views_per_thread=views_per_thread)
        found[f"vwss {points.value}, {parallelism}"] = made
    found["vwss buffered, watertight, back faces"] = settings(Method.VWSS, back_faces=True)
    for points, is_watertight, is_culled in itertools.product(PointStorage, (True, False), (True, False)):
        density, culling = "watertight" if is_watertight else "published", "culling" if is_culled else "no culling"
        made = settings(Method.IVIR, points=points, watertight=is_watertight, stochastic_culling=is_culled)
        found[f"ivir {points.value}, {density}, {culling}"] = made
    found["ivir buffered, watertight, culling, hidden kept"] = settings(Method.IVIR, cull_hidden=False)
    for points in PointStorage:
        made = settings(Method.IVIR, points=points, point_generation=PointGeneration.RASTERIZER)
        found[f"ivir {points.value}, watertight, culling, by rasterizer"] = made
    return found


def measure(triangle_count: int, options: Options, device: Device) -> BenchTable:
    view_count, resolution_px = options.pick(64, 16), options.pick(1024, 256)
    snapshot = sphere_snapshot(triangle_count, *options.pick((960, 540), (240, 135)), has_floor=False)
    maps = LightMaps(snapshot, device)
    competitors, left_out = {}, {}
    for name, settings in variants(view_count, resolution_px).items():
        try:
            competitors[name] = planned_variant(snapshot, settings, device)
        except UsageError as error:
            left_out[name] = str(error)
    covered = {name: maps.covered(variant) for name, variant in competitors.items()}
    rounds = options.round_count()
    timings = take_turns({name: lambda v=variant: maps.time(v) for name, variant in competitors.items()}, rounds)
    maps.release()

    baseline_ms = [timing.total_ms for timing in timings[BASELINE]]
    rows = []
    for name in competitors:
        counts = timings[name][0].counts
        total_ms = [timing.total_ms for timing in timings[name]]
        is_baseline = name == BASELINE
        missed = (covered[BASELINE] & ~covered[name]).sum() / max(covered[BASELINE].sum(), 1)
        rows.append(
            {
                "variant": name,
                "prepared": None if is_baseline else prepared_count(counts),
                "kept": None if is_baseline else replayed_count(counts),
                "culled": None if is_baseline else counts["culled_triangle_count"],
                "missed_share": None if is_baseline else float(missed),
                "points_ms": statistics.median(timing.points_ms for timing in timings[name]),
                "view_ms": statistics.median(timing.maps_ms for timing in timings[name]) / view_count,
                "total_ms": statistics.median(total_ms),
                "total_ms_by_round": total_ms,
                "cpu_ms": statistics.median(timing.cpu_ms for timing in timings[name]),
                "speedup": median_ratio(baseline_ms, total_ms),
                "speedup_by_round": round_ratios(baseline_ms, total_ms),
            }
        )
    return BenchTable(
        title=f"Depth maps of {view_count} views at {resolution_px}², {snapshot.meshes[0].name}",
        compared=(
            f"Medians of {rounds} rounds in which all methods take turns; 'mvr / this' is the median of the rounds' ratios. "
            f"'texels missed': of the texels that mvr covers in the last batch of maps, outlines included. "
            "'replayed': what is left after the first batch of views. 'prepared, ms': making them once; bufferless makes them for every "
            "batch, within the time of a view. 'processors': of all threads, for all."
            + "".join(f" Without {name}: {reason}." for name, reason in left_out.items())
        ),
        columns=COLUMNS,
        rows=rows,
    )


def run(options: Options) -> list[BenchTable]:
    device = open_device(options.device_name)
    try:
        sizes = options.pick((2_000_000, 1_000_000), (50_000,))
        return [measure(triangle_count, options, device) for triangle_count in sizes]
    finally:
        device.close()
