"""What the terminal shows and what --stats writes: the same figures."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from ..core.files import whole_file
from ..core.pass_set import STAGES, PassSet, PassStatistics, ReflectionStatistics, SetStatistics
from ..core.plan import RenderPlan
from ..core.scene import SceneSnapshot
from ..core.settings import ReflectionLookUp


def milliseconds(value: float) -> str:
    return f"{value / 1000:.2f} s" if value >= 10_000 else f"{value:.0f} ms"


def error_text(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "?"


def print_plan(console: Console, snapshot: SceneSnapshot, plan: RenderPlan) -> None:
    flat = f", {snapshot.flat_triangle_count:,} of them without area" if snapshot.flat_triangle_count else ""
    console.print(
        f"[bold]{snapshot.scene_name}[/], {snapshot.view_layer_name}, frame {snapshot.frame}, {snapshot.width_px} x {snapshot.height_px}: "
        f"{len(snapshot.instances)} instances of {len(snapshot.meshes)} meshes, "
        f"{snapshot.unique_triangle_count:,} triangles{flat} ({snapshot.instanced_triangle_count:,} with instances)",
        highlight=False,
    )
    table = Table("light", "runs", "method", "views", "maps", "predicted", "why")
    for planned in plan.passes:
        if planned.runs:
            views, predicted = str(planned.view_count), milliseconds(planned.predicted_ms)
            maps = (planned.method_text, views, f"{planned.map_resolution_px} px") if planned.needs_maps else ("none", views, "none")
            table.add_row(planned.light_name, "yes", *maps, predicted, planned.reason)
        else:
            table.add_row(planned.light_name, "no", "", "", "", "", planned.reason)
    if plan.passes:
        console.print(table)
    print_reflectors(console, plan)
    predicted = f"about {milliseconds(plan.predicted_ms)} on {plan.settings.hardware.value}"
    console.print(f"{plan.batch_count} batches, {plan.eye_sample_count} eye samples, {predicted}", highlight=False)
    print_notes(console, list(plan.notes), [item.text for item in snapshot.left_out])


def print_reflectors(console: Console, plan: RenderPlan) -> None:
    if plan.reflections is None:
        return
    table = Table("reflector", "runs", "method", "map", "why")
    for reflector in plan.reflections.lines:
        drawn = reflector.seen or reflector.met
        size = f"{drawn.width_px} x {drawn.height_px} px{' x 6' * drawn.is_cube}" if drawn is not None else ""
        table.add_row(reflector.name, "yes" if reflector.runs else "no", reflector.method_text, size, reflector.reason)
    if not plan.reflections.reflectors:
        console.print("nothing reflects: no material in the scene mirrors sharply enough, and no object is marked as a reflector")
        return
    console.print(table)
    if plan.reflections.runs:
        lights = ", ".join(planned.light_name for planned in plan.reflected_lights) or "no light"
        predicted = milliseconds(plan.reflections.predicted_ms)
        console.print(f"{plan.reflections.bounces} bounces, predicted {predicted}; lit by {lights}", highlight=False, markup=False)


def print_notes(console: Console, notes: list[str], left_out: list[str]) -> None:
    for note in notes:
        console.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    for text in left_out:
        console.print(f"left out: {text}", highlight=False, markup=False, soft_wrap=True)


def print_statistics(console: Console, statistics: SetStatistics) -> None:
    table = Table(Column("pass", no_wrap=True), "method", "views", "maps", "prepared", "prepare ms", "maps ms", "resolve ms", "error")
    for made in statistics.passes:
        if not made.view_count:
            table.add_row(made.pass_name, made.method)
            continue
        times = [f"{made.stage_ms[stage]:.0f}" if stage in made.stage_ms else "" for stage in ("points", "splat or raster", "resolve")]
        faces = f" x {made.face_count} faces" if made.face_count > 1 else ""
        maps = f"{made.map_resolution_px} px{faces}" if made.map_resolution_px else "none"
        # a single map is wrong in all rounds alike, which their spread does not show
        error = error_text(made.error_estimate) + " + bias" * bool(made.filter_sample_count)
        table.add_row(made.pass_name, made.method, str(made.view_count), maps, _prepared(made), *times, error)
    if statistics.passes:
        console.print(table)
    if statistics.reflections is not None and statistics.reflections.map_count:
        found = statistics.reflections
        console.print(
            f"reflections: {found.map_count} maps of {found.map_texel_count:,} texels in all, {found.map_bytes / (1 << 20):.0f} MiB"
            f"{_splatted(found)}; {_found(found)}; error {error_text(found.error_estimate)}",
            highlight=False,
        )
    for made in statistics.passes:
        if not made.map_resolution_px:
            console.print(f"{made.pass_name}: {made.reason}", highlight=False, markup=False)
    totals = total_stage_ms(statistics)
    console.print(", ".join(f"{stage} {milliseconds(totals[stage])}" for stage in STAGES if stage in totals), highlight=False)
    print_notes(console, statistics.notes, statistics.left_out)


def _found(found: ReflectionStatistics) -> str:
    """What became of the rays."""
    if found.look_up == ReflectionLookUp.SHADED.value:
        return f"{found.ray_count:,} rays, all looked up by direction"
    if found.look_up == ReflectionLookUp.LAZY.value:
        return f"{found.ray_count:,} rays, all looked up by direction, {found.shaded_count:,} places shaded for them"
    if found.look_up == ReflectionLookUp.DIRECTION.value:
        shares = f"{found.by_direction_share:.1%} see a surface, {found.left_share:.1%} none"
        return f"of {found.ray_count:,} rays, all looked up by direction, {shares}"
    behind = f"{found.behind_share:.1%} one behind others, where something may be nearer, " if found.behind_share else ""
    hidden = f"{found.by_direction_share:.1%} one hidden from their map"
    return f"of {found.ray_count:,} rays {found.found_share:.1%} met a surface, {behind}{hidden}, {found.left_share:.1%} none"


def _splatted(found: ReflectionStatistics) -> str:
    if not found.splatted_map_count:
        return ""
    counts = {"triangles": found.cloud_triangle_count, "points": found.point_count}
    return f", {found.splatted_map_count} of them from " + " and ".join(f"{count:,} {name}" for name, count in counts.items() if count)


def _prepared(made: PassStatistics) -> str:
    """What all views replay."""
    triangle_count = made.small_triangle_count + made.large_triangle_count
    counts = {"points": made.point_count, "triangles": triangle_count}
    return ", ".join(f"{count:,} {name}" for name, count in counts.items() if count)


def total_stage_ms(statistics: SetStatistics) -> dict[str, float]:
    totals = dict(statistics.stage_ms)
    for made in statistics.passes:
        for stage, spent in made.stage_ms.items():
            totals[stage] = totals.get(stage, 0.0) + spent
    return totals


def statistics_record(frame: int, output: Path, layers: Mapping[str, PassSet]) -> dict[str, Any]:
    """One frame as plain data. Infinite error estimates (a single batch) become null: JSON has no infinity."""
    record: dict[str, Any] = {"frame": frame, "file": str(output), "view_layers": {}}
    for name, passes in layers.items():
        plain = dataclasses.asdict(passes.statistics)
        for made in plain["passes"]:
            made["stage_ms"] = {stage: made["stage_ms"].get(stage, 0.0) for stage in STAGES if stage in made["stage_ms"]}
            if not math.isfinite(made["error_estimate"]):
                made["error_estimate"] = None
        if passes.statistics.reflections is not None and not math.isfinite(passes.statistics.reflections.error_estimate):
            plain["reflections"]["error_estimate"] = None
        plain["total_stage_ms"] = total_stage_ms(passes.statistics)
        record["view_layers"][name] = plain
    return record


def write_statistics(target: Path, scene: Path, records: list[dict[str, Any]]) -> None:
    with whole_file(target) as temporary:
        temporary.write_text(json.dumps({"scene": str(scene), "frames": records}, indent=2, allow_nan=False) + "\n", encoding="utf-8")
