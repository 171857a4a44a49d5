"""Equal error and equal work against what Blender has: Cycles, Cycles denoised, EEVEE, all in one process; error against time.

Everybody renders the same white scene with one light and the same pixel filter; errors are those of the shadow ratio, over the same pixels,
against Cycles with many samples.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from demo_scenes import colonnade, furnished_room
from tests import cycles
from tests.eevee import choose_eevee
from vir_addon.blender.job import frame_jobs
from vir_addon.blender.job import run as run_job
from vir_addon.core.exr import write_exr
from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.plan import settings_for
from vir_addon.core.settings import Method, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .head_scene import MILLION_TRIANGLES_LEVEL, build_head_scene
from .model_scene import open_model
from .options import Options
from .tables import BenchTable, Column

CYCLES, DENOISED, EEVEE = "Cycles", "Cycles, denoised", "EEVEE"
TWO_PICTURES = ", two pictures"
VIR_AUTO = f"VIR {Method.AUTO.value}"
"""what others are compared with: which method would have been fastest is known only afterwards"""
ASKED_RMSE = 0.03
FINER_RMSES = (0.02, 0.01)
"""which are shown as well"""
EEVEE_SLACK = 1.05
"""of EEVEE's best error: nobody waits four times as long for the last few percent"""
Row = dict[str, Any]


class Contest:
    """One scene, its reference and everybody's measurements."""

    def __init__(self, scene: bpy.types.Scene, resolution: tuple[int, int], reference_samples: int) -> None:
        self.scene, self.resolution = scene, resolution
        lights = [thing for thing in scene.objects if thing.type == "LIGHT" and not thing.hide_render]
        self.light = max(lights, key=lambda thing: (thing.data.energy, thing.name))
        for thing in lights:
            thing.hide_render = thing is not self.light
        cycles.prepare(scene, resolution)
        self.reference = cycles.CyclesReference(scene, reference_samples)
        self.rows: list[Row] = []
        self.notes: list[str] = []

    def add(self, renderer: str, count: int, ratio: np.ndarray, seconds: float, cpu_seconds: float) -> None:
        errors = self.reference.errors(ratio)
        self.rows.append({"renderer": renderer, "count": count, "seconds": seconds, "cpu_seconds": cpu_seconds, **errors})

    def measure_vir(self, view_counts: tuple[int, ...], device: Device) -> None:
        """The pass and the seconds of `render`, as of Cycles: from the open scene to the written file."""

        def render(method: Method, views: int) -> tuple[np.ndarray, float, float]:
            settings = settings_for(device, Settings(method=method, view_count=views, light_names=(self.light.name,)))
            scene = self.scene
            with tempfile.TemporaryDirectory() as folder:
                start_s, start_cpu_s = time.perf_counter(), time.process_time()
                (job,) = frame_jobs(scene, scene.frame_current, settings, self.resolution).values()
                passes = run_job(job, device)
                write_exr(Path(folder) / "image.exr", {"ViewLayer": passes}, scene_name=scene.name, frame=scene.frame_current)
                taken_s, taken_cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
            return passes.images[shadow_pass_name(self.light.name)], taken_s, taken_cpu_s

        for method in (Method.AUTO, *AUTO_METHODS):
            render(method, view_counts[0])  # compiles; its time is not what the curve is about
            for views in view_counts:
                self.add(f"VIR {method.value}", views, *render(method, views))

    def measure_cycles(self, sample_counts: tuple[int, ...]) -> None:
        """One picture over what the reference receives without shadows, as if that were had for nothing; and over one of the same samples,
        whose noise is the same, with the time of both."""
        for name in (CYCLES, DENOISED):
            self.scene.cycles.use_denoising = name == DENOISED
            for samples in sample_counts:
                image, unshadowed, taken = cycles.render_pair(self.scene, self.light, samples, seed=4)
                self.add(name, samples, self.reference.ratio_of(image), *taken[0])
                self.add(name + TWO_PICTURES, samples, self.reference.ratio_of(image, unshadowed), *taken.sum(axis=0))
        self.scene.cycles.use_denoising = False

    def measure_eevee(self, sample_counts: tuple[int, ...]) -> None:
        """Jittered soft shadows, with the most rays and steps that there are."""
        engine = self.scene.render.engine
        try:
            choose_eevee(self.scene)
            self.light.data.use_shadow_jitter = True
            eevee = self.scene.eevee
            eevee.shadow_ray_count, eevee.shadow_step_count = 4, 16

            def render(samples: int, *, has_shadows: bool = True) -> tuple[np.ndarray, float, float]:
                eevee.taa_render_samples = samples
                self.light.data.use_shadow = has_shadows
                return cycles.render(self.scene, samples)

            render(1)  # compiles
            unshadowed = render(max(sample_counts), has_shadows=False)[0]
            if not unshadowed[self.reference.judged].any():
                raise RuntimeError("its picture is black")
            for samples in sample_counts:
                image, seconds, cpu_seconds = render(samples)
                self.add(EEVEE, samples, np.clip(image / np.maximum(unshadowed, 1e-12), 0, 1), seconds, cpu_seconds)
        except (RuntimeError, TypeError) as error:
            self.notes.append(f"EEVEE does not render here: {error}")
        finally:
            self.light.data.use_shadow = True
            self.scene.render.engine = engine


