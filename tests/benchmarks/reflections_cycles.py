"""Reflections of three scenes against Cycles, beside cubes looked up by direction and EEVEE's rays: errors, and pictures of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import flip_evaluator
import numpy as np
from PIL import Image

from demo_scenes import breakfast, colonnade, gallery, mirror_room
from tests import cycles_reflections
from vir_addon.blender.job import frame_jobs
from vir_addon.blender.job import run as run_job
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.preview import encode_srgb
from vir_addon.core.settings import Effect, ReflectionFilter, ReflectionLookUp, ReflectionMethod, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .options import Options
from .tables import BenchTable, Column

SCENES: dict[str, Callable[[bpy.types.Scene], None]] = {
    "colonnade": lambda scene: colonnade.build(scene, columns=7, has_mirrors=True),
    "breakfast table": breakfast.build,
    "gallery": gallery.build,
}
ROOMS: dict[str, Callable[[bpy.types.Scene], None]] = {
    "mirror sphere in a room": lambda scene: mirror_room.build(scene, shape="sphere"),
    "the same, roughness 0.2": lambda scene: mirror_room.build(scene, shape="sphere", roughness=0.2),
}
"""in which fewer and more rays are compared"""
MIRRORS: dict[str, Callable[[bpy.types.Scene], None]] = {
    **{shape: partial(mirror_room.build, shape=shape) for shape in ("sphere", "column", "flat")},
    "sphere, roughness 0.2": partial(mirror_room.build, shape="sphere", roughness=0.2),
}
"""in the same room, from top to bottom of the picture in docs/reflections.md"""
RAY_COUNTS = 1, 4, 9, 16, 25, 36, 64
"""25 is what Gavane & Watson 2022 b filter with"""
FILTERS = {
    "VIR, eye samples": ReflectionFilter.EYE,
    "VIR, Poisson": ReflectionFilter.POISSON,
    "VIR, Poisson, adaptive": ReflectionFilter.ADAPTIVE,
}
LEAST_COLOR = 0.5
"""what a pixel's reflections are multiplied by at least, in Cycles and here, for it to be judged"""
DIFFERENCE_SCALE = 4
JPEG_QUALITY = 88
MARCHED, BY_DIRECTION, EEVEE = "epr, marched", "mvr, by direction", "EEVEE"
OURS = {
    MARCHED: {"reflection_method": ReflectionMethod.EPR, "reflection_look_up": ReflectionLookUp.MARCH},
    BY_DIRECTION: {"reflection_method": ReflectionMethod.MVR, "reflection_look_up": ReflectionLookUp.DIRECTION, "planar": False},
}
MUST_FACTOR, AIM_RMSE = 2.0, 0.03


