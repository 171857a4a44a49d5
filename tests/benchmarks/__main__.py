"""python -m tests.benchmarks [--quick] [--peers] [--only NAME] [--rounds N] [--model FILE] [--output FOLDER] [--device NAME]

Prints tables and puts them into bench.json and bench.md, beside those of other benches that are there. Run it on a machine that does
nothing else: only ratios within one run mean anything.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
from rich.console import Console

from vir_addon import __version__
from vir_addon.device.open import DEVICE_NAMES, open_device

from . import (
    adaptive,
    depth_maps,
    growth,
    hybrid_threshold,
    memory,
    one_map,
    peers,
    reflections,
    reflections_cycles,
    speed,
    tolerances,
    whole_render,
)
from .options import Options
from .tables import BenchTable

LOG_WIDTH = 160
"""characters of a line where there is no terminal to ask"""
RECORD_KEYS = frozenset({"measured_with", "machine", "tables"})
Tables = list[BenchTable]
Run = Callable[[Options], Tables | Iterator[Tables]]
"""What takes long is an iterator: the tables again after every few rows."""
BENCHMARKS: dict[str, Run] = {
    "closed_surface": speed.closed_surface,
    "model": speed.model,
    "colonnade": speed.colonnade,
    "furnished_room": speed.furnished_room,
    "forest": speed.forest,
    "adaptive": adaptive.run,
    "growth_views": growth.views,
    "growth_triangles": growth.triangles,
    "growth_map_size": growth.map_size,
    "growth_pixels": growth.pixels,
    "depth_maps": depth_maps.run,
    "hybrid_threshold": hybrid_threshold.run,
    "whole_render": whole_render.run,
    "memory": memory.run,
    "one_map": one_map.run,
    "reflections": reflections.run,
    "reflections_sampling": reflections.sampling,
    "tolerances": tolerances.run,
}
PEERS: dict[str, Run] = {
    "peers_head": peers.head,
    "peers_colonnade": peers.hall,
    "peers_model": peers.model,
    "reflections_cycles": reflections_cycles.run,
    "reflections_rays": reflections_cycles.rays,
    "reflections_room": reflections_cycles.room,
}
"""what `--peers` runs: `make bench-peers`"""
NAMES = [*BENCHMARKS, *PEERS]


def parse_options() -> tuple[Options, list[str]]:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks",
        description="Time VIR's methods against rasterizing every view, and against Cycles and EEVEE.",
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it works; the figures mean nothing")
    parser.add_argument("--only", action="append", choices=NAMES, metavar="NAME", help=f"one of {', '.join(NAMES)}; may be repeated")
    parser.add_argument("--rounds", type=int, help="in which all take turns; default: what the bench thinks fit, most often 5")
    parser.add_argument("--model", type=Path, help="a model or .blend file for `model` and `peers`, instead of a scene of their own")
    parser.add_argument("--output", type=Path, default=Path("out/bench"))
    parser.add_argument("--device", choices=DEVICE_NAMES, default=DEVICE_NAMES[0])
    parser.add_argument("--peers", action="store_true", help="everything against Cycles and EEVEE instead of everything else")
    given = parser.parse_args()
    options = Options(given.output, given.device, given.quick, given.rounds, given.model)
    return options, given.only or list(PEERS if given.peers else BENCHMARKS)


def machine(device_name: str) -> dict[str, Any]:
    device = open_device(device_name)
    description = device.description
    device.close()
    return {
        "vir": __version__,
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "device": f"{device_name}: {description}",
        "processors": os.cpu_count(),
        "load_before": os.getloadavg()[0],
    }


def known_record(path: Path) -> dict[str, Any]:
    """What earlier runs into the same folder left: benches that take long are run one by one. Files of other versions are not read."""
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return {name: entry for name, entry in found.items() if name in BENCHMARKS | PEERS and set(entry) >= RECORD_KEYS}


def write_record(folder: Path, record: dict[str, Any]) -> None:
    (folder / "bench.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    texts = [text for entry in record.values() for text in (entry["measured_with"], "", *(table["markdown"] for table in entry["tables"]))]
    (folder / "bench.md").write_text("\n".join(texts), encoding="utf-8")


def states(name: str, options: Options) -> Iterator[Tables]:
    """A bench's tables, as far as they are; the last are all of them."""
    found = (BENCHMARKS | PEERS)[name](options)
    yield from [found] if isinstance(found, list) else found


def print_new_rows(console: Console, tables: Tables, shown: set[int]) -> None:
    """shown: ids of the rows that have been"""
    for table in tables:
        for row in table.rows:
            if id(row) not in shown:
                console.print(table.line(row), highlight=False)
                shown.add(id(row))


def main() -> None:
    options, names = parse_options()
    options.output.mkdir(parents=True, exist_ok=True)
    console = Console()
    if not console.is_terminal:
        console = Console(width=LOG_WIDTH)
    record = known_record(options.output / "bench.json")
    for name in names:
        facts = machine(options.device_name)
        measured_with = f"Measured with {', '.join(f'{key} {value}' for key, value in facts.items())}."
        if options.is_quick:
            measured_with += " Quick sizes: the figures mean nothing."
        console.print(f"{name}: {measured_with}", highlight=False)
        start_s = time.perf_counter()
        tables: Tables = []
        shown: set[int] = set()
        for tables in states(name, options):
            print_new_rows(console, tables, shown)
            # after every few rows: a run that is stopped keeps what it has
            record[name] = {"measured_with": measured_with, "machine": facts, "tables": [table.to_data() for table in tables]}
            write_record(options.output, record)
        for table in tables:
            console.print(table.to_rich())
        console.print(f"{name} took {time.perf_counter() - start_s:.0f} s\n", highlight=False)
    console.print(f"wrote {options.output / 'bench.json'} and bench.md", highlight=False)


if __name__ == "__main__":
    main()
