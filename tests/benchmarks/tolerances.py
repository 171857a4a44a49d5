"""What the tolerances of a look-up cost: light where surfaces touch against shadow on what is lit, each tolerance smaller and larger."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Generator, Iterable, Iterator
from typing import Any

import numpy as np

from tests.contacts import SCENES, VIEWS, ContactError, Measurement
from tests.scenes import render_batches
from vir_addon.core.light_work import LightWork
from vir_addon.core.passes.accumulate import PassAccumulator, pass_image
from vir_addon.core.passes.resolve import RESOLVE, TOLERANCES
from vir_addon.core.settings import Method, Resolve
from vir_addon.device.declaration import ComputeDeclaration
from vir_addon.device.open import open_device
from vir_addon.device.owned import Owned

from .options import Options
from .tables import BenchTable, Column

MAP_PX = {
    "light in a cube on a floor": 128,
    "thin wall": 512,
    "stairs": 512,
    "leaning board": 512,
    "cube on a floor": 512,
    "sphere on a floor": 512,
    "wall on a grazed floor": 512,
    "grazed quads": 512,
    "grazed waves": 512,
    "coarse sphere, flat": 512,
    "rough ground": 40,
}
"""of the scenes that tell tolerances apart"""
METHODS = (Method.MVR, Method.IVIR)
MEASURES = {"total": "RMSE", "acne": "acne", "leak": "leak"}
"""of ContactError"""
Variant = tuple[str | None, float, ComputeDeclaration]
"""which tolerance is other than it is, by which factor, and RESOLVE with it"""
Errors = dict[str, dict[Method, list[ContactError]]]
"""of each scene and method, one for each variant"""


def variants(factors: Iterable[float]) -> Iterator[Variant]:
    """First RESOLVE as it is."""
    yield None, 1.0, RESOLVE
    for name, value in TOLERANCES.items():
        for factor in factors:
            changed = {**RESOLVE.defines, name: value * factor}
            yield name, factor, dataclasses.replace(RESOLVE, name=f"resolve_{name}_{factor}", defines=changed)


def look_up_with(work: LightWork, declarations: list[ComputeDeclaration], owned: Owned) -> list[PassAccumulator]:
    """Have the same maps looked up by each, with sums of its own."""
    device, width, height = work.device, work.accumulator.width, work.accumulator.height
    accumulators = [owned.own(PassAccumulator(device, width, height)) for _ in declarations]
    zeros = np.zeros((height, width, 4), np.float32)
    batch_sums = [[owned.own(device.upload_texture(zeros)) for _ in work.store.batch_sums] for _ in declarations]
    looking_up = work._looking_up

    def looking_up_with_each(part: int, turns: np.ndarray, look_up: dict[str, Any]) -> Generator[None, None, None]:
        for work.look_up, accumulator, sums in zip(declarations, accumulators, batch_sums, strict=True):
            yield from looking_up(part, turns, {**look_up, "round_sums": accumulator.round_sums, "batch_sums": sums[part]})

    work._looking_up = looking_up_with_each  # type: ignore[method-assign]
    return accumulators


def errors_of_scene(measurement: Measurement, method: Method, map_px: int, declarations: list[ComputeDeclaration]) -> list[ContactError]:
    with Owned() as owned, measurement.rendered(method, map_px, resolve=Resolve.FULL) as renderer:
        (work,) = renderer.works
        accumulators = look_up_with(work, declarations, owned)
        render_batches(renderer)
        for accumulator in accumulators:
            accumulator.round_count = work.accumulator.round_count
        return [measurement.compare(pass_image(*accumulator.read()), renderer) for accumulator in accumulators]


def _root_mean_square(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))


def _by_tolerance(changed: list[Variant], errors: Errors) -> BenchTable:
    rows = []
    for index, (name, factor, _) in enumerate(changed):
        row: dict[str, Any] = {
            "tolerance": name or "all as they are",
            "value": TOLERANCES[name] * factor if name else None,
            "factor": factor,
        }
        for method, measure in itertools.product(METHODS, MEASURES):
            row[f"{method.value}_{measure}"] = _root_mean_square(getattr(found[method][index], measure) for found in errors.values())
        rows.append(row)
    return BenchTable(
        title=f"Tolerances of a look-up: {len(errors)} scenes of contacts, folds and grazing light, {VIEWS} views",
        compared=(
            "Error against rays in float64 to the same light samples, root mean square over the scenes. Leak: where none of the light is "
            "seen; acne: where all of it is; RMSE: of all surfaces. One tolerance at a time is smaller or larger than it is."
        ),
        columns=(Column("tolerance", "tolerance"), Column("factor", "times", "{:g}"), Column("value", "is", "{:.4f}"), *_error_columns()),
        rows=rows,
    )


def _by_scene(errors: Errors) -> BenchTable:
    rows = [
        {"scene": name, "map_px": MAP_PX[name]}
        | {f"{method.value}_{measure}": getattr(found[method][0], measure) for method, measure in itertools.product(METHODS, MEASURES)}
        for name, found in errors.items()
    ]
    return BenchTable(
        title="The same scene by scene, with all tolerances as they are",
        compared="Maps are as fine as the scene needs to tell tolerances apart.",
        columns=(Column("scene", "scene"), Column("map_px", "map, texels"), *_error_columns()),
        rows=rows,
    )


def _error_columns() -> Iterator[Column]:
    for method, (measure, heading) in itertools.product(METHODS, MEASURES.items()):
        yield Column(f"{method.value}_{measure}", f"{method.value}: {heading}", "{:.4f}")


def run(options: Options) -> list[BenchTable]:
    factors = options.pick((0.25, 0.5, 2.0, 4.0), (4.0,))
    names = options.pick(list(MAP_PX), ["leaning board"])
    changed = list(variants(factors))
    declarations = [declaration for _, _, declaration in changed]
    errors: Errors = {}
    device = open_device(options.device_name)
    try:
        for name in names:
            measurement = Measurement(SCENES[name](), device)
            errors[name] = {method: errors_of_scene(measurement, method, MAP_PX[name], declarations) for method in METHODS}
    finally:
        device.close()
    return [_by_tolerance(changed, errors), _by_scene(errors)]
