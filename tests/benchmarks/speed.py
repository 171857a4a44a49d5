"""Depth maps of whole scenes by every method against rasterizing every view: is what `auto` takes as fast as what there is?

Each scene is a bench of its own. Methods come from the Method enum, as the plan would run them; the table says which cannot make a light's
maps and which are not tried because the plan predicts that they take longer than mvr.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy

from demo_scenes import colonnade as colonnade_scene
from demo_scenes import forest as forest_scene
from demo_scenes import furnished_room as furnished_room_scene
from vir_addon.blender.job import take_snapshot
from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .light_maps import LightMaps, Timing, Variant, planned_variant, possible_variants, prepared_count, replayed_count
from .memory import forget_peak, peak_mib
from .model_scene import open_model
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio

SIZE_PX = (480, 270)
"""of the picture, which only decides what the views are fitted to"""
DRAGON_TRIANGLES = 871_414
FOREST_BATCHES = 1
HOPELESS_SHARE = 1.0
"""of mvr's predicted time: methods that are there to be compared are compared where they have a chance"""
WARM_UP_RESOLUTION_PX = 128

METHOD_COLUMNS = (
    Column("method", "method"),
    Column("prepared", "points or triangles", "{:,}"),
    Column("replayed", "replayed", "{:,}"),
    Column("portions", "portions"),
    Column("map_size_px", "map, texels"),
    Column("points_ms", "prepared, ms", "{:.0f}"),
    Column("view_ms", "a view, ms", "{:.1f}"),
    Column("total_ms", "all, ms", "{:.0f}"),
    Column("cpu_ms", "processors, ms", "{:.0f}"),
    Column("speedup", "mvr / this", "{:.2f}"),
    Column("cpu_speedup", "the same, processors", "{:.2f}"),
    Column("peak_mib", "peak, MiB", "{:.0f}"),
)
VERDICT_COLUMNS = (
    Column("compared", "compared"),
    Column("method", "method"),
    Column("ratio", "mvr / this", "{:.2f}"),
    Column("cpu_ratio", "the same, processors", "{:.2f}"),
    Column("must", "must", "{:.1f}"),
    Column("aim", "aim", "{:.1f}"),
)


@dataclass(frozen=True)
class Asked:
    """What a scene is measured for."""

    of_auto: bool
    """of what `auto` takes; otherwise of the fastest method"""
    must: float
    aim: float


@dataclass(frozen=True)
class SpeedScene:
    title: str
    snapshot: SceneSnapshot
    view_count: int
    resolution_px: int
    asked: Asked
    rounds: int
    baseline_batches: int | None = None
    """of mvr; the others are taken to cost as much. None: all"""
    patience: float = 1.5
    """A method that takes this many times as long as mvr is stopped and left out of later rounds."""


def snapshot_of(build: Callable[..., None], **sizes: int) -> SceneSnapshot:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build(bpy.context.scene, **sizes)
    return current_snapshot()


def current_snapshot() -> SceneSnapshot:
    scene = bpy.context.scene
    return take_snapshot(scene, scene.view_layers[0], SIZE_PX)


@dataclass(frozen=True)
class Competitor:
    variant: Variant
    timings: list[Timing]
    peak_mib: float | None
    is_stopped: bool


def in_full(timing: Timing) -> tuple[float, float]:
    """Milliseconds of all batches, waited and of processors, if each costs what those cost that were made."""
    share = timing.batches_total / timing.batches_done
    total_ms = timing.points_ms + timing.maps_ms * share
    return total_ms, timing.cpu_ms * total_ms / timing.total_ms


def compete(maps: LightMaps, variants: dict[Method, Variant], scene: SpeedScene) -> dict[Method, Competitor]:
    """All take turns; mvr is the first, and what it takes is the measure for who is too slow."""
    timings: dict[Method, list[Timing]] = {method: [] for method in variants}
    peaks: dict[Method, float | None] = {}
    stopped: set[Method] = set()
    limit_ms = float("inf")
    for round_index in range(scene.rounds):
        order = sorted(variants, key=lambda method: method is not Method.MVR)
        for method in order if round_index % 2 == 0 else reversed(order):
            if method in stopped:
                continue
            is_baseline = method is Method.MVR
            can_forget = forget_peak()
            timing = maps.time(variants[method], limit_ms, scene.baseline_batches if is_baseline else None)
            peaks[method] = peak_mib() if can_forget else None
            timings[method].append(timing)
            done = f"{timing.batches_done} of {timing.batches_total} batches, {timing.total_ms / 1e3:.1f} s"
            print(f"round {round_index + 1} of {scene.rounds}, {method.value}: {done}", file=sys.stderr, flush=True)
            if is_baseline and round_index == 0:
                limit_ms = scene.patience * in_full(timing)[0]
            elif not is_baseline and not timing.is_complete:
                stopped.add(method)
    return {method: Competitor(variants[method], timings[method], peaks[method], method in stopped) for method in variants}


