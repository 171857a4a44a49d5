"""Uninstalled, the extension leaves nothing behind, in memory or on disk, and files that used it open."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import bpy
from driver import FOLDER, MODULE, Steps, run, screenshot, show_panel, view


def steps() -> Steps:
    assert MODULE in bpy.context.preferences.addons
    yield from show_panel()
    bpy.ops.vir.render.poll()
    folder = Path(bpy.utils.user_resource("EXTENSIONS")) / "user_default" / "vir_passes"
    assert folder.is_dir()
    index = next(i for i, repo in enumerate(bpy.context.preferences.extensions.repos) if repo.module == "user_default")
    bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="vir_passes")
    yield 2.0
    assert MODULE not in bpy.context.preferences.addons and not folder.exists()
    assert not [name for name in dir(bpy.types) if name.startswith("VIR_")]
    assert not hasattr(bpy.context.scene, "vir")
    handlers = [
        function for name in dir(bpy.app.handlers) if isinstance(found := getattr(bpy.app.handlers, name), list) for function in found
    ]
    assert not [function for function in handlers if "vir_passes" in getattr(function, "__module__", "")]
    saved = FOLDER.parent / "first_steps" / "saved.blend"
    bpy.ops.wm.open_mainfile(filepath=str(saved), load_ui=False)
    yield 1.0
    assert "VIR Shadow" in bpy.data.images
    view()["space_data"].show_region_ui = True
    yield from screenshot("1_uninstalled")


run(steps)
