"""Up to how many points a triangle is cheaper as points than rasterized for every view: where `Settings.small_triangle_points` is from.

Surfaces of evenly sized triangles, from fine to coarse, each with several thresholds. All of a fine surface is points and all of a
coarse one is rasterized, whatever the threshold; where the times of a row cross, the threshold belongs.
"""

from __future__ import annotations

import statistics
from typing import Any

from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .light_maps import LightMaps, Variant, planned_variant, prepared_count
from .options import Options
from .tables import BenchTable, Column
from .timing import take_turns

THRESHOLDS = (0, 2, 4, 6, 8, 12, 16, 32)


def measure(triangle_count: int, options: Options, device: Device) -> dict[str, Any]:
    view_count, resolution_px = options.pick(64, 16), options.pick(1024, 256)
    snapshot = sphere_snapshot(triangle_count, *options.pick((960, 540), (240, 135)), has_floor=False)
    maps = LightMaps(snapshot, device)

    def variant(method: Method, **choices: int) -> Variant:
        settings = Settings(method=method, view_count=view_count, map_resolution_px=resolution_px, **choices)
        return planned_variant(snapshot, settings, device)

    points = prepared_count(maps.time(variant(Method.IVIR)).counts)
    variants = {str(threshold): variant(Method.HYBRID, small_triangle_points=threshold) for threshold in THRESHOLDS}
    maps.time(variants[str(THRESHOLDS[-1])])  # compiles
    timings = take_turns({name: lambda v=variant: maps.time(v) for name, variant in variants.items()}, options.round_count())
    maps.release()
    medians = {name: statistics.median(timing.total_ms for timing in rounds) for name, rounds in timings.items()}
    facing = triangle_count / 2
    return {"triangles": triangle_count, "points_each": points / facing, **medians}


def run(options: Options) -> list[BenchTable]:
    device = open_device(options.device_name)
    try:
        sizes = options.pick((2_000_000, 1_000_000, 500_000, 250_000, 125_000, 60_000, 30_000), (50_000, 10_000))
        rows = [measure(triangle_count, options, device) for triangle_count in sizes]
    finally:
        device.close()
    return [
        BenchTable(
            title="Where hybrid parts points from rasterized triangles",
            compared=(
                "Milliseconds of all maps of a bumpy sphere, medians; columns: triangles of at most so many points become points, 0 "
                "rasterizes all. 'points each': mean over the triangles that face the light if all become points."
            ),
            columns=(
                Column("triangles", "triangles", "{:,}"),
                Column("points_each", "points each", "{:.1f}"),
                *(Column(str(threshold), str(threshold), "{:.0f}") for threshold in THRESHOLDS),
            ),
            rows=rows,
        )
    ]
