"""Accuracy against time: how far passes are from Cycles with many samples, for more and more views, as a table and a plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from tests import cycles
from vir_addon.blender.job import LayerJob, take_snapshot
from vir_addon.blender.job import run as run_job
from vir_addon.cli.report import total_stage_ms
from vir_addon.core.plan import plan
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .head_scene import MILLION_TRIANGLES_LEVEL, build_head_scene
from .options import Options
from .tables import BenchTable, Column

PASS_NAME = "VIR Shadow Key"
PLOT_NAME = "accuracy_against_time.png"
CYCLES = "Cycles"


def measure_vir(snapshot: SceneSnapshot, method: Method, views: int, reference: cycles.CyclesReference, device: Device) -> dict[str, Any]:
    passes = run_job(LayerJob(snapshot, plan(snapshot, Settings(method=method, view_count=views))), device)
    (made,) = passes.statistics.passes
    seconds = (sum(total_stage_ms(passes.statistics).values())) / 1e3
    errors = reference.errors(passes.images[PASS_NAME])
    return {"renderer": made.method, "count": views, "seconds": seconds, "estimate": made.error_estimate, **errors}


def measure_cycles(scene: bpy.types.Scene, samples: int, reference: cycles.CyclesReference) -> dict[str, Any]:
    shadowed, taken_s = cycles.render(scene, samples, seed=4)
    return {"renderer": CYCLES, "count": samples, "seconds": taken_s, **reference.errors(reference.ratio_of(shadowed))}


def plot(rows: list[dict[str, Any]], title: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5), layout="constrained")
    for renderer in dict.fromkeys(row["renderer"] for row in rows):
        own = [row for row in rows if row["renderer"] == renderer]
        axes.loglog([row["seconds"] for row in own], [row["rmse"] for row in own], marker="o", label=renderer)
        for row in own:
            axes.annotate(str(row["count"]), (row["seconds"], row["rmse"]), textcoords="offset points", xytext=(4, 4), fontsize=7)
    axes.set(title=title, xlabel="seconds", ylabel="RMSE of the shadow ratio")
    axes.title.set_fontsize(9)
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def run(options: Options) -> list[BenchTable]:
    resolution, reference_samples = options.pick((480, 270), (120, 68)), options.pick(1024, 64)
    view_counts, sample_counts = options.pick((8, 16, 32, 64, 128, 256), (8, 16)), options.pick((4, 16, 64), (4,))
    scene = build_head_scene(options.pick(MILLION_TRIANGLES_LEVEL, 3))
    cycles.prepare(scene, resolution)
    reference = cycles.CyclesReference(scene, reference_samples)
    snapshot = take_snapshot(scene, scene.view_layers[0], resolution)
    device = open_device(options.device_name)
    methods = (Method.MVR, Method.IVIR)
    try:
        for method in methods:  # compiles; its time is not what the plot is about
            measure_vir(snapshot, method, view_counts[0], reference, device)
        rows = [measure_vir(snapshot, method, views, reference, device) for method in methods for views in view_counts]
    finally:
        device.close()
    rows += [measure_cycles(scene, samples, reference) for samples in sample_counts]
    title = f"Shadow pass of a head of {snapshot.instanced_triangle_count:,} triangles, {resolution[0]} x {resolution[1]}"
    plot(rows, title, options.output / PLOT_NAME)
    return [
        BenchTable(
            title=title,
            compared=(
                f"RMSE against Cycles with {reference_samples} samples (shadowed over unshadowed, direct light on white diffuse), over "
                f"pixels that receive more than {cycles.DELIVERED_FLOOR:.0%} of what the brightest receive, and over those in a penumbra. "
                "Seconds: VIR from extraction to read-back, shaders compiled; Cycles the shadowed render alone. 'estimate' is VIR's own "
                "error estimate. The reference has noise too."
            ),
            columns=(
                Column("renderer", "renderer"),
                Column("count", "views or samples"),
                Column("seconds", "seconds", "{:.2f}"),
                Column("rmse", "RMSE", "{:.4f}"),
                Column("rmse_penumbra", "in the penumbra", "{:.4f}"),
                Column("estimate", "estimate", "{:.4f}"),
            ),
            rows=rows,
        )
    ]
