"""What the artist reads has translations, and these belong to something that is read."""

import ast
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import panels, properties, translations  # noqa: E402

NAMES_OF_THINGS = {"OpenGL", "Blender", "Micro", "MVR", "IVIR", "VIR", "VWSS", "EPR", "PCSS"}
BLENDERS_OWN = {"Automatic", "Light", "Memory", "Presets"}
SHARE = 0.85
"""of all texts: whoever adds one need not know every language"""


def literals(path: Path) -> set[str]:
    """Texts of labels in a module that Blender is not told to leave alone."""
    found = set()
    for call in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)):
        given = {keyword.arg: keyword.value for keyword in call.keywords}
        values = [] if "translate" in given else [given[name] for name in ("text", "heading") if name in given]
        nodes = [node for value in values if not isinstance(value, ast.JoinedStr) for node in ast.walk(value)]
        found |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return found


def texts() -> set[tuple[str, str]]:
    """(context, text)"""
    shown = {text for module in (panels, blender.interface) for text in literals(Path(module.__file__))}
    operators = set()
    for group in properties.CLASSES:
        for one in group.bl_rna.properties:
            if not one.is_hidden and one.identifier not in ("rna_type", "name"):
                shown |= {one.name, one.description}
                if one.type == "ENUM":
                    shown |= {text for item in one.enum_items for text in (item.name, item.description)}
    for registered in blender.CLASSES:
        if issubclass(registered, bpy.types.Operator):
            operators.add(registered.bl_label)
            name = registered.bl_idname.removeprefix("vir.")
            shown.add(getattr(bpy.ops.vir, name).get_rna_type().description)
        elif issubclass(registered, bpy.types.Panel):
            shown.add(registered.bl_label)
    shown -= NAMES_OF_THINGS | BLENDERS_OWN | {""}
    return {("*", text) for text in shown} | {("Operator", text) for text in operators}


@pytest.fixture
def registered():
    blender.register()
    yield
    blender.unregister()


@pytest.mark.parametrize("locale", translations.TRANSLATIONS)
def test_what_is_read_has_translations(registered, locale):
    wanted, there = texts(), set(translations.TRANSLATIONS[locale])
    assert len(wanted) > 100
    assert len(wanted - there) <= (1 - SHARE) * len(wanted), sorted(wanted - there)
    assert not there - wanted, "translations of what is not shown: a label was renamed, or it is gone"


def test_blender_finds_them_while_the_extension_is_enabled():
    if not bpy.app.build_options.international:
        pytest.skip("this Blender speaks English only; tests/real_blender asks one that does not")
    view = bpy.context.preferences.view
    before = view.language
    view.language, view.use_translate_interface, view.use_translate_tooltips = "de_DE", True, True
    look_up = bpy.app.translations.pgettext_iface
    try:
        assert bpy.app.translations.locale == "de_DE"
        blender.register()
        assert look_up("Render Passes", "Operator") == "Pässe rendern" and look_up("Soft Shadows") == "Weiche Schatten"
        blender.unregister()
        assert look_up("Render Passes", "Operator") == "Render Passes"
    finally:
        view.language = before
