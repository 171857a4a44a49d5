"""Frames with cubes of many reflectors from one cloud against drawing the cubes one by one, and what is shaded; without Blender.

A floor, bumpy balls that stand around on it, a million triangles in all, and mirror balls between them. The reference is the
same picture, rasterized cubes too, at four times the resolution. A frame is all but reading and uploading the scene, with one ray of
every pixel that shows a reflector, unless the table says otherwise.
"""

from __future__ import annotations

import contextlib
import dataclasses
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tests.scenes import matte, mirror, perspective_camera, point_light, snapshot
from vir_addon.core.material import World
from vir_addon.core.methods.reflected_points import clouds
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME, ReflectionStatistics
from vir_addon.core.passes.reflection_maps import MAP_SIZE_STEP_PX, ReflectionMaps
from vir_addon.core.plan import plan, settings_for
from vir_addon.core.reflections.reflectors import bytes_per_texel
from vir_addon.core.reflections.work import ReflectionWork
from vir_addon.core.render import Renderer, render
from vir_addon.core.scene import FilterShape, PixelFilter, SceneSnapshot
from vir_addon.core.settings import (
    POISSON_SAMPLES,
    Effect,
    ReflectionFilter,
    ReflectionLookUp,
    ReflectionMethod,
    ReflectionWords,
    Settings,
)
from vir_addon.device.interface import Device
from vir_addon.device.open import open_device

from .bumpy_sphere import bumpy_sphere
from .options import Options
from .tables import BenchTable, Column
from .timing import median_ratio, take_turns

PUBLISHED, SMALL, DEFERRED = "mvr", "mvr, cubes as small", "mvr, these deferred"
"""cubes drawn one by one: shaded whole, mip-mapped and all of one size as in the paper; the same as wide as reflectors are in the picture,
which ivir's and epr's are; and shaded where rays end"""
PACKED, WIDE = "ivir, 13 + 19 bits", "ivir, 32 + 32 bits"
"""ivir as published: points are shaded, and cubes mip-mapped and looked up by direction; with words of depth and colour, and of each"""
FILTERED, FILTERED_FINE = "epr, 25 samples", "epr, 25 samples, 4 places of a pixel"
"""as published: filtered by 25 samples, for which what they need is shaded once, half a place for an eye's pixel (the paper's best choice);
and more places"""
REFERENCE_FACTOR = 4
MIB = 1 << 20
TARGET_BYTES = 12
"""a texel of what the rasterizer draws a map into"""
MUST_SPEEDUP, MUST_SHADING, MUST_COUNT = 4.0, 30.0, 20
"""and at how many reflectors"""
PUBLISHED_CUBE_SHARE = 512 / 1920
"""of the picture's width, that cubes of the published baseline have whatever their reflectors' size (Gavane & Watson 2022 b, table 1:
1.12 to 1.58 million shaded texels a reflector, of 6 * 512 * 512)"""
LAZILY, FOLLOWED, ADAPTIVELY = "shaded once", "followed, fixed", "followed, adaptive"
"""how samples of epr are shaded"""
MAPS, SHADES = "reflection maps", ("reflect", "light reflections", "resolve")
"""stages of a frame"""


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
    # the reference is a mean over whole pixels, so rays are spread over them, too
    whole_pixels = PixelFilter(FilterShape.BOX, 1.0)
    size = width_px, height_px
    return snapshot(
        meshes, [light], camera, *size, transforms=np.array(transforms), materials=materials, world=world, pixel_filter=whole_pixels
    )


def settings_with(method: ReflectionMethod, sample_count: int = 1, **choices: Any) -> Settings:
    return Settings(
        effects=(Effect.REFLECTION,),
        reflection_method=method,
        reflection_sample_count=sample_count,
        view_count=1,
        bounces=1,
        **choices,
    )


