"""The three commands. bpy is imported here and not before: `--help` and usage errors answer at once."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ..core.errors import DeviceError
from ..core.pass_set import PassSet
from . import report
from .arguments import settings_of

if TYPE_CHECKING:
    from ..blender.job import LayerJob
    from ..core.render import Progress as RenderProgress
    from ..device.interface import Device


def import_blender() -> None:
    """Raises DeviceError when there is no Blender to read the scene with."""
    try:
        from .. import blender  # noqa: F401
    except ImportError as error:
        raise DeviceError(
            f"Blender's Python module bpy cannot be imported ({error}); with Python 3.13 run: python -m pip install bpy==5.2.3"
        ) from error


def run_plan(arguments: argparse.Namespace, console: Console) -> None:
    settings = settings_of(arguments)
    import_blender()
    from ..blender.job import frame_jobs
    from ..blender.open_file import open_blend, scene_named

    open_blend(arguments.scene)
    scene = scene_named(arguments.scene_name)
    for frame in arguments.frames or [scene.frame_current]:
        for job in frame_jobs(scene, frame, settings, arguments.resolution).values():
            report.print_plan(console, job.snapshot, job.plan)


def run_render(arguments: argparse.Namespace, console: Console) -> None:
    settings = settings_of(arguments)
    import_blender()
    from ..blender.job import frame_jobs
    from ..blender.open_file import open_blend, scene_named
    from ..core.exr import write_exr
    from ..core.files import check_writable
    from ..device.open import open_device

    open_blend(arguments.scene)
    scene = scene_named(arguments.scene_name)
    frames = arguments.frames or [scene.frame_current]
    device = None
    records: list[dict[str, Any]] = []
    try:
        for frame in frames:
            jobs = frame_jobs(scene, frame, settings, arguments.resolution)
            if device is None:
                # after the first plan, as a wrong light name should not wait for a device; before the first picture, which would be lost
                for folder in [arguments.output, *([arguments.stats.parent] if arguments.stats else [])]:
                    check_writable(folder)
                device = open_device(arguments.device)
            target = arguments.output / f"{arguments.scene.stem}_{frame:04d}.exr"
            layers = {name: _render_layer(job, device, console, f"frame {frame} {name}") for name, job in jobs.items()}
            start = time.perf_counter()
            write_exr(target, layers, scene_name=scene.name, frame=frame)
            if arguments.preview:
                _write_previews(target, layers)
            write_ms = (time.perf_counter() - start) * 1e3
            for passes in layers.values():
                passes.statistics.stage_ms["write"] = write_ms / len(layers)
                report.print_statistics(console, passes.statistics)
            console.print(f"wrote {target}", highlight=False, markup=False, soft_wrap=True)
            records.append(report.statistics_record(frame, target, layers))
            if arguments.stats:
                report.write_statistics(arguments.stats, arguments.scene, records)
    finally:
        if device is not None:
            device.close()


def _write_previews(target: Path, layers: dict[str, PassSet]) -> None:
    from ..blender.fonts import find_label_font
    from ..core.preview import file_name_part, write_previews

    for name, passes in layers.items():
        stem = target.stem if len(layers) == 1 else f"{target.stem}_{file_name_part(name)}"
        write_previews(target.parent, stem, passes, find_label_font())


def _render_layer(job: LayerJob, device: Device, console: Console, title: str) -> PassSet:
    from ..blender.job import run

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("views, {task.fields[left]} left, error {task.fields[error]},"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(title, total=None, left="?", error="?")

        def show(progress: RenderProgress) -> None:
            bar.update(
                task,
                total=max(progress.views_total, 1),
                completed=progress.views_done if progress.views_total else 1,
                left=f"{progress.seconds_left:.0f} s",
                error=report.error_text(progress.error_estimate),
            )

        return run(job, device, show)