def worth_timing(possible: dict[Method, Variant]) -> tuple[dict[Method, Variant], dict[Method, str]]:
    """Without `auto`, which is the method that its plan names; and what is left out, with the reason."""
    limit_ms = HOPELESS_SHARE * possible[Method.MVR].planned.predicted_ms
    tried = {
        method: variant
        for method, variant in possible.items()
        if method is not Method.AUTO and (method in AUTO_METHODS or variant.planned.predicted_ms <= limit_ms)
    }
    hopeless = {method: variant for method, variant in possible.items() if method is not Method.AUTO and method not in tried}
    mvr_ms = possible[Method.MVR].planned.predicted_ms
    return tried, {m: f"predicted to take {v.planned.predicted_ms / mvr_ms:.1f} times as long as mvr" for m, v in hopeless.items()}


def method_rows(competitors: dict[Method, Competitor]) -> list[dict[str, Any]]:
    full = {method: [in_full(timing) for timing in one.timings] for method, one in competitors.items()}
    rows: list[dict[str, Any]] = []
    for method, one in competitors.items():
        count = len(one.timings)
        total_ms, cpu_ms = ([times[k] for times in full[method]] for k in (0, 1))
        baseline_ms, baseline_cpu_ms = ([times[k] for times in full[Method.MVR]][:count] for k in (0, 1))
        counts = one.timings[0].counts
        rows.append(
            {
                "method": method.value
                + (f", stopped after {one.timings[-1].batches_done} of {one.timings[-1].batches_total} batches" if one.is_stopped else ""),
                "prepared": prepared_count(counts) or None,
                "replayed": replayed_count(counts) or None,
                "portions": counts["portion_count"],
                "map_size_px": one.timings[0].map_size_px,
                "points_ms": statistics.median(timing.points_ms for timing in one.timings),
                "view_ms": statistics.median(ms - timing.points_ms for ms, timing in zip(total_ms, one.timings, strict=True))
                / one.variant.planned.view_count,
                "total_ms": statistics.median(total_ms),
                "cpu_ms": statistics.median(cpu_ms),
                "speedup": median_ratio(baseline_ms, total_ms),
                "cpu_speedup": median_ratio(baseline_cpu_ms, cpu_ms),
                "peak_mib": one.peak_mib,
                "total_ms_by_round": total_ms,
                "cpu_ms_by_round": cpu_ms,
                "counts": counts,
            }
        )
    return rows


def verdict_rows(rows: list[dict[str, Any]], methods: list[Method], chosen: Method, asked: Asked) -> list[dict[str, Any]]:
    """What `auto` takes, the fastest, the fastest with points, and how far `auto` is from the fastest."""
    by_method = dict(zip(methods, rows, strict=True))

    def row(compared: str, method: Method, **more: float) -> dict[str, Any]:
        own = by_method[method]
        return {"compared": compared, "method": method.value, "ratio": own["speedup"], "cpu_ratio": own["cpu_speedup"], **more}

    def fastest(candidates: list[Method]) -> Method:
        return max(candidates, key=lambda method: by_method[method]["cpu_speedup"])

    limits = {"must": asked.must, "aim": asked.aim}
    best = fastest(methods)
    verdicts = [row("auto", chosen, **(limits if asked.of_auto else {}))]
    verdicts.append(row("fastest", best, **({} if asked.of_auto else limits)))
    verdicts += [row("fastest with points", fastest(with_points)) for with_points in [[m for m in methods if m.uses_points]] if with_points]
    auto, first = by_method[chosen], by_method[best]
    verdicts.append(
        {
            "compared": "time of auto / time of the fastest (must not be above 1.1)",
            "method": f"{chosen.value} / {best.value}",
            "ratio": first["speedup"] / auto["speedup"],
            "cpu_ratio": first["cpu_speedup"] / auto["cpu_speedup"],
            "must": 1.1,
        }
    )
    return verdicts


