"""Drives Blender's window from a generator: real mouse and key events, screenshots, waiting until something is so.

A script in this folder is run by Blender with --enable-event-simulate; it calls `run(steps)` with a generator that yields seconds.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

Steps = Iterator[float]

ZIP, SCENE, FOLDER = (Path(argument) for argument in sys.argv[sys.argv.index("--") + 1 :])
MODULE = "bl_ext.user_default.vir_passes"


def run(steps: Callable[[], Steps]) -> None:
    """Quits Blender at the end, with status 1 if a step raised."""
    bpy.context.preferences.view.show_splash = False
    running = steps()

    def tick() -> float | None:
        try:
            return float(next(running))
        except StopIteration:
            print("PASSED", flush=True)
            status = 0
        except BaseException:
            traceback.print_exc()
            take_picture("failed")
            status = 1
        sys.stdout.flush()
        if status:
            os._exit(status)
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=2.0, persistent=True)


def view(kind: str = "VIEW_3D", region: str = "WINDOW") -> dict[str, Any]:
    """For bpy.context.temp_override: the largest area of a kind."""
    window = bpy.context.window_manager.windows[0]
    area = max((area for area in window.screen.areas if area.type == kind), key=lambda area: area.width * area.height)
    found = next(one for one in area.regions if one.type == region)
    return {"window": window, "screen": window.screen, "area": area, "region": found, "space_data": area.spaces.active}


def redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            area.tag_redraw()


def screenshot(name: str) -> Steps:
    """FOLDER/NAME.png of the whole window."""
    for _ in range(4):  # panels slide into their places, a step a redraw
        redraw()
        yield 0.5
    target = take_picture(name)
    assert target.stat().st_size > 10_000, f"{target} shows nothing"


def take_picture(name: str) -> Path:
    """Of the window as it is drawn now."""
    target = FOLDER / f"{name}.png"
    if command := os.environ.get("SCREENSHOT"):
        subprocess.run([*shlex.split(command), str(target)], check=True)
    else:
        with bpy.context.temp_override(**view()):
            bpy.ops.screen.screenshot(filepath=str(target))
    return target


def wait_until(condition: Callable[[], Any], what: str, seconds: float = 180.0) -> Steps:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"{what}: not within {seconds:.0f} s"
        yield 0.1


def event(kind: str, value: str = "PRESS", x: int = 0, y: int = 0, **modifiers: bool) -> None:
    window = bpy.context.window_manager.windows[0]
    window.event_simulate(type=kind, value=value, x=x, y=y, **modifiers)


def move(x: int, y: int) -> Steps:
    event("MOUSEMOVE", "NOTHING", x, y)
    yield 0.05


def click(x: int, y: int) -> Steps:
    yield from move(x - 3, y)
    yield from move(x, y)
    event("LEFTMOUSE", "PRESS", x, y)
    yield 0.05
    event("LEFTMOUSE", "RELEASE", x, y)
    yield 0.3


def press(key: str, over: dict[str, Any] | None = None, **modifiers: bool) -> Steps:
    """With the mouse in the middle of a region."""
    region = (over or view())["region"]
    x, y = region.x + region.width // 2, region.y + region.height // 2
    yield from move(x, y)
    event(key, "PRESS", x, y, **modifiers)
    yield 0.05
    event(key, "RELEASE", x, y, **modifiers)
    yield 0.3


def render(seconds: float = 500.0, **modifiers: bool) -> Steps:
    """Press F12 and wait for the end. Blender tells when that was: a small picture takes less time than passes between two looks."""
    ended: list[bool] = []

    def note_end(*_: Any) -> None:
        ended.append(True)

    handlers = bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel
    for each in handlers:
        each.append(note_end)
    yield from press("F12", **modifiers)
    yield from wait_until(lambda: ended and not bpy.app.is_job_running("RENDER"), "F12 ends", seconds)
    for each in handlers:
        each.remove(note_end)


def close_other_windows() -> Steps:
    """All but the first, the render's for example."""
    while len(bpy.context.window_manager.windows) > 1:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
            bpy.ops.wm.window_close()
        yield 0.3


def drop_file(path: Path) -> Iterator[float]:
    """On the 3D viewport, from another program; returns whether Blender took it. Only where windows are X11's."""
    region, window = view()["region"], bpy.context.window_manager.windows[0]
    x, y = window.x + region.x + region.width // 2, window.y + window.height - region.y - region.height // 2
    command = [sys.executable, str(Path(__file__).parent / "drop_file.py"), str(path), str(x), str(y)]
    dropping = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    yield from wait_until(lambda: dropping.poll() is not None, "the drop ends", 60)
    if dropping.returncode:
        print(f"not dropped: {dropping.communicate()[0].strip()}", flush=True)
    return dropping.returncode == 0


def sidebar() -> dict[str, Any]:
    return view(region="UI")


def show_panel() -> Steps:
    """Open the viewport's sidebar at "VIR", wide enough to read."""
    view()["space_data"].show_region_ui = True
    yield 0.5
    sidebar()["region"].active_panel_category = "VIR"
    redraw()
    yield 0.7


def command_under_mouse(region: Any) -> str:
    """What the button there runs; empty: none."""
    window_manager = bpy.context.window_manager
    window_manager.clipboard = ""
    with bpy.context.temp_override(window=window_manager.windows[0], area=sidebar()["area"], region=region):
        if bpy.ops.ui.copy_python_command_button.poll():
            bpy.ops.ui.copy_python_command_button()
    return window_manager.clipboard


def find_button(command: str, region: Any, near: tuple[int, int] | None) -> Iterator[float]:
    """Returns (x, y) of the button that runs the command: Blender tells what is under the mouse, swept down in steps below a row.

    A busy Blender is late to notice that the mouse has moved, so what it tells is asked again after a while.
    """
    top, bottom = (region.y + region.height - 10, region.y + 4) if near is None else (near[1] + 30, near[1] - 40)
    yield from move(region.x - 200, region.y + region.height // 2)
    yield from wait_until(lambda: command not in command_under_mouse(region), "the mouse leaves the button", 20)
    for share in (0.3, 0.85):
        for y in range(top, bottom, -7):
            x = region.x + int(region.width * share)
            yield from move(x, y)
            if command in command_under_mouse(region):
                yield 0.4
                if command in command_under_mouse(region):
                    return x, y
    raise AssertionError(f"no button for {command}")


def click_button(command: str, near: tuple[int, int] | None = None) -> Iterator[float]:
    """Returns where it was; `near` makes looking for it quick."""
    x, y = yield from find_button(command, sidebar()["region"], near)
    yield from click(x, y)
    return x, y
