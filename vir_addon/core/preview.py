"""8-bit pictures of passes to look at: one PNG a pass and a contact sheet. Not for compositing: values are sRGB-encoded and rounded."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from .errors import UsageError
from .files import whole_file
from .pass_set import PassSet, PassStatistics

if TYPE_CHECKING:
    from PIL import Image, ImageFont

SHEET_WIDTH_PX = 1920
"""what a contact sheet is fitted to; single pictures are never enlarged"""
LABEL_HEIGHT_PX = 36
MARGIN_PX = 12
BACKGROUND = 24
"""8-bit grey of the sheet: apart from both black shadow and white light"""


def encode_srgb(image: np.ndarray) -> np.ndarray:
    """Linear float -> uint8 of the same shape with the sRGB curve; clipped to 0..1, not-a-number becomes 0."""
    linear = np.clip(np.nan_to_num(image.astype(np.float32), nan=0.0), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055)
    return np.round(encoded * 255.0).astype(np.uint8)


def write_previews(folder: Path, stem: str, passes: PassSet, label_font: Path | None = None) -> list[Path]:
    """Write `<stem>_<pass>.png` for every pass and `<stem>_contact_sheet.png`, the last of the returned paths.

    `label_font` is a font file for the sheet's labels; without one, pillow's own, which has plain Latin letters only.

    Raises UsageError when pillow is not installed, when there is no pass or when `folder` cannot be written.
    """
    if not passes.images:
        raise UsageError("there is no pass to show")
    paths = []
    for pass_name, file_name in _file_names(stem, list(passes.images)).items():
        paths.append(folder / file_name)
        _save(_picture(passes.images[pass_name]), paths[-1], title=pass_name)
    paths.append(folder / f"{stem}_contact_sheet.png")
    _save(contact_sheet(passes, label_font), paths[-1], title=stem)
    return paths


def contact_sheet(passes: PassSet, label_font: Path | None = None) -> Image.Image:
    """All passes side by side, each above its name and how it was made. Raises UsageError when pillow is not installed."""
    pillow = _pillow()
    from PIL import ImageDraw

    made = {statistics.pass_name: statistics for statistics in passes.statistics.passes}
    height, width = next(iter(passes.images.values())).shape[:2]
    column_count = math.ceil(math.sqrt(len(passes.images)))
    row_count = math.ceil(len(passes.images) / column_count)
    cell_width = max(1, min(width, (SHEET_WIDTH_PX - MARGIN_PX) // column_count - MARGIN_PX))
    cell_height = max(1, round(height * cell_width / width))
    column_px, row_px = cell_width + MARGIN_PX, cell_height + LABEL_HEIGHT_PX + MARGIN_PX
    size = (MARGIN_PX + column_count * column_px, MARGIN_PX + row_count * row_px)
    has_colors = any(image.ndim == 3 for image in passes.images.values())
    sheet = pillow.new("RGB", size, 3 * (BACKGROUND,)) if has_colors else pillow.new("L", size, BACKGROUND)
    draw, font = ImageDraw.Draw(sheet), _font(label_font)
    for index, (pass_name, image) in enumerate(passes.images.items()):
        x, y = MARGIN_PX + (index % column_count) * column_px, MARGIN_PX + (index // column_count) * row_px
        sheet.paste(_picture(image, (cell_width, cell_height)), (x, y))
        for line, text in enumerate((pass_name, _summary(made.get(pass_name)))):
            shown = _shorten(text, lambda text: draw.textlength(text, font=font) <= cell_width)
            draw.text(
                (x, y + cell_height + 2 + 16 * line), shown, fill=(3 * (230 - 80 * line,) if has_colors else 230 - 80 * line), font=font
            )
    return sheet


def _pillow() -> ModuleType:
    """PIL.Image, or UsageError: Blender does not bring it, so it comes with the command line's dependencies only."""
    try:
        from PIL import Image
    except ImportError as error:
        raise UsageError("previews need pillow: pip install pillow==13.0.0") from error
    return Image


def _font(path: Path | None) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    from PIL import ImageFont

    return ImageFont.load_default(size=13) if path is None else ImageFont.truetype(str(path), size=13)


def _picture(image: np.ndarray, size_px: tuple[int, int] | None = None) -> Image.Image:
    """A pass, (height, width) or (height, width, 3) with row 0 at the bottom, as an 8-bit picture; shrunk while it is still linear."""
    pillow = _pillow()
    top_down = np.ascontiguousarray(image[::-1], dtype=np.float32)
    if size_px is not None and size_px != (image.shape[1], image.shape[0]):
        planes = [top_down] if top_down.ndim == 2 else np.moveaxis(top_down, -1, 0)
        smaller = [np.asarray(pillow.fromarray(np.ascontiguousarray(plane)).resize(size_px, pillow.Resampling.BOX)) for plane in planes]
        top_down = smaller[0] if top_down.ndim == 2 else np.stack(smaller, axis=-1)
    return pillow.fromarray(encode_srgb(top_down))


def _save(picture: Image.Image, target: Path, title: str) -> None:
    from PIL.PngImagePlugin import PngInfo

    notes = PngInfo()
    notes.add(b"sRGB", b"\0")  # the encoding, said where viewers look for it
    notes.add_itxt("Title", title)
    with whole_file(target) as temporary:
        picture.save(temporary, format="PNG", pnginfo=notes)


def _summary(made: PassStatistics | None) -> str:
    if made is None:
        return ""
    return f"{made.method}, {made.view_count} views" if made.view_count else made.reason


def _shorten(text: str, fits: Callable[[str], bool]) -> str:
    """`text`, or as much of its beginning as `fits` allows, with an ellipsis."""
    if fits(text):
        return text
    while text and not fits(text + "…"):
        text = text[:-1]
    return text + "…"


def file_name_part(text: str) -> str:
    """A name from the scene as a part of a file's name on any system."""
    return re.sub(r'[\s<>:"/\\|?*\x00-\x1f]+', "_", text)


def _file_names(stem: str, pass_names: list[str]) -> dict[str, str]:
    """Pass name -> file name without what file systems refuse; different also where upper and lower case are the same."""
    taken: set[str] = {f"{stem}_contact_sheet.png".casefold()}
    names = {}
    for pass_name in pass_names:
        # the stem is a file's already, and previews should sort next to it
        base = f"{stem}_{file_name_part(pass_name)}"
        name, number = f"{base}.png", 2
        while name.casefold() in taken:
            name, number = f"{base}_{number}.png", number + 1
        taken.add(name.casefold())
        names[pass_name] = name
    return names
