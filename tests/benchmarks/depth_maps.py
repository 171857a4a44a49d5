"""Depth maps alone: rasterizing the surface for every view against making points once and replaying them."""

from __future__ import annotations

import itertools
import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np

from vir_addon.core.bounds import compute_bounds, cullable_instances
from vir_addon.core.fit import FittedFace, fit_light, light_hull, select_receivers
from vir_addon.core.methods import depth_map_method
from vir_addon.core.methods.base import DepthMapMethod, FaceJob
from vir_addon.core.methods.shared import SharedByFaces
from vir_addon.core.passes.eye import EyePass
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.passes.shadow_maps import MAX_BATCH_VIEWS, DepthMaps, face_table
from vir_addon.core.plan import PlannedPass
from vir_addon.core.sampling import light_samples
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Settings
from vir_addon.device.interface import EMPTY_DEPTH_BITS, Device
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .options import Options
from .tables import BenchTable, Column
from .timing import device_ms, median_ratio, round_ratios, take_turns

BASELINE = "mvr"
VIEWS_PER_THREAD = {"serial": 1, "partially parallel": 4, "fully parallel": MAX_BATCH_VIEWS}

COLUMNS = (
    Column("variant", "method"),
    Column("prepared", "points or triangles", "{:,}"),
    Column("kept", "replayed", "{:,}"),
    Column("culled", "triangles culled", "{:,}"),
    Column("missed_share", "texels missed", "{:.3%}"),
    Column("points_ms", "prepared, ms", "{:.0f}"),
    Column("view_ms", "a view, ms", "{:.1f}"),
    Column("total_ms", "all, ms", "{:.0f}"),
    Column("speedup", "mvr / this", "{:.2f}"),
)


@dataclass(frozen=True)
class Variant:
    name: str
    planned: PlannedPass
    settings: Settings


@dataclass(frozen=True)
class Timing:
    points_ms: float
    maps_ms: float

    @property
    def total_ms(self) -> float:
        return self.points_ms + self.maps_ms


def variants(view_count: int, resolution_px: int) -> list[Variant]:
    def variant(name: str, method: Method, points: PointStorage | None = None, **choices: Any) -> Variant:
        settings = Settings(method, view_count=view_count, map_resolution_px=resolution_px, **choices)
        planned = PlannedPass("", "", True, "", method, points, view_count, resolution_px, settings.point_generation)
        return Variant(name, planned, settings)

    found = [variant(BASELINE, Method.MVR), variant("micro", Method.MICRO), variant("hybrid", Method.HYBRID, PointStorage.BUFFERED)]
    found += [variant("vir, watertight", Method.VIR, PointStorage.BUFFERED)]
    found += [variant("vir, published", Method.VIR, PointStorage.BUFFERED, watertight=False)]
    for points, (parallelism, views_per_thread) in itertools.product(PointStorage, VIEWS_PER_THREAD.items()):
        found.append(
            variant(f"vwss {points.value}, {parallelism}", Method.VWSS, points, watertight=False, views_per_thread=views_per_thread)
        )
    found.append(variant("vwss buffered, watertight, back faces", Method.VWSS, PointStorage.BUFFERED, back_faces=True))
    for points, is_watertight, is_culled in itertools.product(PointStorage, (True, False), (True, False)):
        density, culling = "watertight" if is_watertight else "published", "culling" if is_culled else "no culling"
        name = f"ivir {points.value}, {density}, {culling}"
        found.append(variant(name, Method.IVIR, points, watertight=is_watertight, stochastic_culling=is_culled))
    found.append(variant("ivir buffered, watertight, culling, hidden kept", Method.IVIR, PointStorage.BUFFERED, cull_hidden=False))
    by_rasterizer = {"point_generation": PointGeneration.RASTERIZER}
    found += [
        variant(f"ivir {points.value}, watertight, culling, by rasterizer", Method.IVIR, points, **by_rasterizer) for points in PointStorage
    ]
    return found


def can_run(variant: Variant, device: Device) -> bool:
    if variant.planned.point_generation is PointGeneration.RASTERIZER:
        return device.stores_from_geometry
    return variant.planned.method is not Method.VWSS or device.stores_from_fragments


