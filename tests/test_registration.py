"""Switching the extension on and off leaves Blender as it was."""

import sys
from types import FunctionType

import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import properties, translations  # noqa: E402


def blender_state() -> dict[str, object]:
    """What an extension can leave behind, in comparable form."""
    handlers = {
        name: [*getattr(bpy.app.handlers, name)] for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)
    }
    return {
        "classes": set(dir(bpy.types)),
        "subclasses": {
            kind: set(getattr(bpy.types, kind).__subclasses__()) for kind in ("Operator", "Panel", "Menu", "PropertyGroup", "UIList")
        },
        "operators": set(dir(bpy.ops)) | {f"vir.{name}" for name in dir(bpy.ops.vir)},
        "properties": {
            kind: set(getattr(bpy.types, kind).bl_rna.properties.keys()) for kind in ("Scene", "Object", "Light", "WindowManager")
        },
        "handlers": handlers,
        "preset paths": set(bpy.utils._preset_path_registry),
        "keymaps": {keymap.name: len(keymap.keymap_items) for keymap in bpy.context.window_manager.keyconfigs.default.keymaps},
        # Blender cannot list its commands, but it holds a reference to the function of each.
        "command references": sys.getrefcount(blender.run_command),
    }


def functions_of_the_extension() -> list[FunctionType]:
    modules = [module for name, module in sys.modules.items() if name.startswith("vir_addon.blender")]
    return [value for module in modules for value in vars(module).values() if isinstance(value, FunctionType)]


def test_on_and_off_twice_leaves_nothing_behind():
    before = blender_state()
    for _ in range(2):
        blender.register()
        assert blender_state()["command references"] == before["command references"] + 1
        blender.unregister()
        assert blender_state() == before
    assert not any(bpy.app.timers.is_registered(function) for function in functions_of_the_extension())


def test_off_without_on_is_harmless():
    before = blender_state()
    blender.unregister()
    assert blender_state() == before


@pytest.mark.parametrize("failing", [translations, properties])
def test_what_fails_halfway_leaves_nothing_behind(monkeypatch, failing):
    """As where a class of an older version is still there."""
    before = blender_state()

    def refuse(*_):
        raise ValueError("already registered")

    with monkeypatch.context() as patch:
        if failing is translations:
            patch.setattr(translations, "register", refuse)
        else:
            patch.setattr(properties, "CLASSES", (*properties.CLASSES[:1], type("Refused", (), {})))
        with pytest.raises((ValueError, RuntimeError)):
            blender.register()
    assert blender_state() == before
    blender.register()
    blender.unregister()
    assert blender_state() == before


def test_the_command_is_the_command_line(monkeypatch):
    given = []

    class CommandLine:
        @staticmethod
        def main(arguments):
            given.append(arguments)
            return 3

    monkeypatch.setitem(sys.modules, "vir_addon.__main__", CommandLine)
    assert blender.run_command(["render", "scene.blend"]) == 3
    assert given == [["render", "scene.blend"]]