def seconds_to_reach(rows: list[Row], rmse: float, seconds: str = "seconds") -> float:
    """When the curve through the measurements first comes down to `rmse`; straight between them in logarithmic axes, infinite
    if it does not. The first measurement's time if that is good enough already."""
    ordered = sorted(rows, key=lambda row: row[seconds])
    for k, row in enumerate(ordered):
        if row["rmse"] > rmse:
            continue
        if k == 0:
            return row[seconds]
        before = ordered[k - 1]
        share = math.log(before["rmse"] / rmse) / math.log(before["rmse"] / max(row["rmse"], 1e-9))
        return before[seconds] * (row[seconds] / before[seconds]) ** share
    return math.inf


def run_of_eevee(rows: list[Row]) -> Row | None:
    """EEVEE's quickest run whose error is nearly its best; None without EEVEE."""
    own = [row for row in rows if row["renderer"] == EEVEE]
    best_rmse = min((row["rmse"] for row in own), default=math.inf)
    return min((row for row in own if row["rmse"] <= EEVEE_SLACK * best_rmse), key=lambda row: row["seconds"], default=None)


def summary(rows: list[Row]) -> list[Row]:
    """Renderer by renderer, with what `auto` takes over what each takes. None: there is no EEVEE, or VIR does not get there."""
    renderers = {name: [row for row in rows if row["renderer"] == name] for name in dict.fromkeys(row["renderer"] for row in rows)}
    eevee = run_of_eevee(rows)

    def to_eevee(name: str, seconds: str) -> float | None:
        if eevee is None:
            return None
        return eevee[seconds] if name == EEVEE else seconds_to_reach(renderers[name], eevee["rmse"], seconds)

    found = {
        name: {
            "renderer": name,
            "best_rmse": min(row["rmse"] for row in own),
            "seconds": seconds_to_reach(own, ASKED_RMSE),
            "cpu_seconds": seconds_to_reach(own, ASKED_RMSE, "cpu_seconds"),
            **{f"cpu_seconds_to_{rmse}": seconds_to_reach(own, rmse, "cpu_seconds") for rmse in FINER_RMSES},
            "eevee_seconds": to_eevee(name, "seconds"),
            "eevee_cpu_seconds": to_eevee(name, "cpu_seconds"),
        }
        for name, own in renderers.items()
    }
    finer = (f"cpu_seconds_to_{rmse}" for rmse in FINER_RMSES)
    for measure in ("seconds", "cpu_seconds", *finer, "eevee_seconds", "eevee_cpu_seconds"):
        ours = found[VIR_AUTO][measure]
        for row in found.values():
            # infinite over infinite says nothing
            row[f"{measure}_share"] = ours / row[measure] if ours is not None and math.isfinite(ours) else None
    return list(found.values())


