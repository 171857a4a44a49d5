"""What looking settled tiles up again costs: `--resolve adaptive` against `full`, times and what pictures differ by."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from demo_scenes import still_life
from vir_addon.blender.job import LayerJob, take_snapshot
from vir_addon.blender.job import run as run_job
from vir_addon.core.pass_set import COMBINED_PASS_NAME
from vir_addon.core.plan import plan, settings_for
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Resolve, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .head_scene import MILLION_TRIANGLES_LEVEL, build_head_scene
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio, round_ratios, take_turns


def render_once(snapshot: SceneSnapshot, settings: Settings, device: Device) -> dict[str, Any]:
    passes = run_job(LayerJob(snapshot, plan(snapshot, settings_for(device, settings))), device)
    made = passes.statistics.passes
    return {
        "resolve_ms": sum(each.stage_ms.get("resolve", 0.0) for each in made),
        "eye_ms": passes.statistics.stage_ms["eye G-buffer"],
        "settled_share": float(np.mean([each.settled_share for each in made])),
        "image": passes.images[COMBINED_PASS_NAME],
    }


def measure(name: str, snapshot: SceneSnapshot, settings: Settings, rounds: int, device: Device) -> dict[str, Any]:
    render_once(snapshot, replace(settings, view_count=16), device)  # compiles
    jobs = {
        each.value: lambda r=each: render_once(snapshot, replace(settings, resolve=r), device) for each in (Resolve.ADAPTIVE, Resolve.FULL)
    }
    results = take_turns(jobs, rounds)
    adaptive, full = results[Resolve.ADAPTIVE.value], results[Resolve.FULL.value]
    times = [[found["resolve_ms"] for found in each] for each in (adaptive, full)]
    difference = adaptive[0].pop("image").astype(np.float64) - full[0].pop("image")
    return {
        "scene": name,
        "lights": len(snapshot.lights),
        "settled_share": adaptive[0]["settled_share"],
        "adaptive_ms": statistics.median(times[0]),
        "full_ms": statistics.median(times[1]),
        "share": median_ratio(*times),
        "share_by_round": round_ratios(*times),
        "eye_share": median_ratio([found["eye_ms"] for found in adaptive], [found["eye_ms"] for found in full]),
        "rms": float(np.sqrt((difference**2).mean())),
        "largest": float(np.abs(difference).max()),
    }


def run(options: Options) -> list[BenchTable]:
    view_count, resolution = options.pick((128, (1920, 1080)), (32, (96, 54)))
    settings = Settings(view_count=view_count, map_resolution_px=options.pick(1024, 64))
    rounds = options.round_count(full=2, quick=1)

    def build_still_life() -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        still_life.build(bpy.context.scene)

    scenes: dict[str, Callable[[], object]] = {
        "head on a floor": lambda: build_head_scene(options.pick(MILLION_TRIANGLES_LEVEL, 3)),
        "still life": build_still_life,
    }
    rows = []
    device = open_device(options.device_name)
    try:
        for name, build in scenes.items():
            build()
            scene = bpy.context.scene
            rows.append(measure(name, take_snapshot(scene, scene.view_layers[0], resolution), settings, rounds, device))
    finally:
        device.close()
    return [
        BenchTable(
            title=f"Looking up adaptively against looking everything up: {resolution[0]} x {resolution[1]}, {view_count} views",
            compared=(
                f"Time of the stage 'resolve' of all lights, medians of {rounds} rounds, `auto`; 'share' is adaptive / full, "
                "aimed at 0.25; 'eye' the same share of the eye's G-buffers. 'settled': mean share of tiles that the last batch only "
                "probed. RMS and the largest difference of the combined passes of the two."
            ),
            columns=(
                Column("scene", "scene"),
                Column("lights", "lights"),
                Column("settled_share", "settled", "{:.0%}"),
                Column("full_ms", "full, ms", "{:.0f}"),
                Column("adaptive_ms", "adaptive, ms", "{:.0f}"),
                Column("share", "share", "{:.2f}"),
                Column("eye_share", "eye", "{:.2f}"),
                Column("rms", "RMS", "{:.5f}"),
                Column("largest", "largest", "{:.3f}"),
            ),
            rows=rows,
        )
    ]
