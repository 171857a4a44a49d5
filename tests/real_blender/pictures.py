"""The manual's pictures out of the screenshots of a run.

python -m tests.real_blender.pictures out/real_blender
"""

import sys
from pathlib import Path

from PIL import Image

TARGET = Path(__file__).resolve().parent.parent.parent / "docs" / "images"
PICTURES = {
    "panel": ("first_steps/4_rendered", (330, 30, 1312, 905), 900),
    "compositor": ("first_steps/7_compositor", (200, 160, 1030, 780), 640),
    "preview_reflections": ("preview/8_all", (300, 190, 1000, 584), 720),
    "tutorial_rendered": ("tutorial/1_rendered", (0, 30, 1312, 905), 900),
    "tutorial_pass": ("tutorial/2_pass", (0, 30, 1312, 905), 720),
    "tutorial_compositor": ("tutorial/3_compositor", (0, 30, 1312, 830), 900),
    "tutorial_before": ("tutorial/without", None, 440),
    "tutorial_result": ("tutorial/picture", None, 440),
    "panel_reflectors": ("passes/1_reflectors", (1026, 84, 1312, 900), 286),
    "shadows_without": ("passes/shadows_without", None, 440),
    "shadows_with": ("passes/shadows_with", None, 440),
    "reflection_without": ("passes/reflection_without", None, 300),
    "reflection_pass": ("passes/reflection_pass", None, 300),
    "reflection_with": ("passes/reflection_with", None, 300),
}
"""name -> screenshot, its part (left, top, right, bottom) in pixels, width in the manual"""
COLOUR_COUNT = 96
MOST_COLOUR_COUNT = 256
COLOURFUL = ("panel", "shadows_without", "shadows_with", "reflection_without", "reflection_pass", "reflection_with")
"""where colours are what a picture shows"""
SMOOTH = ("preview_reflections",)
"""kept as they are: few colours would put bands into penumbrae"""


def main(folder: Path) -> None:
    for name, (source, part, width_px) in PICTURES.items():
        picture = Image.open(folder / f"{source}.png").convert("RGB").crop(part)
        picture = picture.resize((width_px, round(picture.height * width_px / picture.width)), Image.LANCZOS)
        target = TARGET / f"{name}.png"
        # small things in few colours: the mean of what is nearest to each of those that are far from the others
        way = (
            {"colors": MOST_COLOUR_COUNT, "method": Image.Quantize.MAXCOVERAGE, "kmeans": 8}
            if name in COLOURFUL
            else {"colors": COLOUR_COUNT}
        )
        if name not in SMOOTH:
            picture = picture.quantize(**way)
        picture.save(target, optimize=True)
        print(f"{target}: {target.stat().st_size >> 10} KiB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
