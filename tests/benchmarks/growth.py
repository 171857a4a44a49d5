"""How time grows: with views, triangles, the maps' size and the picture's pixels, one of them at a time, as tables and plots."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.plan import plan, settings_for
from vir_addon.core.render import render
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .options import Options
from .tables import BenchTable, Column
from .timing import take_turns

MAPS_STAGES = ("points", "splat or raster")
COLUMNS = (
    Column("maps_ms", "maps, ms", "{:.0f}"),
    Column("prepared_ms", "of it prepared", "{:.0f}"),
    Column("resolve_ms", "resolve, ms", "{:.0f}"),
    Column("eye_ms", "eye, ms", "{:.0f}"),
    Column("total_ms", "all, ms", "{:.0f}"),
    Column("cpu_ms", "processors, ms", "{:.0f}"),
)


@dataclass(frozen=True)
class Work:
    """What is rendered: a bumpy sphere on a floor."""

    views: int = 32
    triangles: int = 500_000
    map_size: int = 1024
    width_px: int = 480

    @property
    def pixels(self) -> int:
        return self.width_px * self.height_px

    @property
    def height_px(self) -> int:
        return round(self.width_px * 9 / 16)


@dataclass(frozen=True)
class Axis:
    name: str
    """a property of Work"""
    label: str
    works: tuple[Work, ...]


def render_once(work: Work, snapshot: SceneSnapshot, method: Method, device: Device) -> dict[str, float]:
    """Milliseconds from the snapshot to the finished sums."""
    settings = settings_for(device, Settings(method=method, view_count=work.views, map_resolution_px=work.map_size))
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    shared_ms: dict[str, float] = {}
    own_ms: dict[str, float] = {}
    for progress in render(snapshot, plan(snapshot, settings), device):
        shared_ms, own_ms = progress.statistics.stage_ms, progress.statistics.passes[0].stage_ms
    device.finish()
    return {
        "maps_ms": sum(own_ms[stage] for stage in MAPS_STAGES),
        "prepared_ms": own_ms["points"],
        "resolve_ms": own_ms["resolve"],
        "eye_ms": shared_ms["eye G-buffer"],
        "total_ms": (time.perf_counter() - start_s) * 1e3,
        "cpu_ms": (time.process_time() - start_cpu_s) * 1e3,
    }


def measure(axis: Axis, methods: tuple[Method, ...], rounds: int, device: Device) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for work in axis.works:
        snapshot = sphere_snapshot(work.triangles, work.width_px, work.height_px, has_floor=True)
        if not rows:
            for method in methods:  # compiles
                render_once(work, snapshot, method, device)
        results = take_turns(
            {method.value: lambda m=method, w=work, s=snapshot: render_once(w, s, m, device) for method in methods}, rounds
        )
        size = snapshot.instanced_triangle_count if axis.name == "triangles" else getattr(work, axis.name)
        for name, found in results.items():
            medians = {key: statistics.median(each[key] for each in found) for key in found[0]}
            rows.append({"method": name, axis.name: size, **medians, "rounds": found})
    return rows


def plot(axis: Axis, rows: list[dict[str, Any]], title: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5), layout="constrained")
    for name in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == name]
        sizes = [row[axis.name] for row in own]
        (line,) = axes.loglog(sizes, [row["total_ms"] for row in own], marker="o", label=f"{name}, all")
        axes.loglog(sizes, [row["maps_ms"] for row in own], marker=".", linestyle="--", color=line.get_color(), label=f"{name}, maps")
    axes.set(title=title, xlabel=axis.label, ylabel="milliseconds")
    axes.title.set_fontsize(9)
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def run_axis(axis: Axis, options: Options) -> list[BenchTable]:
    rounds = options.round_count(full=3, quick=1)
    device = open_device(options.device_name)
    try:
        rows = measure(axis, AUTO_METHODS, rounds, device)
    finally:
        device.close()
    base = axis.works[0]
    others = {"views": f"{base.views} views", "triangles": f"{base.triangles:,} triangles", "map_size": f"maps of {base.map_size}²"}
    others["pixels"] = f"{base.width_px} x {base.height_px}"
    fixed = ", ".join(text for name, text in others.items() if name != axis.name)
    title = f"Growth with {axis.label}: bumpy sphere on a floor, {fixed}"
    plot(axis, rows, title, options.output / f"growth_{axis.name}.png")
    return [
        BenchTable(
            title=title,
            compared=(
                f"Medians of {rounds} rounds of whole renders from the snapshot on, in which the methods that `auto` chooses from "
                "take turns. 'maps' holds 'prepared', what all views share; 'eye' are the eye's G-buffers; 'processors' is processor time "
                f"of all threads. Plot: growth_{axis.name}.png."
            ),
            columns=(Column("method", "method"), Column(axis.name, axis.label, "{:,}"), *COLUMNS),
            rows=rows,
        )
    ]


def views(options: Options) -> list[BenchTable]:
    counts = options.pick((4, 8, 16, 32, 64, 128, 256, 512), (4, 16))
    base = options.pick(Work(), Work(triangles=5_000, map_size=128, width_px=96))
    return run_axis(Axis("views", "views", tuple(Work(count, base.triangles, base.map_size, base.width_px) for count in counts)), options)


def triangles(options: Options) -> list[BenchTable]:
    counts = options.pick((10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 8_000_000), (1_000, 10_000))
    base = options.pick(Work(), Work(8, 0, 128, 96))
    return run_axis(
        Axis("triangles", "triangles", tuple(Work(base.views, count, base.map_size, base.width_px) for count in counts)), options
    )


def map_size(options: Options) -> list[BenchTable]:
    sizes = options.pick((256, 512, 1024, 2048, 4096), (64, 128))
    base = options.pick(Work(), Work(8, 5_000, 0, 96))
    works = tuple(Work(base.views, base.triangles, size, base.width_px) for size in sizes)
    return run_axis(Axis("map_size", "texels along a map", works), options)


def pixels(options: Options) -> list[BenchTable]:
    widths = options.pick((240, 480, 960, 1920, 3840), (48, 96))
    base = options.pick(Work(), Work(8, 5_000, 128))
    return run_axis(Axis("pixels", "pixels", tuple(Work(base.views, base.triangles, base.map_size, width) for width in widths)), options)
