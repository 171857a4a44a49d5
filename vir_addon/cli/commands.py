"""The three commands. bpy is imported here and not before: `--help` and usage errors answer at once."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from ..core.errors import DeviceError
from ..core.pass_set import PassSet
from ..core.settings import Settings
from . import report
from .arguments import settings_of
from .interrupts import held_interrupts, stop_if_asked
from .progress import ShownProgress

if TYPE_CHECKING:
    from ..blender.job import LayerJob
    from ..device.interface import Device


def import_blender() -> None:
    """Raises DeviceError when there is no Blender to read the scene with."""
    try:
        from .. import blender  # noqa: F401
    except ImportError as error:
        raise DeviceError(
            f"Blender's Python module bpy cannot be imported ({error}); with Python 3.13 run: python -m pip install bpy==5.2.3"
        ) from error


def open_scene(arguments: argparse.Namespace) -> Any:
    """The bpy.types.Scene that the arguments name."""
    with held_interrupts():
        import_blender()
        from ..blender.open_file import open_blend, scene_named

        open_blend(arguments.scene)
        return scene_named(arguments.scene_name)


def run_plan(arguments: argparse.Namespace, console: Console) -> None:
    settings = settings_of(arguments)
    scene = open_scene(arguments)
    from ..core.plan import check_device, settings_for

    with contextlib.ExitStack() as opened:
        device = _device_to_plan_for(arguments.device, settings, console, opened)
        if device is not None:
            settings = settings_for(device, settings)
        for frame in arguments.frames or [scene.frame_current]:
            jobs = jobs_of(scene, frame, settings, arguments.resolution, lambda step: None)
            for job in jobs.values():
                if device is not None:
                    check_device(job.plan, device)
                report.print_plan(console, job.snapshot, job.plan)


def _device_to_plan_for(name: str, settings: Settings, console: Console, opened: contextlib.ExitStack) -> Device | None:
    """A plan needs no device: without one it is for a software rasterizer, and says so. opened: what closes it"""
    from ..device.open import open_device

    try:
        return opened.enter_context(contextlib.closing(open_device(name)))
    except DeviceError as error:
        console.print(f"note: planned for {settings.hardware.value}, as {error}", highlight=False, markup=False)
        return None


def jobs_of(
    scene: Any, frame: int, settings: Settings, resolution: tuple[int, int] | None, on_step: Callable[[str], None]
) -> dict[str, LayerJob]:
    """Ctrl-C ends it with the current step."""
    from ..blender.job import frame_jobs

    with held_interrupts():

        def begin_step(step: str) -> None:
            stop_if_asked()
            on_step(step)

        return frame_jobs(scene, frame, settings, resolution, begin_step)


def run_render(arguments: argparse.Namespace, console: Console) -> None:
    """Ctrl-C ends it with the current stage: raised anywhere, Python may print and drop it, as where it cleans up."""
    with held_interrupts():
        _render_frames(arguments, console)


def _render_frames(arguments: argparse.Namespace, console: Console) -> None:
    settings = settings_of(arguments)
    scene = open_scene(arguments)
    from ..blender.job import replanned
    from ..core.exr import write_exr
    from ..core.files import check_replaceable, check_writable
    from ..core.plan import check_device, settings_for
    from ..device.open import open_device

    frames = arguments.frames or [scene.frame_current]
    device = None
    records: list[dict[str, Any]] = []
    try:
        for frame in frames:
            with ShownProgress(console, f"frame {frame}") as shown:
                jobs = jobs_of(scene, frame, settings, arguments.resolution, shown.large_step)
            if device is None:
                # after the first plan, as a wrong light name should not wait for a device; before the first picture, which would be lost
                if arguments.stats:
                    check_replaceable(arguments.stats)
                for folder in [arguments.output, *([arguments.stats.parent] if arguments.stats else [])]:
                    check_writable(folder)
                device = open_device(arguments.device)
                planned_for, settings = settings, settings_for(device, settings)
                if settings != planned_for:
                    jobs = replanned(jobs, settings)
            stop_if_asked()
            for job in jobs.values():
                check_device(job.plan, device)
            target = arguments.output / f"{arguments.scene.stem}_{frame:04d}.exr"
            layers = {name: _render_layer(job, device, console, f"frame {frame} {name}") for name, job in jobs.items()}
            start = time.perf_counter()
            pixel_aspect = scene.render.pixel_aspect_x / scene.render.pixel_aspect_y
            write_exr(target, layers, scene_name=scene.name, frame=frame, pixel_aspect=pixel_aspect)
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

    with ShownProgress(console, title) as shown:
        shown.preparing(sum(planned.runs for planned in job.plan.passes), job.plan.predicted_ms)
        return run(job, device, shown.batch, shown.stage)