def measure(scene: SpeedScene, small: SceneSnapshot, device: Device) -> list[BenchTable]:
    """small: the same kinds of things, to compile what is timed"""
    settings = Settings(view_count=scene.view_count, map_resolution_px=scene.resolution_px)
    warm_up = LightMaps(small, device)
    possible, impossible = possible_variants(scene.snapshot, settings, device)
    for method, variant in list(possible.items()):
        if variant.planned.view_count != scene.view_count:  # less work is another work
            impossible[method] = f"its maps are of {variant.planned.view_count} views"
            del possible[method]
    variants, hopeless = worth_timing(possible)
    for method in variants:
        warm_up.time(
            planned_variant(small, dataclasses.replace(settings, method=method, map_resolution_px=WARM_UP_RESOLUTION_PX), device),
            batch_limit=2,
        )
    warm_up.release()
    maps = LightMaps(scene.snapshot, device)
    try:
        competitors = compete(maps, variants, scene)
    finally:
        maps.release()
    baseline = competitors[Method.MVR].timings[0]
    rows = method_rows(competitors)
    title = (
        f"{scene.title}: {scene.snapshot.instanced_triangle_count:,} triangles ({scene.snapshot.unique_triangle_count:,} stored), "
        f"{scene.view_count} views of {baseline.face_count} face{'s' * (baseline.face_count > 1)}, {scene.resolution_px}²"
    )
    partly = ""
    if not baseline.is_complete:
        partly = f"mvr draws {baseline.batches_done} of {baseline.batches_total} batches, which all cost alike. "
    table = BenchTable(
        title=title,
        compared=(
            "Depth maps alone, batched as in a render. Fitting the views, the same for all, is not counted. "
            f"Medians of {scene.rounds} rounds in which all take turns. {partly}'mvr / this' is "
            "the median of the rounds' ratios; 'processors' is the processor time of all threads, which other work on the machine disturbs "
            f"less. A method that takes {scene.patience:g} times as long as mvr is stopped, and its time that of all batches if they cost "
            "alike. 'peak': of the process, Blender and the scene included."
            + "".join(f" Without {method.value}: {reason}." for method, reason in (impossible | hopeless).items())
        ),
        columns=METHOD_COLUMNS,
        rows=rows,
    )
    chosen = possible[Method.AUTO].planned
    verdict = BenchTable(
        title=f"{scene.title}: what is asked",
        compared=f"The plan: {chosen.reason}. 'Fastest' is by processor time.",
        columns=VERDICT_COLUMNS,
        rows=verdict_rows(rows, list(variants), chosen.method, scene.asked),
    )
    return [table, verdict]


def run_scene(options: Options, small: SceneSnapshot, scene: SpeedScene) -> list[BenchTable]:
    device = open_device(options.device_name)
    try:
        return measure(scene, small, device)
    finally:
        device.close()


def closed_surface(options: Options) -> list[BenchTable]:
    small = sphere_snapshot(20_000, *SIZE_PX, has_floor=False)
    snapshot = small if options.is_quick else sphere_snapshot(2_000_000, *SIZE_PX, has_floor=False)
    views, resolution_px = options.pick((128, 1024), (16, 128))
    scene = SpeedScene("Closed surface", snapshot, views, resolution_px, Asked(False, 6, 13), options.round_count())
    return run_scene(options, small, scene)


def model(options: Options) -> list[BenchTable]:
    """The file of `--model`, or a surface of as many triangles as the Stanford dragon has."""
    small = sphere_snapshot(20_000, *SIZE_PX, has_floor=True)
    if options.model is not None:
        open_model(options.model)
        snapshot, title = current_snapshot(), f"Model {options.model.name}"
    else:
        snapshot, title = sphere_snapshot(options.pick(DRAGON_TRIANGLES, 20_000), *SIZE_PX, has_floor=True), "Surface like the dragon"
    views, resolution_px = options.pick((128, 1024), (16, 128))
    return run_scene(options, small, SpeedScene(title, snapshot, views, resolution_px, Asked(False, 5, 10), options.round_count()))


def colonnade(options: Options) -> list[BenchTable]:
    small = snapshot_of(colonnade_scene.build, rows=2, columns=3)
    snapshot = small if options.is_quick else snapshot_of(colonnade_scene.build)
    views, resolution_px = options.pick((128, 1024), (16, 128))
    return run_scene(options, small, SpeedScene("Colonnade", snapshot, views, resolution_px, Asked(True, 1, 1.5), options.round_count()))


def furnished_room(options: Options) -> list[BenchTable]:
    small = snapshot_of(furnished_room_scene.build, detail=12, tuft_count=500)
    snapshot = small if options.is_quick else snapshot_of(furnished_room_scene.build)
    views, resolution_px = options.pick((20, 512), (8, 64))
    return run_scene(
        options, small, SpeedScene("Furnished room", snapshot, views, resolution_px, Asked(True, 1.5, 3), options.round_count())
    )


def forest(options: Options) -> list[BenchTable]:
    small = snapshot_of(forest_scene.build, tree_count=3, triangles_a_tree=60_000)
    snapshot = small if options.is_quick else snapshot_of(forest_scene.build)
    views, resolution_px = options.pick((32, 1024), (8, 128))
    rounds = options.round_count(full=1)
    return run_scene(
        options, small, SpeedScene("Forest", snapshot, views, resolution_px, Asked(False, 8, 40), rounds, FOREST_BATCHES, patience=0.4)
    )