def compared_settings(width_px: int) -> dict[str, Settings]:
    """What makes cubes, the baseline first."""
    cube_px = max(round(PUBLISHED_CUBE_SHARE * width_px / MAP_SIZE_STEP_PX), 1) * MAP_SIZE_STEP_PX
    # cubes as large as asked, however much memory what is kept of each texel takes
    shaded = settings_with(ReflectionMethod.MVR, reflection_look_up=ReflectionLookUp.SHADED, reflection_map_mib=4096)
    deferred = {name: settings_with(ReflectionMethod(name)) for name in ("ivir", "epr")}
    deferred = {DEFERRED: settings_with(ReflectionMethod.MVR), **deferred}
    points = dataclasses.replace(shaded, reflection_method=ReflectionMethod.IVIR)
    words = {PACKED: ReflectionWords.PACKED, WIDE: ReflectionWords.WIDE}
    published = {name: dataclasses.replace(points, reflection_words=each) for name, each in words.items()}
    filtered = {FILTERED: filtered_settings(), FILTERED_FINE: filtered_settings(points_per_eye_pixel=4.0)}
    return {PUBLISHED: dataclasses.replace(shaded, reflection_cube_px=cube_px), SMALL: shaded, **published, **deferred, **filtered}


def filtered_settings(sample_count: int = POISSON_SAMPLES, **choices: Any) -> Settings:
    """epr as published"""
    lazy = {"reflection_look_up": ReflectionLookUp.LAZY, "reflection_filter": ReflectionFilter.POISSON, "reflection_map_mib": 4096}
    return settings_with(ReflectionMethod.EPR, sample_count, **lazy, **choices)


class StageClock:
    """Processors' time of every stage; to be called as the renderer's `on_stage`. Before the first there is none."""

    def __init__(self) -> None:
        self.cpu_ms: dict[str, float] = {}
        self._current, self._since_s = "", 0.0

    def __call__(self, stage: str, light_name: str | None = None) -> None:
        now_s = time.process_time()
        self.cpu_ms[self._current] = self.cpu_ms.get(self._current, 0.0) + (now_s - self._since_s) * 1e3
        self._current, self._since_s = stage, now_s


class Frames:
    """The same frame again and again, of a scene that is on the device."""

    def __init__(self, scene: SceneSnapshot, settings: Settings, device: Device) -> None:
        self.scene, self.settings, self.device = scene, settings, device
        self.plan = plan(scene, settings_for(device, settings))
        self.first = Renderer(scene, self.plan, device)
        """has the scene, and has compiled"""
        device.run(self.first.prepare)
        self.passes, self.found = self._finish(self.first)
        device.run(self.first.update_errors)  # counts rays of pixels, too

    def _finish(self, renderer: Renderer) -> tuple[dict[str, np.ndarray], ReflectionStatistics]:
        for batch in range(self.plan.batch_count):
            self.device.run(renderer.render_batch, batch)
        found = renderer.statistics.reflections
        if found is None or not found.map_count:
            raise RuntimeError("nothing reflects")
        return renderer.read_passes(), found

    def run(self) -> dict[str, float]:
        """Milliseconds of the whole, of its maps and of what comes after them, waited and of all processors."""
        clock = StageClock()
        self.device.finish()
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        with contextlib.closing(Renderer(self.scene, self.plan, self.device, clock, self.first)) as renderer:
            self.device.run(renderer.prepare)
            self._finish(renderer)
            total_s, total_cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
            clock("")
            return {
                "total_ms": total_s * 1e3,
                "total_cpu_ms": total_cpu_s * 1e3,
                "maps_ms": renderer.stopwatch.shared_ms[MAPS],
                "maps_cpu_ms": clock.cpu_ms[MAPS],
                "shading_cpu_ms": sum(clock.cpu_ms.get(stage, 0.0) for stage in SHADES),
            }

    def sizes(self) -> dict[str, float]:
        """Of the maps as they are made: samples of clouds, memory, texels."""
        work = self.first.reflections
        assert work is not None
        return self.device.run(self._sizes, work)

    def _sizes(self, work: ReflectionWork) -> dict[str, float]:
        maps = ReflectionMaps(work.scene_data, self.plan.bounds, work.planned.maps, *work.planned.other_maps())
        try:
            return self._sizes_of(maps, work)
        finally:
            maps.release()

    def _sizes_of(self, maps: ReflectionMaps, work: ReflectionWork) -> dict[str, float]:
        for _ in maps.drawing():
            pass
        used = clouds(maps, work.planned.reflectors, self.plan.bounds, self.plan.settings)
        for cloud in used:
            for _ in cloud.drawing():
                pass
            cloud.release()
        drawn = maps.maps
        held_bytes = sum(cloud.most_bytes for cloud in used)
        held_bytes += 0 if work.shaded_points is None else work.shaded_points.byte_count
        held_bytes = held_bytes or TARGET_BYTES * max(each.face_count * each.width_px * each.height_px for each in drawn)
        kept_bytes = bytes_per_texel(self.plan.settings) * sum(each.texel_count for each in drawn)
        if self.plan.settings.reflection_look_up is ReflectionLookUp.LAZY:
            kept_bytes = self.found.map_bytes
        return {
            "samples": sum(cloud.triangle_count + cloud.point_count for cloud in used),
            "memory_mib": (held_bytes + kept_bytes) / MIB,
            "cube_px": statistics.mean(each.width_px for each in drawn),
            "texels": sum(each.face_count * each.width_px * each.height_px for each in drawn),
            "surface_texels": self._surface_texel_count(maps),
        }

    def _surface_texel_count(self, maps: ReflectionMaps) -> int:
        """Of the finest levels, those that see a surface: what a renderer that shades its maps shades."""
        instances = self.device.read(maps.texels).reshape(-1, 4)[:, 2]
        first, count = 0, 0
        for each in maps.maps:
            finest = each.face_count * each.width_px * each.height_px
            count += int((instances[first : first + finest] >= 0).sum())
            first += each.texel_count
        return count

    def close(self) -> None:
        self.first.close()


