"""Peak memory of whole renders, each in a process of its own.

    python -m tests.benchmarks.memory TRIANGLES VIEWS RESOLUTION_PX WIDTHxHEIGHT METHOD DEVICE

is such a process. On a software rasterizer textures lie in the same memory, so the peak holds them too; on a GPU it does not.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device

from .bumpy_sphere import sphere_snapshot
from .options import Options
from .tables import BenchTable, Column

PROJECT_FOLDER = Path(__file__).resolve().parents[2]
MIB = 1 << 20


def peak_mib() -> float:
    """The largest resident size of this process so far.

    Linux carries `ru_maxrss` over from the process that started this one, so its own high-water mark is read where there is one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 1024
    in_bytes = sys.platform == "darwin"
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (MIB if in_bytes else 1024)


def forget_peak() -> bool:
    """Let `peak_mib` start again from what is resident now, where the system can (Linux)."""
    switch = Path("/proc/self/clear_refs")
    if not switch.exists():
        return False
    switch.write_text("5")
    return True


def main(arguments: list[str]) -> None:
    triangles, views, resolution_px, size, method, device_name = arguments
    device = open_device(device_name)
    opened_mib = peak_mib()
    width_px, height_px = map(int, size.split("x"))
    snapshot = sphere_snapshot(int(triangles), width_px, height_px, has_floor=True)
    scene_mib = peak_mib()
    settings = Settings(method=Method(method), view_count=int(views), map_resolution_px=int(resolution_px))
    for progress in render(snapshot, plan(snapshot, settings), device):
        if progress.batches_done == progress.batches_total:
            made = progress.pass_set.statistics.passes[0]
    device.close()
    print(json.dumps({"how": made.method, "opened_mib": opened_mib, "scene_mib": scene_mib, "peak_mib": peak_mib()}))


def run(options: Options) -> list[BenchTable]:
    triangles, resolution_px, size = options.pick((2_000_000, 1024, "960x540"), (100_000, 256, "240x135"))
    most_views = options.pick(128, 32)
    rows = []
    for method in AUTO_METHODS:
        for views in (8, most_views):
            arguments = [str(triangles), str(views), str(resolution_px), size, method.value, options.device_name]
            command = [sys.executable, "-m", "tests.benchmarks.memory", *arguments]
            answer = subprocess.run(command, cwd=PROJECT_FOLDER, check=True, stdout=subprocess.PIPE, text=True).stdout
            rows.append({"views": views, "all_maps_mib": views * resolution_px**2 * 4 / MIB, **json.loads(answer.splitlines()[-1])})
    return [
        BenchTable(
            title=f"Peak memory of a render, bumpy sphere of {triangles:,} triangles on a floor, {size}, maps of {resolution_px}²",
            compared=(
                "MiB resident, each render in a process of its own. 'device' is the peak once the device is open, 'scene' once the "
                "snapshot is made, 'render' at the end, 'all maps' what holding the maps of all views at once would take."
            ),
            columns=(
                Column("how", "method"),
                Column("views", "views"),
                Column("opened_mib", "device", "{:.0f}"),
                Column("scene_mib", "scene", "{:.0f}"),
                Column("peak_mib", "render", "{:.0f}"),
                Column("all_maps_mib", "all maps", "{:.0f}"),
            ),
            rows=rows,
        )
    ]


if __name__ == "__main__":
    main(sys.argv[1:])
