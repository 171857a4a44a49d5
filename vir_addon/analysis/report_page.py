"""One HTML page on how passes were made, whole in one file: for the panel's "Open Report"."""

from __future__ import annotations

import base64
import html
import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..core.pass_set import STAGES, PassStatistics, SetStatistics
from ..core.preview import encode_srgb

PICTURE_WIDTH_PX = 480

STYLE = """
body { font: 14px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1100px; padding: 0 1em; color: #222; background: #fafafa }
table { border-collapse: collapse; margin: 1em 0 } th, td { text-align: left; padding: .3em .8em; border-bottom: 1px solid #ddd }
th { background: #eee } td.number { text-align: right; font-variant-numeric: tabular-nums }
figure { display: inline-block; margin: 0 1em 1em 0 } img { display: block; max-width: 100% } figcaption { color: #555 }
@media (prefers-color-scheme: dark) { body { background: #1d1d1d; color: #ddd } th { background: #333 } th, td { border-color: #444 }
figcaption { color: #aaa } }
"""


def report_page(title: str, layers: Mapping[str, SetStatistics], pictures: Mapping[str, np.ndarray]) -> str:
    """layers: view layer name -> statistics; pictures: pass name -> (height, width) or (height, width, 3) float, row 0 at the bottom."""
    parts = [f"<!DOCTYPE html><html lang=en><meta charset=utf-8><title>{_text(title)}</title><style>{STYLE}</style><h1>{_text(title)}</h1>"]
    for name, statistics in layers.items():
        parts += _layer(name, statistics)
    parts.append("<h2>Passes</h2>")
    parts += [_figure(name, pixels) for name, pixels in pictures.items()]
    return "\n".join([*parts, "</html>"])


def _layer(name: str, statistics: SetStatistics) -> list[str]:
    flat = f", {statistics.flat_triangle_count:,} of them without area" if statistics.flat_triangle_count else ""
    scene = (
        f"{statistics.object_count:,} objects, {statistics.instance_count:,} instances, "
        f"{statistics.unique_triangle_count:,} triangles{flat} ({statistics.instanced_triangle_count:,} with instances), "
        f"{statistics.eye_sample_count} eye samples, on {statistics.device}"
    )
    head = ("pass", "light", "method", "views", "maps", "error", "seconds", "why")
    totals = dict(statistics.stage_ms)
    for made in statistics.passes:
        for stage, spent in made.stage_ms.items():
            totals[stage] = totals.get(stage, 0.0) + spent
    times = [(stage, f"{totals[stage] / 1e3:.2f}") for stage in STAGES if stage in totals]
    parts = [f"<h2>{_text(name)}</h2><p>{_text(scene)}</p>", _table(head, [_row(made) for made in statistics.passes])]
    parts += ["<h3>Where the time went</h3>", _table(("stage", "seconds"), times)]
    for heading, lines in (("Notes", statistics.notes), ("Left out", statistics.left_out)):
        if lines:
            parts.append(f"<h3>{heading}</h3><ul>{''.join(f'<li>{_text(line)}</li>' for line in lines)}</ul>")
    return parts


def _row(made: PassStatistics) -> Sequence[str]:
    if not made.view_count:
        return made.pass_name, made.light_name, made.method, "", "", "", "", made.reason
    maps = f"{made.map_resolution_px} px" + (f" × {made.face_count}" if made.face_count > 1 else "") if made.map_resolution_px else "none"
    error = f"{made.error_estimate:.4f}" if math.isfinite(made.error_estimate) else "unknown"
    seconds = f"{sum(made.stage_ms.values()) / 1e3:.2f}"
    return made.pass_name, made.light_name, made.method, str(made.view_count), maps, error, seconds, made.reason


def _table(head: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    def cell(text: str) -> str:
        return f"<td{' class=number' if text[:1].isdigit() else ''}>{_text(text)}</td>"

    lines = ["<tr>" + "".join(f"<th>{_text(text)}</th>" for text in head) + "</tr>"]
    lines += ["<tr>" + "".join(map(cell, row)) + "</tr>" for row in rows]
    return f"<table>{''.join(lines)}</table>"


def _figure(name: str, pixels: np.ndarray) -> str:
    step = max(1, math.ceil(pixels.shape[1] / PICTURE_WIDTH_PX))
    height, width = (side // step * step for side in pixels.shape[:2])
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, *pixels.shape[2:])
    png = base64.b64encode(encode_png(encode_srgb(blocks.mean(axis=(1, 3)))[::-1])).decode()
    return f'<figure><img src="data:image/png;base64,{png}" alt=""><figcaption>{_text(name)}</figcaption></figure>'


def encode_png(pixels: np.ndarray) -> bytes:
    """(height, width) or (height, width, 3) uint8, first row on top, as a PNG file: pillow is not part of the extension."""
    height, width = pixels.shape[:2]

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = np.ascontiguousarray(pixels).reshape(height, -1)
    unfiltered = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 0 if pixels.ndim == 2 else 2, 0, 0, 0)
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(unfiltered.tobytes(), 6)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _text(text: str) -> str:
    return html.escape(str(text))