def reference_of(
    reflector_count: int,
    triangle_count: int,
    width_px: int,
    device: Device,
    look_up: ReflectionLookUp = ReflectionLookUp.MARCH,
    **where: float,
) -> np.ndarray:
    """(height, width, 3) what `mvr` makes of it at REFERENCE_FACTOR times the resolution, brought down."""
    fine = scene_of(reflector_count, triangle_count, REFERENCE_FACTOR * width_px, **where)
    settings = settings_with(ReflectionMethod.MVR, sample_count=2, reflection_map_mib=4096, reflection_look_up=look_up)
    *_, progress = render(fine, plan(fine, settings_for(device, settings)), device)
    passes = progress.passes
    image = np.clip(passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME], 0, 1)
    height, width = image.shape[0] // REFERENCE_FACTOR, image.shape[1] // REFERENCE_FACTOR
    return image.reshape(height, REFERENCE_FACTOR, width, REFERENCE_FACTOR, 3).mean(axis=(1, 3))


def error_of(passes: dict[str, np.ndarray], reference: np.ndarray) -> float:
    """RMSE over pixels that show nothing but reflectors, values up to 1."""
    shown = (passes[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1)
    image = np.clip(passes[REFLECTION_PASS_NAME] * passes[REFLECTION_COLOR_PASS_NAME], 0, 1)
    return float(np.sqrt(((image - reference)[shown] ** 2).mean()))


def measured(
    frames: dict[str, Frames], rounds: int, reference: np.ndarray, by_direction: np.ndarray | None = None
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Of each, the medians of rounds in which all take turns, and the error; also from what is looked up by direction."""
    results = take_turns({name: each.run for name, each in frames.items()}, rounds)
    for name, own in results.items():
        medians = {key: statistics.median(each[key] for each in own) for key in own[0]}
        each = frames[name]
        counts = {"ray_count": each.found.ray_count, "shaded": each.found.shaded_count}
        found = {**medians, **each.sizes(), **counts, "by_direction": each.found.by_direction_share}
        errors = {"rmse": error_of(each.passes, reference)}
        if by_direction is not None:
            errors["rmse_by_direction"] = error_of(each.passes, by_direction)
        yield name, {**found, **errors, "rounds": own}


def measure(reflector_count: int, triangle_count: int, width_px: int, rounds: int, device: Device) -> list[dict[str, Any]]:
    """All methods. What `mvr` shades, texels of its own cubes that see a surface, is compared with what each shades."""
    scene = scene_of(reflector_count, triangle_count, width_px)
    reference, by_direction = (
        reference_of(reflector_count, triangle_count, width_px, device, each)
        for each in (ReflectionLookUp.MARCH, ReflectionLookUp.DIRECTION)
    )
    with contextlib.ExitStack() as stack:
        frames = {name: Frames(scene, settings, device) for name, settings in compared_settings(width_px).items()}
        for each in frames.values():
            stack.callback(each.close)
        rows = [
            {"reflectors": reflector_count, "method": name, **found} for name, found in measured(frames, rounds, reference, by_direction)
        ]
    baseline, small, *_ = rows
    for row in rows:
        for key in ("total_ms", "total_cpu_ms", "maps_cpu_ms"):
            row[f"{key}_ratio"] = median_ratio([each[key] for each in baseline["rounds"]], [each[key] for each in row["rounds"]])
        row["shading_ratio"] = baseline["shaded"] / max(row["shaded"], 1)
        row["small_ratio"] = small["shaded"] / max(row["shaded"], 1)
    return rows


def sweep(options: Options, device: Device) -> Iterator[dict[str, Any]]:
    """epr with other numbers of points of the eye's pixel and of rays of each, from farther and nearer."""
    reflector_count, triangle_count, width_px = options.pick((20, 1_000_000, 320), (2, 20_000, 64))
    shares = options.pick((1 / 64, 1 / 16, 1 / 4, 1 / 2, 1.0), (0.25, 1.0))
    choices = [(share, count) for count in options.pick((1, 4), (1, 2)) for share in shares]
    for distance_m in options.pick((12.0, 7.5, 5.0), (7.5,)):
        scene = scene_of(reflector_count, triangle_count, width_px, distance_m)
        reference = reference_of(reflector_count, triangle_count, width_px, device, distance_m=distance_m)
        with contextlib.ExitStack() as stack:
            frames = {}
            for share, count in choices:
                settings = settings_with(ReflectionMethod.EPR, count, points_per_eye_pixel=share)
                each = frames[f"{share} {count}"] = Frames(scene, settings, device)
                stack.callback(each.close)
            found = dict(measured(frames, options.round_count(full=3, quick=1), reference))
        for share, count in choices:
            yield {"share": share, "rays": count, "distance_m": distance_m, **found[f"{share} {count}"]}


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained", sharex=True)
    for distance_m, count in dict.fromkeys((row["distance_m"], row["rays"]) for row in rows):
        own = [row for row in rows if (row["distance_m"], row["rays"]) == (distance_m, count)]
        shares = [row["share"] for row in own]
        label = f"eye {distance_m:g} m away, {count} {'ray' if count == 1 else 'rays'}"
        panels[0].plot(shares, [row["rmse"] for row in own], marker="o", label=label)
        panels[1].plot(shares, [row["samples"] for row in own], marker="o", label=label)
    for axes, text in zip(panels, ("RMSE", "samples in the cloud"), strict=True):
        axes.set(xlabel="epr's points of an eye's pixel (rho_scale)", ylabel=text)
        axes.set_xscale("log", base=2)
        axes.set_ylim(bottom=0.0)
        axes.grid(which="both", alpha=0.3)
    panels[0].legend(fontsize=8)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def sampled(options: Options, device: Device) -> Iterator[dict[str, Any]]:
    """epr as published, by places of the eye's pixel and by samples of the filter, and with rays that are followed, as many and adaptively;
    from farther and nearer."""
    reflector_count, triangle_count, width_px = options.pick((MUST_COUNT, 1_000_000, 480), (2, 20_000, 64))
    counts = options.pick((1, 4, 9, 16, POISSON_SAMPLES), (1, 8))
    shares = options.pick((1 / 4, 1 / 2, 1.0), (1 / 2,))
    choices: dict[tuple[float, int, str], Settings] = {}
    for share, count in [*((share, counts[-1]) for share in shares), *((1 / 2, count) for count in counts[:-1])]:
        choices[share, count, LAZILY] = filtered_settings(count, points_per_eye_pixel=share)
    for name, kind in ((FOLLOWED, ReflectionFilter.POISSON), (ADAPTIVELY, ReflectionFilter.ADAPTIVE)):
        choices[1 / 2, counts[-1], name] = settings_with(ReflectionMethod.EPR, counts[-1], reflection_filter=kind)
    for distance_m in options.pick((12.0, 7.5, 5.0), (7.5,)):
        scene = scene_of(reflector_count, triangle_count, width_px, distance_m)
        size = reflector_count, triangle_count, width_px, device
        references = [reference_of(*size, each, distance_m=distance_m) for each in (ReflectionLookUp.MARCH, ReflectionLookUp.DIRECTION)]
        with contextlib.ExitStack() as stack:
            frames = {}
            for choice, settings in choices.items():
                each = frames[str(choice)] = Frames(scene, settings, device)
                stack.callback(each.close)
            found = dict(measured(frames, options.round_count(full=3, quick=1), *references))
        for choice in choices:
            share, count, kind = choice
            row = found[str(choice)]
            own = row["rmse_by_direction" if kind == LAZILY else "rmse"]
            followed = frames[str(choice)].found.rays_per_pixel
            yield {"share": share, "count": count, "kind": kind, "followed": followed, "distance_m": distance_m, **row, "own_rmse": own}


def plot_sampled(rows: list[dict[str, Any]], path: Path) -> None:
    """Error against time, as figure 6 of the paper has it: curves are of one choice from three distances, or of one distance."""
    import matplotlib

    matplotlib.use("Agg")  # no display
    from matplotlib import pyplot

    most = max(row["count"] for row in rows)
    figure, panels = pyplot.subplots(1, 2, figsize=(11, 4.5), layout="constrained", sharey=True)
    for share, kind in dict.fromkeys((row["share"], row["kind"]) for row in rows if row["count"] == most):
        own = [row for row in rows if (row["share"], row["kind"], row["count"]) == (share, kind, most)]
        label = f"rho_scale {share:g}, {kind}"
        panels[0].plot([row["total_cpu_ms"] for row in own], [row["own_rmse"] for row in own], marker="o", label=label)
    for distance_m in dict.fromkeys(row["distance_m"] for row in rows):
        own = [row for row in rows if (row["distance_m"], row["kind"], row["share"]) == (distance_m, LAZILY, 0.5)]
        own.sort(key=lambda row: row["count"])
        label = f"eye {distance_m:g} m away"
        panels[1].plot([row["total_cpu_ms"] for row in own], [row["own_rmse"] for row in own], marker="o", label=label)
        for row in own:
            panels[1].annotate(str(row["count"]), (row["total_cpu_ms"], row["own_rmse"]), fontsize=7)
    panels[0].set_title(f"{most} samples, eye nearer and nearer", fontsize=10)
    panels[1].set_title("rho_scale 0.5, shaded once, by samples of a pixel", fontsize=10)
    panels[0].set_xscale("log")
    for axes in panels:
        axes.set(xlabel="a frame, ms of all processors", ylabel="RMSE")
        axes.set_ylim(bottom=0.0)
        axes.grid(which="both", alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def sampling(options: Options) -> Iterator[list[BenchTable]]:
    rows: list[dict[str, Any]] = []
    device = open_device(options.device_name)
    try:
        for row in sampled(options, device):
            rows.append(row)
            yield [table_of_samples(rows)]
    finally:
        device.close()
    plot_sampled(rows, options.output / "reflections_sampling.png")


def table_of_samples(rows: list[dict[str, Any]]) -> BenchTable:
    return BenchTable(
        title="epr as published by points of the eye's pixel (rho_scale) and samples of its filter",
        compared=(
            "The scene of reflections, with the eye nearer and farther; medians; RMSE of values up to 1 against mvr at "
            f"{REFERENCE_FACTOR} times the resolution, with rays followed as these are, or looked up by direction as '{LAZILY}'. Plotted "
            "in reflections_sampling.png."
        ),
        columns=(
            Column("distance_m", "eye, m away", "{:g}"),
            Column("share", "points of a pixel", "{:g}"),
            Column("kind", "samples are"),
            Column("count", "samples"),
            Column("followed", "followed", "{:.1f}"),
            Column("samples", "samples in the cloud", "{:,.0f}"),
            Column("shaded", "shaded", "{:,}"),
            Column("total_ms", "frame, ms", "{:.0f}"),
            Column("total_cpu_ms", "processors, ms", "{:.0f}"),
            Column("own_rmse", "RMSE", "{:.4f}"),
        ),
        rows=rows,
    )


def run(options: Options) -> Iterator[list[BenchTable]]:
    triangle_count, width_px = options.pick((1_000_000, 480), (20_000, 64))
    rows: list[dict[str, Any]] = []
    swept: list[dict[str, Any]] = []
    device = open_device(options.device_name)
    try:
        # what is asked comes first
        for reflector_count in options.pick((MUST_COUNT, 1, 10, 50), (2, 1)):
            rows += measure(reflector_count, triangle_count, width_px, options.round_count(full=5, quick=1), device)
            rows.sort(key=lambda row: row["reflectors"])
            yield tables(rows, swept, triangle_count, width_px)
        for row in sweep(options, device):
            swept.append(row)
            yield tables(rows, swept, triangle_count, width_px)
    finally:
        device.close()
    plot(swept, options.output / "reflections_density.png")


def tables(rows: list[dict[str, Any]], swept: list[dict[str, Any]], triangle_count: int, width_px: int) -> list[BenchTable]:
    shared = (
        Column("cube_px", "texels wide", "{:.0f}"),
        Column("samples", "samples", "{:,.0f}"),
        Column("total_ms", "frame, ms", "{:.0f}"),
        Column("total_cpu_ms", "processors, ms", "{:.0f}"),
        Column("maps_cpu_ms", "its maps", "{:.0f}"),
    )
    return [
        BenchTable(
            title=f"Frames with reflectors among {triangle_count:,} triangles, {width_px} x {round(width_px * 9 / 16)}",
            compared=(
                f"Medians. At {MUST_COUNT} reflectors epr must be {MUST_SPEEDUP:g} times as fast as mvr, and shade no more than a "
                f"{MUST_SHADING:g}th of what that does. It is what the paper compares with: cubes shaded whole, mip-mapped, looked up by "
                f"direction, and {PUBLISHED_CUBE_SHARE * width_px:.0f} wide whatever their reflectors' size, as much in proportion to the "
                f"picture. '{SMALL}' has cubes as wide as its reflectors are in the picture, as the others; '{DEFERRED}' follows rays as "
                "these do. Shaded: surfaces in an eye sample's frame, texels of cubes that see one or what rays meet. RMSE "
                f"against mvr at {REFERENCE_FACTOR} times the resolution with rays followed, on pixels of reflectors, up to 1: "
                "parallax is in it where cubes are looked up by direction; 'by direction': against the same mvr looked up by direction. "
                f"'{PACKED}' and '{WIDE}': points that are shaded and splatted as published, shaded texels and points counted. All of "
                f"these with one ray of a pixel. '{FILTERED}' is epr as published, looked up by direction and filtered, what is needed "
                f"shaded once, and '{FILTERED_FINE}' with finer shading. MiB count all that shaded cubes keep."
            ),
            columns=(
                Column("reflectors", "reflectors"),
                Column("method", "method"),
                *shared,
                Column("total_ms_ratio", "mvr / this", "{:.2f}"),
                Column("total_cpu_ms_ratio", "processors", "{:.2f}"),
                Column("maps_cpu_ms_ratio", "its maps", "{:.2f}"),
                Column("texels", "texels of cubes", "{:,.0f}"),
                Column("surface_texels", "with a surface", "{:,.0f}"),
                Column("ray_count", "rays", "{:,}"),
                Column("shaded", "shaded", "{:,}"),
                Column("shading_ratio", "mvr's / shaded", "{:.1f}"),
                Column("small_ratio", "of cubes as small", "{:.1f}"),
                Column("memory_mib", "MiB", "{:.0f}"),
                Column("by_direction", "hidden from cubes", "{:.1%}"),
                Column("rmse", "RMSE", "{:.4f}"),
                Column("rmse_by_direction", "by direction", "{:.4f}"),
            ),
            rows=rows,
        ),
        BenchTable(
            title=f"epr by its points of the eye's pixel (rho_scale) and rays of a pixel, {MUST_COUNT} reflectors",
            compared="The same scene with the eye nearer and farther; plotted in reflections_density.png.",
            columns=(
                Column("distance_m", "eye, m away", "{:g}"),
                Column("share", "points of a pixel", "{:g}"),
                Column("rays", "rays of a pixel"),
                *shared,
                Column("rmse", "RMSE", "{:.4f}"),
            ),
            rows=swept,
        ),
    ]