def plot(rows: list[Row], title: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5), layout="constrained")
    for renderer in dict.fromkeys(row["renderer"] for row in rows):
        own = [row for row in rows if row["renderer"] == renderer]
        axes.loglog([row["seconds"] for row in own], [row["rmse"] for row in own], marker="o", label=renderer)
        for row in own:
            axes.annotate(str(row["count"]), (row["seconds"], row["rmse"]), textcoords="offset points", xytext=(4, 4), fontsize=7)
    axes.axhline(ASKED_RMSE, color="gray", linewidth=0.8, linestyle=":")
    axes.set(title=title, xlabel="seconds", ylabel="RMSE of the shadow ratio")
    axes.title.set_fontsize(9)
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def run_contest(name: str, scene: bpy.types.Scene, options: Options) -> list[BenchTable]:
    resolution, reference_samples = options.pick((480, 270), (64, 36)), options.pick(1024, 32)
    contest = Contest(scene, resolution, reference_samples)
    device = open_device(options.device_name)
    try:
        contest.measure_vir(options.pick((8, 16, 32, 64, 128, 256), (8, 16)), device)
    finally:
        device.close()
    contest.measure_cycles(options.pick((1, 2, 4, 8, 16, 32, 64, 128), (1, 4)))
    contest.measure_eevee(options.pick((1, 4, 16, 64), (1, 2)))
    noise = contest.reference.noise
    title = f"{name}, light {contest.light.name!r}, {resolution[0]} x {resolution[1]}"
    plot(contest.rows, title, options.output / f"peers_{name.replace(' ', '_')}.png")
    notes = "".join(f" {note}." for note in contest.notes)
    table = BenchTable(
        title=f"Error against time: {title}",
        compared=(
            f"RMSE of the shadow ratio against Cycles with {reference_samples} samples, whose own noise is {noise:.4f}, over pixels that "
            f"receive more than {cycles.DELIVERED_FLOOR:.0%} of what the brightest receive, and over those in a penumbra; 'by light "
            "received': each pixel's error times its share of what the brightest receive, as it shows in a picture. Seconds, waited and of "
            "all processors: VIR from the open scene to the written EXR with shaders compiled, maps of 1024²; Cycles and EEVEE "
            "`render.render` of the shadowed picture into an EXR. Cycles' picture is divided by the reference's unshadowed one, which is "
            f"not counted; with '{TWO_PICTURES[2:]}', by an unshadowed one of the same samples and seed, so that most noise of what is lit "
            "cancels, and both are counted, the second with persistent data. Each point is measured once, one renderer after the other, "
            "without turns. White diffuse, no bounces, no world; Cycles on the CPU, denoised by OpenImageDenoise with albedo and normals; "
            "EEVEE with jittered shadows, 4 rays of 16 steps a sample, divided by its own unshadowed picture, not counted. Cycles and "
            f"EEVEE render one light's contribution; VIR makes a pass of it.{notes}"
        ),
        columns=(
            Column("renderer", "renderer"),
            Column("count", "views or samples"),
            Column("seconds", "seconds", "{:.2f}"),
            Column("cpu_seconds", "processors, s", "{:.2f}"),
            Column("rmse", "RMSE", "{:.4f}"),
            Column("rmse_penumbra", "in the penumbra", "{:.4f}"),
            Column("rmse_received", "by light received", "{:.4f}"),
        ),
        rows=contest.rows,
    )
    reached = BenchTable(
        title=f"Time to an RMSE of {ASKED_RMSE}, and to the best that EEVEE reaches: {title}",
        compared=(
            "Between measurements the curves are straight in logarithmic axes; 'inf' is out of reach with the samples measured. 'VIR / "
            "this' is the time of VIR with `auto` over this one's: to 0.03 at most 0.1 of Cycles', 0.2 of denoised Cycles' (of one picture "
            "or two, what is quicker), and to "
            "EEVEE's best error at most 0.05 of EEVEE's are asked. EEVEE's best is its quickest run with an error at most "
            f"{EEVEE_SLACK - 1:.0%} above its least.{notes}"
        ),
        columns=(
            Column("renderer", "renderer"),
            Column("best_rmse", "best RMSE", "{:.4f}"),
            Column("seconds", f"to {ASKED_RMSE}, s", "{:.2f}"),
            Column("seconds_share", "VIR / this", "{:.2f}"),
            Column("cpu_seconds", "processors, s", "{:.2f}"),
            Column("cpu_seconds_share", "VIR / this", "{:.2f}"),
            *finer_columns(),
            Column("eevee_seconds", "to EEVEE's best, s", "{:.2f}"),
            Column("eevee_seconds_share", "VIR / this", "{:.2f}"),
            Column("eevee_cpu_seconds", "to EEVEE's best, processors, s", "{:.2f}"),
            Column("eevee_cpu_seconds_share", "VIR / this", "{:.2f}"),
        ),
        rows=summary(contest.rows),
    )
    return [table, reached]


def finer_columns() -> list[Column]:
    pairs = (
        (
            Column(f"cpu_seconds_to_{rmse}", f"to {rmse}, processors, s", "{:.2f}"),
            Column(f"cpu_seconds_to_{rmse}_share", "VIR / this", "{:.2f}"),
        )
        for rmse in FINER_RMSES
    )
    return [column for pair in pairs for column in pair]


def head(options: Options) -> list[BenchTable]:
    return run_contest("head", build_head_scene(options.pick(MILLION_TRIANGLES_LEVEL, 2)), options)


def hall(options: Options) -> list[BenchTable]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    colonnade.build(bpy.context.scene, **options.pick({}, {"rows": 2, "columns": 3}))
    return run_contest("colonnade", bpy.context.scene, options)


def model(options: Options) -> list[BenchTable]:
    """The file of `--model`, or the furnished room."""
    if options.model is not None:
        return run_contest(options.model.name.partition(".")[0], open_model(options.model), options)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    furnished_room.build(bpy.context.scene, **options.pick({}, {"detail": 12, "tuft_count": 500}))
    return run_contest("furnished room", bpy.context.scene, options)
