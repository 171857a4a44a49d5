"""What the panels show, drawn into a layout that knows what Blender's would accept: in background Blender draws none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import panels, properties  # noqa: E402
from vir_addon.blender.preview import interface  # noqa: E402

LAYOUT = bpy.types.UILayout.bl_rna


class Layout:
    """Notes what is drawn; refuses what this Blender does not know: functions, options, properties, operators, icons."""

    def __init__(self, drawn: list[tuple[str, str]]) -> None:
        object.__setattr__(self, "drawn", drawn)

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in LAYOUT.properties, f"layouts have no {name}"

    def __getattr__(self, name: str) -> Any:
        known = LAYOUT.functions[name].parameters

        def draw(*arguments: Any, **options: Any) -> Any:
            given = dict(zip([each.identifier for each in known if not each.is_output], arguments, strict=False)) | options
            assert given.keys() <= {each.identifier for each in known}, f"{name} has no {given.keys()}"
            if "icon" in given:
                assert given["icon"] in known["icon"].enum_items, given["icon"]
            self._note(name, given)
            return Layout(self.drawn)

        return draw

    def _note(self, name: str, given: dict[str, Any]) -> None:
        if name == "prop":
            assert given["property"] in given["data"].bl_rna.properties, given["property"]
            self.drawn.append(("prop", given["property"]))
        elif name == "operator":
            module, _, function = given["operator"].partition(".")
            assert getattr(getattr(bpy.ops, module), function).get_rna_type().description
            self.drawn.append(("operator", given["operator"]))
        elif name == "template_list":
            rows = getattr(bpy.types, given["listtype_name"])
            assert given["active_propname"] in given["active_dataptr"].bl_rna.properties
            shown, _ = rows.filter_items(FAKE_LIST, context(), given["dataptr"], given["propname"])
            for item, is_shown in zip(getattr(given["dataptr"], given["propname"]), shown, strict=True):
                if is_shown:
                    rows.draw_item(FAKE_LIST, context(), Layout(self.drawn), given["dataptr"], item, 0, None, "", 0)
        elif text := given.get("text"):
            self.drawn.append((name, text))


FAKE_LIST = SimpleNamespace(filter_name="", bitflag_filter_item=1)


def context(width_px: int = 420) -> SimpleNamespace:
    space = SimpleNamespace(overlay=SimpleNamespace(show_overlays=True))
    region = SimpleNamespace(width=width_px)
    return SimpleNamespace(
        scene=bpy.context.scene,
        view_layer=bpy.context.view_layer,
        object=bpy.context.view_layer.objects.active,
        preferences=SimpleNamespace(system=SimpleNamespace(ui_scale=1.0)),  # 0 in background
        region=region,
        space_data=space,
        window_manager=bpy.context.window_manager,
    )


def drawn_by(*drawers: Any) -> list[tuple[str, str]]:
    """Panels that show themselves, and functions, one after the other."""
    drawn: list[tuple[str, str]] = []
    for drawer in drawers:
        if isinstance(drawer, type):
            poll = getattr(drawer, "poll", None)
            if poll is not None and not poll(context()):
                continue
            for part in ("draw_header", "draw"):
                if hasattr(drawer, part):
                    getattr(drawer, part)(SimpleNamespace(layout=Layout(drawn)), context())
        else:
            drawer(SimpleNamespace(layout=Layout(drawn)), context())
    return drawn


def panels_in(kind: str) -> list[type]:
    return [panel for panel in panels.PANELS if panel.bl_space_type == kind]


@pytest.fixture
def room(scene, add):
    blender.register()
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 18, 100
    add.cube(location=(0.0, 0.0, 1.0))
    add.mesh("Floor", [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [(0, 1, 2, 3)])
    scene.camera.location, scene.camera.rotation_euler = (0.0, -10.0, 4.0), (1.2, 0.0, 0.0)
    add.light("Key", data={"size": 1.0, "energy": 500.0}, location=(2.0, -2.0, 5.0))
    add.light("Fill", data={"use_shadow": False}, location=(0.0, -4.0, 4.0))
    scene.vir.view_count, scene.vir.map_resolution_px, scene.vir.device = 4, 64, "MODERNGL"
    yield scene
    blender.unregister()


def texts(drawn: list[tuple[str, str]]) -> list[str]:
    return [text for kind, text in drawn if kind not in ("prop", "operator")]


def test_the_sidebar_and_the_render_properties_show_the_same(room):
    room.vir.use_reflections, room.vir.use_on_render = True, True
    for step in (lambda: None, bpy.ops.vir.plan, bpy.ops.vir.render):
        step()
        sidebar, render = (drawn_by(*panels_in(kind)) for kind in ("VIEW_3D", "PROPERTIES"))
        assert sidebar == render and len(sidebar) > 20


def test_a_light_is_followed_from_before_the_plan_to_its_pass(room):
    shown = texts(drawn_by(*panels_in("VIEW_3D")))
    assert shown.count("not planned yet") == 2 and {"Key", "Fill"} <= set(shown)
    bpy.ops.vir.plan()
    shown = texts(drawn_by(*panels_in("VIEW_3D")))
    assert any(text.startswith("4 views, ~") for text in shown) and any("casts no shadow" in text for text in shown)
    bpy.ops.vir.render()
    room.vir.active_light_index = room.objects.find("Key")
    drawn = drawn_by(*panels_in("VIEW_3D"))
    assert any(text.startswith("Made by") for text in texts(drawn)) and ("prop", "use_own_views") in drawn
    made = " ".join(texts(drawn)).partition("Made by")[2]
    room.objects["Key"].data.vir.use_own_views, room.objects["Key"].data.vir.view_count = True, 16
    bpy.ops.vir.plan()
    shown = texts(drawn_by(*panels_in("VIEW_3D")))
    assert any(text.startswith(("16 views, ~", "16, ~")) for text in shown)
    assert " ".join(shown).partition("Made by")[2] == made, "what was rendered stays what it was"


def test_every_setting_is_in_the_panel_for_some_method(room):
    room.vir.use_on_render = True
    shown: dict[bool, set[str]] = {False: set(), True: set()}
    for reflects, names in shown.items():
        room.vir.use_reflections = reflects
        for method in properties.VIR_SceneSettings.bl_rna.properties["method"].enum_items:
            room.vir.method = method.identifier
            names |= {name for kind, name in drawn_by(*panels_in("VIEW_3D"), interface.VIR_PT_preview) if kind == "prop"}
    settings = room.vir.bl_rna.properties.items()
    assert {name for name, setting in settings if not setting.is_hidden} - {"rna_type", "name"} <= shown[True]
    assert {"bounces", "reflection_method"} <= shown[True] - shown[False]


def test_the_preview_says_what_it_needs(room):
    room.vir.use_preview = True
    drawn = drawn_by(interface.VIR_PT_preview, interface._draw_in_header, interface._draw_in_overlays)
    assert ("prop", "use_preview") in drawn and ("operator", "vir.preview") in drawn
    assert ("The preview needs Blender 5.2" in texts(drawn)) == (bpy.app.version < (5, 2))
    with pytest.raises(RuntimeError, match="no viewport"):
        bpy.ops.vir.preview()


@pytest.mark.parametrize(("spoil", "words"), [("camera", "camera"), ("light", "no light"), ("surface", "no surface")])
def test_what_keeps_passes_from_being_made_stands_in_the_panel(room, spoil, words):
    if spoil == "camera":
        room.camera = None
    else:
        kind = "LIGHT" if spoil == "light" else "MESH"
        for item in [item for item in room.objects if item.type == kind]:
            bpy.data.objects.remove(item)
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.vir.render()
    assert words in " ".join(texts(drawn_by(*panels_in("VIEW_3D")))).casefold()


def test_a_reflectors_row_says_what_there_is_room_for(room):
    room.vir.use_reflections, room.objects["Cube"].vir.reflector = True, "ALWAYS"
    bpy.ops.vir.plan()
    rows = {}
    for width_px in (290, 3000):
        drawn: list[tuple[str, str]] = []
        panels.VIR_UL_reflectors.draw_item(FAKE_LIST, context(width_px), Layout(drawn), room, room.objects["Cube"], 0, None, "", 0)
        rows[width_px] = drawn[-1][1]
    method, colon, rest = rows[3000].partition(":")
    assert colon and "x" in rest and rows[290] == method
