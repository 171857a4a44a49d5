"""The whole way from the scene to the EXR, stage by stage, against Cycles in the same process."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy

from tests import cycles
from vir_addon.blender.job import frame_jobs
from vir_addon.blender.job import run as run_job
from vir_addon.cli.report import total_stage_ms
from vir_addon.core.exr import write_exr
from vir_addon.core.pass_set import STAGES
from vir_addon.core.plan import settings_for
from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .head_scene import MILLION_TRIANGLES_LEVEL, build_head_scene
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio, round_ratios, take_turns

EVALUATE = "evaluate"
"""Blender's evaluation of modifiers, and the plan: what a render needs before the stages of the statistics"""

CYCLES = "Cycles"


def render_once(scene: bpy.types.Scene, method: Method, view_count: int, resolution: tuple[int, int], device: Device) -> dict[str, Any]:
    """Seconds of the whole, milliseconds of the stages, and counts."""
    settings = settings_for(device, Settings(method=method, view_count=view_count))
    with tempfile.TemporaryDirectory() as folder:
        start_s = time.perf_counter()
        (job,) = frame_jobs(scene, scene.frame_current, settings, resolution).values()
        evaluated_s = time.perf_counter()
        passes = run_job(job, device)
        rendered_s = time.perf_counter()
        write_exr(Path(folder) / "head.exr", {"ViewLayer": passes}, scene_name=scene.name, frame=scene.frame_current)
        written_s = time.perf_counter()
    stage_ms = total_stage_ms(passes.statistics)
    stage_ms[EVALUATE] = (evaluated_s - start_s) * 1e3 - stage_ms["extract"]
    stage_ms["write"] = (written_s - rendered_s) * 1e3
    total_ms = (written_s - start_s) * 1e3
    stage_ms["other"] = total_ms - sum(stage_ms.values())
    (made,) = passes.statistics.passes
    return {"total_ms": total_ms, "stage_ms": stage_ms, "triangles": passes.statistics.instanced_triangle_count, "how": made.method}


def render_cycles_once(scene: bpy.types.Scene, samples: int) -> dict[str, Any]:
    _, taken_s, _ = cycles.render(scene, samples)
    return {"total_ms": taken_s * 1e3, "stage_ms": {}, "how": f"{CYCLES}, {samples} samples"}


def run(options: Options) -> list[BenchTable]:
    round_count = options.round_count(quick=1)
    sample_count, resolution = options.pick(64, 8), options.pick((960, 540), (240, 135))
    scene = build_head_scene(options.pick(MILLION_TRIANGLES_LEVEL, 3))
    cycles.prepare(scene, resolution)
    device = open_device(options.device_name)
    try:
        left_out = {Method.EPR: "the light is an area light", Method.PCSS: "it has one map"}
        if not device.stores_from_fragments:
            left_out[Method.VWSS] = "this device refuses it"
        methods = [method for method in Method if method not in left_out]
        jobs = {method.value: lambda m=method: render_once(scene, m, sample_count, resolution, device) for method in methods}
        first = {name: job() for name, job in jobs.items()}
        results = take_turns({**jobs, CYCLES: lambda: render_cycles_once(scene, sample_count)}, round_count)
    finally:
        device.close()
    cycles_ms = [result["total_ms"] for result in results[CYCLES]]
    rows = []
    for name, rounds in results.items():
        total_ms = [result["total_ms"] for result in rounds]
        rows.append(
            {
                "asked": f"{name}: {rounds[0]['how']}" if name == Method.AUTO.value else rounds[0]["how"],
                **{stage: statistics.median(r["stage_ms"][stage] for r in rounds) for stage in rounds[0]["stage_ms"]},
                "total_ms": statistics.median(total_ms),
                "total_ms_by_round": total_ms,
                "first_ms": first[name]["total_ms"] if name in first else None,
                "speedup": median_ratio(cycles_ms, total_ms),
                "speedup_by_round": round_ratios(cycles_ms, total_ms),
            }
        )
    stages = [stage for stage in (EVALUATE, *STAGES, "other") if any(stage in row for row in rows)]
    triangles = first[Method.AUTO.value]["triangles"]
    return [
        BenchTable(
            title=f"Whole render of a head of {triangles:,} triangles on a floor, {resolution[0]} x {resolution[1]}, {sample_count} views",
            compared=(
                f"Milliseconds, medians of {round_count} rounds in which all take turns in one process. VIR: from the open "
                "scene to the written EXR; 'first' is its first render, which also compiles shaders. Cycles: `render.render` on the CPU "
                "with as many samples as VIR has views, the same scene and size, white diffuse, direct light with shadows, no bounces, no "
                "denoising; its picture is the light's contribution with noise, not a ratio."
                + "".join(f" Without {method.value}: {reason}." for method, reason in left_out.items())
            ),
            columns=(
                Column("asked", "renderer"),
                *(Column(stage, stage, "{:.0f}") for stage in stages),
                Column("total_ms", "total", "{:.0f}"),
                Column("first_ms", "first", "{:.0f}"),
                Column("speedup", "Cycles / this", "{:.2f}"),
            ),
            rows=rows,
        )
    ]