def displayed(reflection: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(height, width, 3) float32 up to 1: what reflections add, as a display has it."""
    return encode_srgb(reflection * color).astype(np.float32) / 255


class Comparison:
    """One scene. Row 0 of pictures is at the bottom."""

    def __init__(self, name: str, resolution: tuple[int, int], samples: int, bounces: tuple[int, ...]) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.name, self.scene, self.resolution = name, bpy.context.scene, resolution
        (SCENES | ROOMS | MIRRORS)[name](self.scene)
        halves = [cycles_reflections.render_bounces(self.scene, resolution, samples // 2, bounces, seed) for seed in (2, 3)]
        self.color = (halves[0][0] + halves[1][0]) / 2
        self.judged = self.color.max(axis=-1) > LEAST_COLOR
        self.truths, self.noises = {}, {}
        for count in bounces:
            first, second = (reflections[count] for _, reflections in halves)
            self.truths[count] = displayed((first + second) / 2, self.color)
            self.noises[count] = (displayed(first, self.color) - displayed(second, self.color)) / 2
        self.pictures: dict[tuple[int, str], np.ndarray] = {}
        self.rows: list[dict[str, Any]] = []

    def rms(self, error: np.ndarray) -> float:
        return float(np.sqrt((error[self.judged].astype(np.float64) ** 2).mean()))

    def measure_ours(self, device: Device, view_count: int) -> None:
        for count in self.truths:
            for name, choices in OURS.items():
                settings = Settings(effects=(Effect.REFLECTION,), bounces=count, view_count=view_count, **choices)
                (job,) = frame_jobs(self.scene, self.scene.frame_current, settings, self.resolution).values()
                passes = run_job(job, device)
                color = passes.images[REFLECTION_COLOR_PASS_NAME]
                found = passes.statistics.reflections
                assert found is not None
                self.judged &= color.max(axis=-1) > LEAST_COLOR
                self.pictures[count, name] = displayed(passes.images[REFLECTION_PASS_NAME], color)
                self.rows.append({"bounces": count, "renderer": name, "hidden": found.by_direction_share})

    def measure_eevee(self, samples: int) -> str:
        """Returns why there is nothing to compare with, if so."""
        try:
            picture = displayed(*cycles_reflections.render_eevee(self.scene, self.resolution, samples))
        except (RuntimeError, TypeError) as error:
            return f"EEVEE does not render here: {error}."
        if not picture[self.judged].any():
            return "EEVEE renders black here."
        for count in self.truths:
            self.pictures[count, EEVEE] = picture
            self.rows.append({"bounces": count, "renderer": EEVEE})
        return ""

    def measure_look_ups(self, device: Device) -> Iterator[np.ndarray]:
        """Rows with errors of maps that are marched through and looked up by direction; yields pictures of both, the reference first, each
        but that followed by its difference."""
        truth = self.truths[1]
        yield truth
        for look_up in (ReflectionLookUp.MARCH, ReflectionLookUp.DIRECTION):
            settings = Settings(effects=(Effect.REFLECTION,), bounces=1, view_count=16, reflection_look_up=look_up)
            (job,) = frame_jobs(self.scene, self.scene.frame_current, settings, self.resolution).values()
            images = run_job(job, device).images
            picture = displayed(images[REFLECTION_PASS_NAME], images[REFLECTION_COLOR_PASS_NAME])
            self.rows.append({"look_up": look_up.value, "rmse": self.rms(picture - truth)})
            yield picture
            yield np.clip(DIFFERENCE_SCALE * np.abs(picture - truth), 0, 1) * self.judged[..., None]

    def measure_rays(self, device: Device, counts: tuple[int, ...]) -> Iterator[dict[str, Any]]:
        """Of one bounce: so many rays a pixel, each of an eye sample of its own or as published; and as many samples of Cycles. Whole
        frames, after one that compiles."""
        truth = self.truths[1]
        for name, kind in FILTERS.items():
            for turn, count in enumerate((counts[0], *counts)):
                settings = Settings(
                    effects=(Effect.REFLECTION,), bounces=1, view_count=16, reflection_sample_count=count, reflection_filter=kind
                )
                (job,) = frame_jobs(self.scene, self.scene.frame_current, settings, self.resolution).values()
                start_s = time.process_time()
                passes = run_job(job, device)
                seconds = time.process_time() - start_s
                picture = displayed(passes.images[REFLECTION_PASS_NAME], passes.images[REFLECTION_COLOR_PASS_NAME])
                found = passes.statistics.reflections
                assert found is not None
                if turn:  # the first compiles
                    row = {"renderer": name, "count": count, "rays": found.rays_per_pixel}
                    yield {**row, "cpu_s": seconds, "rmse": self.rms(picture - truth)}
        for count in counts:
            start_s = time.process_time()
            reflection, color = cycles_reflections.render(self.scene, self.resolution, count, bounces=1)
            # of two renders, one of which tells highlights apart
            seconds = (time.process_time() - start_s) / 2
            picture = displayed(reflection, color)
            yield {"renderer": "Cycles", "count": count, "cpu_s": seconds, "rmse": self.rms(picture - truth)}

    def judge(self) -> list[dict[str, Any]]:
        for row in self.rows:
            truth, picture = self.truths[row["bounces"]], self.pictures[row["bounces"], row["renderer"]]
            shown = self.judged[..., None]
            flip, _, _ = flip_evaluator.evaluate(truth[::-1] * shown[::-1], picture[::-1] * shown[::-1], "LDR", applyMagma=False)
            row |= {
                "scene": self.name,
                "rmse": self.rms(picture - truth),
                "flip": float(flip[::-1].squeeze()[self.judged].mean()),
                "noise": self.rms(self.noises[row["bounces"]]),
                "pixels": int(self.judged.sum()),
            }
        for row in self.rows:
            own = next(each for each in self.rows if (each["bounces"], each["renderer"]) == (row["bounces"], MARCHED))
            row |= {f"{key}_factor": row[key] / own[key] for key in ("rmse", "flip")}
        self.rows.sort(key=lambda row: row["bounces"])
        return self.rows

    def save_pictures(self, folder: Path) -> None:
        """For every number of bounces: the reference and what is compared with it, above their differences."""
        for count, truth in self.truths.items():
            shown = [self.pictures[count, name] for name in (MARCHED, BY_DIRECTION, EEVEE) if (count, name) in self.pictures]
            differences = [np.clip(DIFFERENCE_SCALE * np.abs(each - truth), 0, 1) * self.judged[..., None] for each in shown]
            above = np.concatenate([truth, *shown], axis=1)
            below = np.concatenate([np.zeros_like(truth), *differences], axis=1)
            sheet = np.concatenate([below, above])[::-1]
            path = folder / f"reflections_{self.name.replace(' ', '_')}_{count}.jpg"
            Image.fromarray((255 * sheet + 0.5).astype(np.uint8)).save(path, quality=JPEG_QUALITY)


def run(options: Options) -> Iterator[list[BenchTable]]:
    resolution, samples, bounces = options.pick(((320, 180), 192, (1, 2, 3)), ((64, 36), 8, (1, 2)))
    rows: list[dict[str, Any]] = []
    notes: list[str] = []
    for name in SCENES:
        comparison = Comparison(name, resolution, samples, bounces)
        device = open_device(options.device_name)
        try:
            comparison.measure_ours(device, options.pick(16, 4))
        finally:
            device.close()
        note = comparison.measure_eevee(options.pick(64, 2))
        notes += [note] * (bool(note) and note not in notes)
        rows += comparison.judge()
        comparison.save_pictures(options.output)
        yield [table(rows, resolution, samples, notes)]


def room(options: Options) -> Iterator[list[BenchTable]]:
    """Mirrors in a room, marched through depth and looked up by direction, and their picture."""
    resolution, samples = options.pick(((256, 144), 256), ((64, 36), 8))
    rows: list[dict[str, Any]] = []
    strips: list[np.ndarray] = []
    for name in MIRRORS:
        comparison = Comparison(name, resolution, samples, (1,))
        device = open_device(options.device_name)
        try:
            strips.append(np.concatenate(list(comparison.measure_look_ups(device)), axis=1))
        finally:
            device.close()
        errors = {row["look_up"]: row["rmse"] for row in comparison.rows}
        rows.append({"mirror": name, "noise": comparison.rms(comparison.noises[1]), **errors})
        yield [table_of_room(rows, resolution, samples)]
    sheet = np.concatenate([strip[::-1] for strip in strips])
    Image.fromarray((255 * sheet + 0.5).astype(np.uint8)).quantize(256).save(options.output / "reflections_mirror_room.png", optimize=True)


def table_of_room(rows: list[dict[str, Any]], resolution: tuple[int, int], samples: int) -> BenchTable:
    return BenchTable(
        title=f"Mirrors in a room, {resolution[0]} x {resolution[1]}",
        compared=f"One bounce, lamps of 16 views; RMSE as displayed on pixels that reflect, from Cycles with {samples} samples.",
        columns=(
            Column("mirror", "mirror"),
            Column("march", "marched", "{:.4f}"),
            Column("direction", "by direction", "{:.4f}"),
            Column("noise", "noise", "{:.4f}"),
        ),
        rows=rows,
    )


def rays(options: Options) -> Iterator[list[BenchTable]]:
    """What fewer and more rays of a pixel cost and bring."""
    resolution, samples, counts = options.pick(((256, 144), 256, RAY_COUNTS), ((64, 36), 8, RAY_COUNTS[:2]))
    rows: list[dict[str, Any]] = []
    for name in ROOMS:
        comparison = Comparison(name, resolution, samples, (1,))
        noise = comparison.rms(comparison.noises[1])
        device = open_device(options.device_name)
        try:
            for row in comparison.measure_rays(device, counts):
                rows.append({"scene": name, "noise": noise, **row})
                yield [table_of_rays(rows, resolution, samples)]
        finally:
            device.close()


def table_of_rays(rows: list[dict[str, Any]], resolution: tuple[int, int], samples: int) -> BenchTable:
    return BenchTable(
        title=f"Reflections by rays of a pixel, {resolution[0]} x {resolution[1]}",
        compared=(
            "One bounce, by rays of eye samples of their own or, as published, by the gradient of normals around one; errors as of "
            f"reflections against Cycles, which has {samples} samples. Seconds of all processors, of whole frames from the scene as it is "
            "read on; Cycles in one render of both passes."
        ),
        columns=(
            Column("scene", "scene"),
            Column("renderer", "renderer"),
            Column("count", "rays, samples"),
            Column("rays", "rays followed", "{:.1f}"),
            Column("cpu_s", "processors, s", "{:.2f}"),
            Column("rmse", "RMSE", "{:.4f}"),
            Column("noise", "noise", "{:.4f}"),
        ),
        rows=rows,
    )


def table(rows: list[dict[str, Any]], resolution: tuple[int, int], samples: int, notes: list[str]) -> BenchTable:
    return BenchTable(
        title=f"Reflections against Cycles, {resolution[0]} x {resolution[1]}",
        compared=(
            f"What reflections add, as displayed (sRGB, up to 1), on pixels that reflect more than {LEAST_COLOR:.0%}, against Cycles with "
            f"{samples} samples and direct light only; noise: its own standard error. 'Times': over that of marching, at least "
            f"{MUST_FACTOR:g} by direction and more than 1 for EEVEE; an RMSE of {AIM_RMSE} is aimed at for one bounce. By direction: "
            "of cubes, as published, also of flat mirrors. EEVEE: rays in the picture at full resolution, which do not go on from mirror "
            f"to mirror; the same picture for all bounces. {' '.join(notes)}"
        ),
        columns=(
            Column("scene", "scene"),
            Column("bounces", "bounces"),
            Column("renderer", "renderer"),
            Column("rmse", "RMSE", "{:.4f}"),
            Column("rmse_factor", "times", "{:.2f}"),
            Column("flip", "FLIP", "{:.4f}"),
            Column("flip_factor", "times", "{:.2f}"),
            Column("noise", "noise", "{:.4f}"),
            Column("hidden", "hidden from maps", "{:.1%}"),
        ),
        rows=rows,
    )