class Bench:
    """A surface on the device with its views fitted as a render fits them."""

    def __init__(self, snapshot: SceneSnapshot, device: Device, view_count: int, resolution_px: int) -> None:
        self.device, self.light = device, snapshot.lights[0]
        bounds = compute_bounds(snapshot)
        self.scene_data = SceneData(snapshot, device)
        eye = EyePass(self.scene_data, bounds, np.zeros((1, 2)))
        device.run(eye.render, 0)
        receivers = select_receivers(device.read(eye.buffers[0].positions), device.read(eye.buffers[0].normals), self.light)
        eye.release()
        self.samples_m = light_samples(self.light, view_count)
        self.culled = cullable_instances(snapshot, bounds, light_hull(self.light, self.samples_m))
        faces, _ = fit_light(snapshot, self.light, self.samples_m, bounds, receivers, resolution_px)
        self.fitted: FittedFace = faces[0]
        self.maps = DepthMaps(device, resolution_px, resolution_px, min(MAX_BATCH_VIEWS, view_count))
        self.shared = SharedByFaces(device, Settings())

    def method(self, variant: Variant) -> DepthMapMethod:
        table = face_table(self.fitted.views, self.light)
        job = FaceJob(self.scene_data, self.fitted, table, self.culled, self.light, self.samples_m, variant.settings, self.shared)
        return depth_map_method(variant.planned, job)

    def batches(self) -> list[range]:
        views = self.fitted.views.view_count
        return [range(start, min(start + self.maps.view_count, views)) for start in range(0, views, self.maps.view_count)]

    def time(self, variant: Variant) -> Timing:
        method = self.method(variant)
        points_ms = device_ms(self.device, method.prepare)
        maps_ms = device_ms(self.device, lambda: self.device.run(self._fill_all, method))
        method.release()
        return Timing(points_ms, maps_ms)

    def _fill_all(self, method: DepthMapMethod) -> None:
        for batch in self.batches():
            method.fill(self.maps, batch)

    def inspect(self, variant: Variant) -> tuple[dict[str, int], np.ndarray]:
        """Counts, and which texels of the last batch's maps are covered. Also compiles what `time` needs."""
        method = self.method(variant)
        method.prepare()
        for batch in (self.batches()[0], self.batches()[-1]):  # what the first leaves out, the last may miss
            method.fill(self.maps, batch)
        covered = self.device.read(self.maps.texture) != EMPTY_DEPTH_BITS
        made = method.counts()
        counts = {
            "prepared": sum(made.get(name, 0) for name in ("point_count", "small_triangle_count", "large_triangle_count")),
            "kept": sum(made.get(name, 0) for name in ("kept_point_count", "kept_small_triangle_count")),
            "culled": getattr(method, "culled_triangle_count", 0),
        }
        method.release()
        return counts, covered

    def release(self) -> None:
        self.shared.release()
        self.maps.release()
        self.scene_data.release()


def measure(triangle_count: int, options: Options, device: Device) -> BenchTable:
    view_count, resolution_px = options.pick(64, 16), options.pick(1024, 256)
    snapshot = sphere_snapshot(triangle_count, *options.pick((960, 540), (240, 135)), has_floor=False)
    bench = Bench(snapshot, device, view_count, resolution_px)
    competitors = {variant.name: variant for variant in variants(view_count, resolution_px) if can_run(variant, device)}
    inspected = {name: bench.inspect(variant) for name, variant in competitors.items()}
    timings = take_turns({name: lambda v=variant: bench.time(v) for name, variant in competitors.items()}, options.rounds)
    bench.release()

    covered_by_baseline = inspected[BASELINE][1]
    baseline_ms = [timing.total_ms for timing in timings[BASELINE]]
    rows = []
    for name in competitors:
        counts, covered = inspected[name]
        total_ms = [timing.total_ms for timing in timings[name]]
        is_baseline = name == BASELINE
        missed = (covered_by_baseline & ~covered).sum() / max(covered_by_baseline.sum(), 1)
        rows.append(
            {
                "variant": name,
                "prepared": None if is_baseline else counts["prepared"],
                "kept": None if is_baseline else counts["kept"] or counts["prepared"],
                "culled": None if is_baseline else counts["culled"],
                "missed_share": None if is_baseline else float(missed),
                "points_ms": statistics.median(timing.points_ms for timing in timings[name]),
                "view_ms": statistics.median(timing.maps_ms for timing in timings[name]) / view_count,
                "total_ms": statistics.median(total_ms),
                "total_ms_by_round": total_ms,
                "speedup": median_ratio(baseline_ms, total_ms),
                "speedup_by_round": round_ratios(baseline_ms, total_ms),
            }
        )
    return BenchTable(
        title=f"Depth maps of {view_count} views at {resolution_px}², {snapshot.meshes[0].name}",
        compared=(
            f"Medians of {options.rounds} rounds in which all methods take turns; 'mvr / this' is the median of the rounds' ratios. "
            f"'texels missed': of the texels that mvr covers in the last {bench.maps.view_count} maps, outlines included. "
            "'replayed': what is left after the first batch of views. 'prepared, ms': making them once; bufferless makes them for every "
            "batch, within the time of a view."
        ),
        columns=COLUMNS,
        rows=rows,
    )


def run(options: Options) -> list[BenchTable]:
    device = open_device(options.device_name)
    try:
        sizes = options.pick((2_000_000, 1_000_000), (50_000,))
        return [measure(triangle_count, options, device) for triangle_count in sizes]
    finally:
        device.close()
