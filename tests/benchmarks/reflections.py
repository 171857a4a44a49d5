"""Maps of many reflectors from one cloud against drawing them one by one, and what is shaded of them; without Blender.

A floor, bumpy balls that stand around on it, a million triangles in all, and mirror balls between them. The reference is the
same picture, rasterized cubes too, at four times the resolution.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.scenes import matte, mirror, perspective_camera, point_light, snapshot
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.material import World
from vir_addon.core.methods.reflected_points import clouds
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME, ReflectionStatistics
from vir_addon.core.passes.reflection_maps import BYTES_PER_TEXEL, ReflectionMaps
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.plan import plan, settings_for
from vir_addon.core.reflectors import PlannedReflections
from vir_addon.core.render import render
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Effect, ReflectionMethod, Settings
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import bumpy_sphere
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio, take_turns

METHODS = (ReflectionMethod.MVR, ReflectionMethod.IVIR, ReflectionMethod.EPR)
REFERENCE_FACTOR = 4
MIB = 1 << 20
TARGET_BYTES = 12
"""a texel of what the rasterizer draws a map into"""
MUST_SPEEDUP, MUST_SHADING = 4.0, 30.0


def scene_of(reflector_count: int, triangle_count: int, width_px: int, distance_m: float = 7.5) -> SceneSnapshot:
    """The nearest to so many triangles in 100 balls; reflectors in their midst, on a spiral that leaves room between them."""
    height_px = round(width_px * 9 / 16)
    detailed, plain = bumpy_sphere(triangle_count // 100), bumpy_sphere(2000)
    directions = plain.positions_os / np.linalg.norm(plain.positions_os, axis=1, keepdims=True)
    plain = dataclasses.replace(plain, positions_os=directions)
    corners = np.array([[-30, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]], np.float32)
    floor = dataclasses.replace(plain, name="floor", positions_os=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    floor = dataclasses.replace(floor, point_normals_os=None, is_closed=False)
    meshes, transforms = [floor], [np.eye(4)]
    for k in range(100 + reflector_count):
        is_reflector = k >= 100
        number = k - 100 if is_reflector else k
        angle = 2.39996 * number
        away_m = 0.62 * np.sqrt(number + 0.5) if is_reflector else 5.5 + 0.03 * number
        radius_m = 0.3 if is_reflector else 0.45
        matrix = np.diag([radius_m, radius_m, radius_m, 1.0])
        height_m = 0.35 + 0.3 * (number % 5) if is_reflector else radius_m * (1.2 + number % 3)
        matrix[:3, 3] = away_m * np.cos(angle), away_m * np.sin(angle), height_m
        meshes.append(dataclasses.replace(plain if is_reflector else detailed, name=f"{'mirror' if is_reflector else 'ball'} {number}"))
        transforms.append(matrix)
    hues = np.random.default_rng(7).uniform(0.1, 0.9, (100, 3))
    materials = [matte((0.5, 0.5, 0.5)), *(matte(hue, 0.2 * hue) for hue in hues), *[mirror()] * reflector_count]
    camera = perspective_camera((0.5, -distance_m, 0.55 * distance_m), (0, 0, 0.6), width_px, height_px, 0.35)
    light = point_light(eye=(0, -2, 8), radius_m=0.0, strength=400.0)
    world = World((0.3, 0.35, 0.4))
    return snapshot(meshes, [light], camera, width_px, height_px, transforms=np.array(transforms), materials=materials, world=world)


def settings_with(method: ReflectionMethod, **choices: Any) -> Settings:
    return Settings(effects=(Effect.REFLECTION,), reflection_method=method, reflection_sample_count=2, view_count=1, bounces=1, **choices)


def render_once(scene: SceneSnapshot, settings: Settings, device: Device) -> tuple[dict[str, np.ndarray], ReflectionStatistics]:
    for progress in render(scene, plan(scene, settings_for(device, settings)), device):
        found = progress.statistics.reflections
        if progress.batches_done == progress.batches_total and found is not None and found.map_count:
            return progress.passes, found
    raise RuntimeError("nothing reflects")


class Drawing:
    """Maps of a scene, again and again."""

    def __init__(self, scene: SceneSnapshot, scene_data: SceneData, settings: Settings) -> None:
        self.scene, self.scene_data, self.settings = scene, scene_data, settings
        planned = plan(scene, settings).reflections
        assert planned is not None
        self.planned: PlannedReflections = planned
        self.bounds = compute_bounds(scene)

    def run(self) -> dict[str, float]:
        device = self.scene_data.device
        device.finish()
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        found = device.run(self._run)
        device.finish()
        return {**found, "maps_ms": (time.perf_counter() - start_s) * 1e3, "cpu_ms": (time.process_time() - start_cpu_s) * 1e3}

    def _run(self) -> dict[str, float]:
        maps = ReflectionMaps(self.scene_data, self.bounds, self.planned.maps)
        for _ in maps.drawing():
            pass
        used = clouds(maps, self.planned.reflectors, self.bounds, self.settings)
        for cloud in used:
            for _ in cloud.drawing():
                pass
        drawn_texels = max(each.face_count * each.width_px * each.height_px for each in self.planned.maps)
        held_bytes = sum(cloud.most_bytes for cloud in used) or TARGET_BYTES * drawn_texels
        self.scene_data.device.finish()
        maps.release()
        return {
            "samples": sum(cloud.triangle_count + cloud.point_count for cloud in used),
            "memory_mib": (held_bytes + BYTES_PER_TEXEL * sum(each.texel_count for each in self.planned.maps)) / MIB,
            "cubes": len(self.planned.maps),
            "cube_px": statistics.mean(each.width_px for each in self.planned.maps),
            "texels": sum(each.face_count * each.width_px * each.height_px for each in self.planned.maps),
        }


def reference_of(reflector_count: int, triangle_count: int, width_px: int, device: Device, **where: float) -> np.ndarray:
    """(height, width, 3) what `mvr` makes of it at REFERENCE_FACTOR times the resolution, brought down."""
    fine = scene_of(reflector_count, triangle_count, REFERENCE_FACTOR * width_px, **where)
    passes, _ = render_once(fine, settings_with(ReflectionMethod.MVR, reflection_map_mib=4096), device)
    image = np.clip(passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME], 0, 1)
    height, width = image.shape[0] // REFERENCE_FACTOR, image.shape[1] // REFERENCE_FACTOR
    return image.reshape(height, REFERENCE_FACTOR, width, REFERENCE_FACTOR, 3).mean(axis=(1, 3))


def error_of(passes: dict[str, np.ndarray], reference: np.ndarray) -> float:
    """RMSE over pixels that show nothing but reflectors, values up to 1."""
    shown = (passes[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1)
    image = np.clip(passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME], 0, 1)
    return float(np.sqrt(((image - reference)[shown] ** 2).mean()))


def measure(reflector_count: int, triangle_count: int, width_px: int, rounds: int, device: Device) -> list[dict[str, Any]]:
    scene = scene_of(reflector_count, triangle_count, width_px)
    reference = reference_of(reflector_count, triangle_count, width_px, device)
    pictures = {method: render_once(scene, settings_with(method), device) for method in METHODS}
    scene_data = SceneData(scene, device)
    drawings = {method.value: Drawing(scene, scene_data, settings_with(method)) for method in METHODS}
    results = take_turns({name: drawing.run for name, drawing in drawings.items()}, rounds)
    scene_data.release()
    baseline = results[ReflectionMethod.MVR.value]
    rows = []
    for method in METHODS:
        own = results[method.value]
        medians = {key: statistics.median(each[key] for each in own) for key in own[0]}
        passes, found = pictures[method]
        rows.append(
            {
                "reflectors": reflector_count,
                "method": method.value,
                **medians,
                **{
                    f"{key}_ratio": median_ratio([each[key] for each in baseline], [each[key] for each in own])
                    for key in ("maps_ms", "cpu_ms")
                },
                "shaded": found.ray_count,
                "shading_ratio": medians["texels"] / max(found.ray_count, 1),
                "by_direction": found.by_direction_share,
                "rmse": error_of(passes, reference),
                "rounds": own,
            }
        )
    return rows


def sweep(options: Options, device: Device) -> list[dict[str, Any]]:
    """epr with other numbers of points of the eye's pixel, from farther and nearer."""
    reflector_count, triangle_count, width_px = options.pick((20, 1_000_000, 320), (2, 20_000, 64))
    rows = []
    for distance_m in options.pick((12.0, 7.5, 5.0), (7.5,)):
        scene = scene_of(reflector_count, triangle_count, width_px, distance_m)
        reference = reference_of(reflector_count, triangle_count, width_px, device, distance_m=distance_m)
        scene_data = SceneData(scene, device)
        choices = {share: settings_with(ReflectionMethod.EPR, points_per_eye_pixel=share) for share in (0.25, 0.5, 1.0)}
        errors = {share: error_of(render_once(scene, settings, device)[0], reference) for share, settings in choices.items()}
        jobs = {str(share): Drawing(scene, scene_data, settings).run for share, settings in choices.items()}
        for share, own in take_turns(jobs, options.round_count(full=5, quick=1)).items():
            medians = {key: statistics.median(each[key] for each in own) for key in own[0]}
            rows.append({"share": float(share), **medians, "rmse": errors[float(share)]})
        scene_data.release()
    return rows


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for share in dict.fromkeys(row["share"] for row in rows):
        own = [row for row in rows if row["share"] == share]
        axes.plot([row["cpu_ms"] for row in own], [row["rmse"] for row in own], marker="o", label=f"{share:g} points an eye's pixel")
        for row in own:
            axes.annotate(f"{row['cube_px']:.0f} px", (row["cpu_ms"], row["rmse"]), fontsize=7)
    axes.set(title="epr: time and error by its density, cubes of several sizes", xlabel="processors, ms", ylabel="RMSE")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def run(options: Options) -> list[BenchTable]:
    triangle_count, width_px = options.pick((1_000_000, 320), (20_000, 64))
    device = open_device(options.device_name)
    try:
        rows = []
        for reflector_count in options.pick((1, 10, 20, 50), (1, 2)):
            rows += measure(reflector_count, triangle_count, width_px, options.round_count(full=5, quick=1), device)
        swept = sweep(options, device)
    finally:
        device.close()
    plot(swept, options.output / "reflections_density.png")
    shared = (
        Column("cube_px", "texels wide", "{:.0f}"),
        Column("samples", "samples", "{:,.0f}"),
        Column("maps_ms", "maps, ms", "{:.0f}"),
        Column("cpu_ms", "processors, ms", "{:.0f}"),
    )
    return [
        BenchTable(
            title=f"Cubes of reflectors among {triangle_count:,} triangles, {width_px} x {round(width_px * 9 / 16)}",
            compared=(
                f"Medians. At 20 reflectors epr must be {MUST_SPEEDUP:g} times as fast as mvr, and shade no more than a "
                f"{MUST_SHADING:g}th of the cubes' texels, all of which mvr as published shades. Shaded: rays of an eye sample, whatever "
                f"the method: all defer it. RMSE against mvr at {REFERENCE_FACTOR} times the resolution, on pixels of reflectors, up to 1."
            ),
            columns=(
                Column("reflectors", "reflectors"),
                Column("method", "method"),
                *shared,
                Column("maps_ms_ratio", "mvr / this", "{:.2f}"),
                Column("cpu_ms_ratio", "processors", "{:.2f}"),
                Column("texels", "texels of cubes", "{:,.0f}"),
                Column("shaded", "shaded", "{:,}"),
                Column("shading_ratio", "texels / shaded", "{:.1f}"),
                Column("memory_mib", "MiB", "{:.0f}"),
                Column("by_direction", "hidden from cubes", "{:.1%}"),
                Column("rmse", "RMSE", "{:.4f}"),
            ),
            rows=rows,
        ),
        BenchTable(
            title="epr by its points of the eye's pixel (rho_scale)",
            compared="The same scene with the eye nearer and farther; plotted in reflections_density.png.",
            columns=(Column("share", "points of a pixel", "{:g}"), *shared, Column("rmse", "RMSE", "{:.4f}")),
            rows=swept,
        ),
    ]
