"""python -m tests.benchmarks [--quick] [--only NAME] [--rounds N] [--cycles-rounds N] [--output FOLDER] [--device NAME]

Prints tables and writes them as bench.json and bench.md. Run it on a machine that does nothing else: only ratios within one run mean
anything.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import bpy
from rich.console import Console

from vir_addon import __version__
from vir_addon.device.open import DEVICE_NAMES, open_device

from .options import Options

LOG_WIDTH = 160
"""characters of a line where there is no terminal to ask"""
BENCHMARKS = ("depth_maps", "hybrid_threshold", "whole_render", "memory", "accuracy")


def parse_options() -> tuple[Options, list[str]]:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks", description="Time VIR against rasterizing every view and against Cycles."
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it works; the figures mean nothing")
    parser.add_argument(
        "--only", action="append", choices=BENCHMARKS, metavar="NAME", help=f"one of {', '.join(BENCHMARKS)}; may be repeated"
    )
    parser.add_argument("--rounds", type=int, help="of depth_maps; default 5, quick 2")
    parser.add_argument("--cycles-rounds", type=int, help="of whole_render; default 3, quick 1")
    parser.add_argument("--output", type=Path, default=Path("out/bench"))
    parser.add_argument("--device", choices=DEVICE_NAMES, default=DEVICE_NAMES[0])
    given = parser.parse_args()
    rounds = given.rounds or (2 if given.quick else 5)
    cycles_rounds = given.cycles_rounds or (1 if given.quick else 3)
    return Options(given.output, given.device, given.quick, rounds, cycles_rounds), given.only or list(BENCHMARKS)


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


def main() -> None:
    options, names = parse_options()
    options.output.mkdir(parents=True, exist_ok=True)
    console = Console()
    if not console.is_terminal:
        console = Console(width=LOG_WIDTH)
    record: dict[str, Any] = {"machine": machine(options.device_name), "is_quick": options.is_quick, "benchmarks": {}}
    facts = ", ".join(f"{key} {value}" for key, value in record["machine"].items())
    console.print(facts, highlight=False)
    markdown = [f"Measured with {facts}." + (" Quick sizes: the figures mean nothing." if options.is_quick else ""), ""]
    for name in names:
        start_s = time.perf_counter()
        tables = importlib.import_module(f".{name}", __package__).run(options)
        for table in tables:
            console.print(table.to_rich())
            markdown.append(table.to_markdown())
        console.print(f"{name} took {time.perf_counter() - start_s:.0f} s\n", highlight=False)
        record["benchmarks"][name] = [table.to_data() for table in tables]
        # after every one: a run that is stopped keeps what it has
        (options.output / "bench.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        (options.output / "bench.md").write_text("\n".join(markdown), encoding="utf-8")
    console.print(f"wrote {options.output / 'bench.json'} and bench.md", highlight=False)


if __name__ == "__main__":
    main()
