"""What the artist sets, kept in the .blend: groups named `vir` on scenes, lights and objects.

`settings_of` is the only way from here to the core. Defaults are those of `core.settings.Settings`. Enumerations are stored in files as
their numbers, so a number that is once given keeps its meaning. A group that holds anything is stamped with VERSION when its file is
saved, and brought up to date when it is opened, appended or linked.
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from ..core.errors import UsageError
from ..core.quality import map_resolution_of_views, quality_of_views, views_of_quality
from ..core.settings import (
    MAX_BOUNCES,
    MAX_TAPS,
    Effect,
    Method,
    PointGeneration,
    PointStorage,
    ReflectionLookUp,
    ReflectionMethod,
    Resolve,
    Settings,
)
from .object_names import mean_anew, shown_name, write_names

VERSION = 1
"""of the groups; raised together with a new entry in MIGRATIONS"""

MIGRATIONS: dict[int, Callable[[bpy.types.PropertyGroup], None]] = {}
"""version n -> what makes a group of version n one of version n + 1; old names are found in `stored_values`"""

OBJECT_NAMES = ("active_light", "active_reflector", "preview_light")
"""properties of scenes that name objects"""

REFLECTOR_PROPERTY = "vir_reflector"
"""custom property of objects: 0 never a reflector, 1 always; missing: materials decide"""

_DEFAULTS = Settings()

_METHODS = (
    (Method.AUTO, "Automatic", "For every light what is predicted to be fastest", 0),
    (Method.MICRO, "Micro", "Rasterize small triangles in a kernel: fastest with many triangles", 1),
    (Method.MVR, "MVR", "Rasterize the scene for every view: fastest with few large triangles", 2),
    (Method.IVIR, "IVIR", "Splat one cloud of points into every view", 3),
    (Method.HYBRID, "Hybrid", "Points of small triangles, large triangles rasterized", 4),
    (Method.VIR, "VIR", "Points as first published, to compare with. Not for suns", 5),
    (Method.VWSS, "VWSS", "Warp one view from behind the light, to compare with. Area lights only; not with the device Blender", 6),
    (Method.EPR, "EPR", "Points as fine as the picture needs them. Point lights and spots only", 7),
    (Method.PCSS, "PCSS", "One filtered map for each light: quick, and wrong where blockers are close", 8),
)
_POINTS = (
    (PointStorage.BUFFERED, "Kept", "Points are made once and kept for all views", 0),
    (PointStorage.BUFFERLESS, "Made Anew", "Points are made again for every batch of views, which takes less memory", 1),
)
_POINT_GENERATIONS = (
    (PointGeneration.COMPUTE, "Kernels", "Compute kernels make the points", 0),
    (PointGeneration.RASTERIZER, "Rasterizer", "Geometry shader and rasterizer, as published. Not with the device Blender", 1),
)
_RESOLVES = (
    (Resolve.AUTO, "Automatic", "Full on a GPU, adaptive on a software rasterizer: whichever is faster", 2),
    (Resolve.ADAPTIVE, "Adaptive", "Parts of the picture that are wholly lit or dark are only probed. Error below 0.002", 0),
    (Resolve.FULL, "Full", "Every pixel is looked up in every view", 1),
)
_REFLECTION_METHODS = (
    (ReflectionMethod.AUTO, "Automatic", "Whichever is quicker in the scene", 0),
    (ReflectionMethod.MVR, "Multiview (mvr)", "The rasterizer draws the scene for every face of every reflector's cube", 1),
    (ReflectionMethod.IVIR, "Points (ivir)", "One cloud of points for all cubes, as dense as the nearest of them needs", 2),
    (ReflectionMethod.EPR, "Eye-based Points (epr)", "One cloud of splats for all cubes, no denser than the picture shows", 3),
)
_LOOK_UPS = (
    (ReflectionLookUp.MARCH, "March", "Rays are followed through the depths of a reflector's map: things are where they belong", 0),
    (ReflectionLookUp.DIRECTION, "Direction", "As if all were infinitely far away, as published: things slide. To compare with", 1),
)


def _items(choices: tuple[tuple[Any, str, str, int], ...]) -> tuple[tuple[str, str, str, int], ...]:
    return tuple((choice.value.upper(), label, tooltip, number) for choice, label, tooltip, number in choices)


def _redraw_viewports(_: Any, context: bpy.types.Context) -> None:
    """The preview looks at its settings whenever a viewport is drawn."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _get_quality(group: VIR_SceneSettings) -> float:
    return quality_of_views(group.view_count)


def _set_quality(group: VIR_SceneSettings, quality: float) -> None:
    group.view_count = views_of_quality(quality)
    group.map_resolution_px = map_resolution_of_views(group.view_count)


def _row_of(group: VIR_SceneSettings, property_name: str) -> int:
    return group.id_data.objects.find(shown_name(group, property_name))


def _name_row(group: VIR_SceneSettings, property_name: str, index: int) -> None:
    objects = group.id_data.objects
    setattr(group, property_name, objects[index].name if 0 <= index < len(objects) else "")


def _get_active_light(group: VIR_SceneSettings) -> int:
    return _row_of(group, "active_light")


def _set_active_light(group: VIR_SceneSettings, index: int) -> None:
    _name_row(group, "active_light", index)


def _get_active_reflector(group: VIR_SceneSettings) -> int:
    return _row_of(group, "active_reflector")


def _set_active_reflector(group: VIR_SceneSettings, index: int) -> None:
    _name_row(group, "active_reflector", index)


def _get_preview_light(group: VIR_SceneSettings) -> str:
    return shown_name(group, "preview_light")


def _set_preview_light(group: VIR_SceneSettings, name: str) -> None:
    group.preview_light = name


def _mean_active_light(group: VIR_SceneSettings, _context: Any) -> None:
    mean_anew(group, "active_light")


def _mean_active_reflector(group: VIR_SceneSettings, _context: Any) -> None:
    mean_anew(group, "active_reflector")


def _mean_preview_light(group: VIR_SceneSettings, context: bpy.types.Context) -> None:
    mean_anew(group, "preview_light")
    _redraw_viewports(group, context)


def _light_names(group: VIR_SceneSettings, _context: Any, typed: str) -> list[str]:
    return [item.name for item in group.id_data.objects if item.type == "LIGHT" and typed.casefold() in item.name.casefold()]


def _lock_interface(group: VIR_SceneSettings, context: bpy.types.Context) -> None:
    # Blender asks for it where handlers change what it may be drawing at that moment
    if group.use_on_render:
        group.id_data.render.use_lock_interface = True


class VIR_SceneSettings(bpy.types.PropertyGroup):
    """bpy.types.Scene.vir"""

    version: bpy.props.IntProperty(
        name="Settings Version", description="The version of VIR that last saved these settings", options={"HIDDEN"}
    )

    use_on_render: bpy.props.BoolProperty(
        name="Render with F12",
        description="Make the passes of every frame that Blender renders, before its compositor runs. Switches Lock Interface on",
        default=False,
        update=_lock_interface,
    )
    use_soft_shadows: bpy.props.BoolProperty(
        name="Soft Shadows", description="One shadow pass for each area light and sun", default=_DEFAULTS.soft_shadows
    )
    use_omni_shadows: bpy.props.BoolProperty(
        name="Omni Shadows", description="One shadow pass for each point light and spot", default=_DEFAULTS.omni_shadows
    )
    use_reflections: bpy.props.BoolProperty(
        name="Reflections",
        description="What mirroring surfaces show, and the colour that it is multiplied by",
        default=Effect.REFLECTION in _DEFAULTS.effects,
    )
    device: bpy.props.EnumProperty(
        name="Device",
        description="What computes the passes",
        items=(
            ("AUTO", "Automatic", "OpenGL where it can be had, otherwise Blender's own graphics", 0),
            ("MODERNGL", "OpenGL", "OpenGL 4.3 in a context of its own. Not on macOS", 1),
            ("GPU", "Blender", "Blender's own graphics module. Needs Blender 5.2", 2),
        ),
        default="AUTO",
    )

    quality: bpy.props.FloatProperty(
        name="Quality",
        description="From fast to exact: sets the number of views and the resolution of maps. Twice the views take about twice the time",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        get=_get_quality,
        set=_set_quality,
    )
    view_count: bpy.props.IntProperty(
        name="Views",
        description="Places on each light with a size that it is looked from. Noise and banding fall with their number",
        default=_DEFAULTS.view_count,
        min=1,
        max=4096,
        soft_min=8,
        soft_max=512,
    )
    map_resolution_px: bpy.props.IntProperty(
        name="Map Resolution",
        description="Width and height of depth maps. Finer maps keep contacts and thin things",
        subtype="PIXEL",
        default=_DEFAULTS.map_resolution_px,
        min=16,
        max=8192,
    )
    method: bpy.props.EnumProperty(
        name="Method", description="How depth maps are made", items=_items(_METHODS), default=_DEFAULTS.method.value.upper()
    )
    resolve: bpy.props.EnumProperty(
        name="Look-ups",
        description="How often pixels are looked up in depth maps",
        items=_items(_RESOLVES),
        default=_DEFAULTS.resolve.value.upper(),
    )
    points: bpy.props.EnumProperty(
        name="Points",
        description="Whether points are kept between batches of views: IVIR, Hybrid, VWSS and EPR",
        items=_items(_POINTS),
        default=_DEFAULTS.points.value.upper(),
    )
    point_generation: bpy.props.EnumProperty(
        name="Made by",
        description="What makes points: IVIR",
        items=_items(_POINT_GENERATIONS),
        default=_DEFAULTS.point_generation.value.upper(),
    )
    stochastic_culling: bpy.props.BoolProperty(
        name="Cull at Random",
        description="Leave out triangles far smaller than a texel at random: IVIR, Hybrid and EPR",
        default=_DEFAULTS.stochastic_culling,
    )
    culling_area_texels: bpy.props.FloatProperty(
        name="Below",
        description="Triangles of a smaller area, in texels, are culled at random",
        default=_DEFAULTS.culling_area_texels,
        min=0.001,
        max=1.0,
    )
    cull_hidden: bpy.props.BoolProperty(
        name="Leave Out Hidden",
        description="After the first batch of views, leave out what none of them is near to seeing",
        default=_DEFAULTS.cull_hidden,
    )
    watertight: bpy.props.BoolProperty(
        name="Watertight",
        description="Points so dense that no texel stays empty, instead of the published one for each pixel's area",
        default=_DEFAULTS.watertight,
    )
    small_triangle_points: bpy.props.IntProperty(
        name="Points per Triangle",
        description="Triangles that take more points are rasterized: Hybrid",
        default=_DEFAULTS.small_triangle_points,
        min=0,
        max=32,
    )
    back_faces: bpy.props.BoolProperty(name="Back Faces", description="Points of back faces as well: VWSS", default=_DEFAULTS.back_faces)
    views_per_thread: bpy.props.IntProperty(
        name="Views per Thread",
        description="Maps that one thread writes a point into: VWSS",
        default=_DEFAULTS.views_per_thread,
        min=1,
        max=8,
    )
    blocker_sample_count: bpy.props.IntProperty(
        name="Search Samples",
        description="Samples of the map that search for blockers: PCSS",
        default=_DEFAULTS.blocker_sample_count,
        min=1,
        max=MAX_TAPS,
    )
    filter_sample_count: bpy.props.IntProperty(
        name="Filter Samples",
        description="Samples of the filter that makes the penumbra: PCSS",
        default=_DEFAULTS.filter_sample_count,
        min=1,
        max=MAX_TAPS,
    )
    replay_buffer_mib: bpy.props.IntProperty(
        name="Memory",
        description="MiB for what views share: points, small triangles. What does not fit is made again for every batch of views",
        default=_DEFAULTS.replay_buffer_mib,
        min=1,
        soft_max=4096,
    )

    bounces: bpy.props.IntProperty(
        name="Bounces",
        description="How often light is followed from reflector to reflector. 0: as often as the scene calls for, at most twice",
        default=_DEFAULTS.bounces or 0,
        min=0,
        max=MAX_BOUNCES,
    )
    reflection_method: bpy.props.EnumProperty(
        name="Cubes",
        description="How cubes of what reflectors show are made",
        items=_items(_REFLECTION_METHODS),
        default=_DEFAULTS.reflection_method.value.upper(),
    )
    planar: bpy.props.BoolProperty(
        name="Flat Mirrors Exactly",
        description="One mirrored view for each flat reflector, exact and cheap. Off: cubes as all others have, to compare with",
        default=_DEFAULTS.planar,
    )
    points_per_eye_pixel: bpy.props.FloatProperty(
        name="Points per Pixel",
        description="Of eye-based points: fewer of them are larger splats",
        default=_DEFAULTS.points_per_eye_pixel,
        min=0.01,
        max=4.0,
    )
    reflection_look_up: bpy.props.EnumProperty(
        name="Look-up",
        description="How reflectors' maps are looked up",
        items=_items(_LOOK_UPS),
        default=_DEFAULTS.reflection_look_up.value.upper(),
    )
    per_reflector: bpy.props.BoolProperty(
        name="Passes per Reflector",
        description="A pair of reflection passes of each reflecting object besides",
        default=_DEFAULTS.per_reflector,
    )
    reflection_map_mib: bpy.props.IntProperty(
        name="Map Memory",
        description="MiB for the maps of all reflectors. Where they would take more they get smaller",
        default=_DEFAULTS.reflection_map_mib,
        min=1,
        soft_max=4096,
    )

    active_light: bpy.props.StringProperty(
        name="Active Light",
        description="The light whose details are shown: the name that its object had when it was chosen",
        options={"HIDDEN"},
        update=_mean_active_light,
    )
    active_light_meant: bpy.props.StringProperty(
        name="Meant", description="The object that is meant, also once it is called otherwise", options={"HIDDEN"}
    )
    active_light_index: bpy.props.IntProperty(
        name="Active Light",
        description="Row of the list of lights: the index of its object in the scene",
        options={"HIDDEN"},
        get=_get_active_light,
        set=_set_active_light,
    )

    active_reflector: bpy.props.StringProperty(
        name="Active Reflector",
        description="The reflector whose details are shown: the name that its object had when it was chosen",
        options={"HIDDEN"},
        update=_mean_active_reflector,
    )
    active_reflector_meant: bpy.props.StringProperty(
        name="Meant", description="The object that is meant, also once it is called otherwise", options={"HIDDEN"}
    )
    active_reflector_index: bpy.props.IntProperty(
        name="Active Reflector",
        description="Row of the list of reflectors: the index of its object in the scene",
        options={"HIDDEN"},
        get=_get_active_reflector,
        set=_set_active_reflector,
    )

    use_preview: bpy.props.BoolProperty(
        name="Preview",
        description="Show the passes over the 3D viewport and refine them while nothing moves",
        default=False,
        update=_redraw_viewports,
    )
    preview_display: bpy.props.EnumProperty(
        name="Display",
        description="How the preview shows its passes",
        items=(
            ("MULTIPLY", "Blended", "Darken the viewport where there is shadow, and add the light that reflectors add", 0),
            ("PASS", "Pass", "The pass itself: of shadows, white is lit and black is shadow", 1),
            ("DIFFERENCE", "Difference", "What changes make of the first complete picture of a view: orange is lighter, blue darker", 2),
        ),
        default="MULTIPLY",
        update=_redraw_viewports,
    )
    preview_pass: bpy.props.EnumProperty(
        name="Pass",
        description="Which passes the preview shows, of the effects that are switched on",
        items=(
            ("ALL", "All", "Shadows, and the light that reflectors add", 0),
            ("SHADOW", "Shadows", "Of all lights, or of the one that is chosen", 1),
            ("REFLECTION", "Reflection", "What reflectors show", 2),
            ("REFLECTION_COLOR", "Reflection Color", "What the reflection is multiplied by", 3),
            ("REFLECTED", "Reflected Light", "What reflectors add to the picture: the former two multiplied", 4),
        ),
        default="ALL",
        update=_redraw_viewports,
    )
    preview_light: bpy.props.StringProperty(
        name="Light",
        description="The name that the light had when it was chosen whose shadows the preview shows. Empty: those of all lights together",
        options={"HIDDEN"},
        update=_mean_preview_light,
    )
    preview_light_meant: bpy.props.StringProperty(
        name="Meant", description="The object that is meant, also once it is called otherwise", options={"HIDDEN"}
    )
    preview_light_now: bpy.props.StringProperty(
        name="Light",
        description="The light whose shadows the preview shows. Empty: those of all lights together",
        search=_light_names,
        get=_get_preview_light,
        set=_set_preview_light,
    )
    preview_slice_ms: bpy.props.FloatProperty(
        name="Time Slice",
        description="Milliseconds that the preview may take from Blender at a time. If not set, 30 on a GPU and 300 without one",
        default=30.0,
        min=5.0,
        max=2000.0,
        precision=0,
    )


class VIR_LightSettings(bpy.types.PropertyGroup):
    """bpy.types.Light.vir"""

    version: bpy.props.IntProperty(
        name="Settings Version", description="The version of VIR that last saved these settings", options={"HIDDEN"}
    )
    use_pass: bpy.props.BoolProperty(
        name="Shadow Pass", description="Make a shadow pass of this light. Without, its pass is white", default=True
    )
    use_own_views: bpy.props.BoolProperty(
        name="Own Views", description="Give this light a number of views of its own instead of the scene's", default=False
    )
    view_count: bpy.props.IntProperty(
        name="Views",
        description="Places on this light that it is looked from, instead of the scene's number",
        default=_DEFAULTS.view_count,
        min=1,
        max=4096,
        soft_min=8,
        soft_max=512,
    )


_REFLECTOR_ITEMS = (
    ("AUTO", "Automatic", "Its materials decide", 0),
    ("NEVER", "Never", "Not a reflector, whatever its materials are", 1),
    ("ALWAYS", "Always", "A reflector, whatever its materials are", 2),
)


def reflector_mark(item: bpy.types.Object) -> int:
    """1 a reflector, 0 none, -1 what the materials say. Anything but a number is not of the artist's making and says nothing."""
    mark = item.get(REFLECTOR_PROPERTY)
    return int(mark != 0) if isinstance(mark, (int, float)) else -1


def _get_reflector(group: VIR_ObjectSettings) -> int:
    return reflector_mark(group.id_data) + 1


def _set_reflector(group: VIR_ObjectSettings, number: int) -> None:
    # a custom property, so that files keep it and are read right where the extension is not installed
    if number == 0:
        group.id_data.pop(REFLECTOR_PROPERTY, None)
    else:
        group.id_data[REFLECTOR_PROPERTY] = number - 1


class VIR_ObjectSettings(bpy.types.PropertyGroup):
    """bpy.types.Object.vir"""

    reflector: bpy.props.EnumProperty(
        name="Reflector",
        description="Whether this object reflects others",
        items=_REFLECTOR_ITEMS,
        get=_get_reflector,
        set=_set_reflector,
    )
    meant: bpy.props.StringProperty(
        name="Meant", description="How settings of scenes that name this object find it, and their copies its copy", options={"HIDDEN"}
    )


CLASSES = (VIR_SceneSettings, VIR_LightSettings, VIR_ObjectSettings)
_OWNERS: dict[Any, type] = {bpy.types.Scene: VIR_SceneSettings, bpy.types.Light: VIR_LightSettings, bpy.types.Object: VIR_ObjectSettings}


def register() -> None:
    """All of it or, where a class is refused, nothing."""
    with contextlib.ExitStack() as undone:
        for group_class in CLASSES:
            bpy.utils.register_class(group_class)
            undone.callback(bpy.utils.unregister_class, group_class)
        undone.pop_all()
    for owner, owned_class in _OWNERS.items():
        owner.vir = bpy.props.PointerProperty(type=owned_class, name="VIR", description="Settings of VIR's passes")
    bpy.app.handlers.load_post.append(_bring_up_to_date)
    bpy.app.handlers.blend_import_post.append(_bring_up_to_date)
    bpy.app.handlers.save_pre.append(_stamp)


def unregister() -> None:
    bpy.app.handlers.save_pre.remove(_stamp)
    bpy.app.handlers.blend_import_post.remove(_bring_up_to_date)
    bpy.app.handlers.load_post.remove(_bring_up_to_date)
    for owner in reversed(_OWNERS):
        del owner.vir
    for group_class in reversed(CLASSES):
        bpy.utils.unregister_class(group_class)


def settings_of(scene: bpy.types.Scene) -> Settings:
    """What the core is asked for. Raises UsageError where nothing is asked for, in words for the panel.

    Options of methods other than the chosen one, which the panel does not show, say nothing.
    """
    group = scene.vir
    method = Method(group.method.lower())
    chosen = {Effect.SHADOW: group.use_soft_shadows or group.use_omni_shadows, Effect.REFLECTION: group.use_reflections}
    if not any(chosen.values()):
        raise UsageError("all effects are switched off: switch Soft Shadows, Omni Shadows or Reflections on under Effects")
    return Settings(
        effects=tuple(effect for effect, is_wanted in chosen.items() if is_wanted),
        method=method,
        points=PointStorage(group.points.lower()) if method.may_be_bufferless else _DEFAULTS.points,
        point_generation=PointGeneration(group.point_generation.lower()) if method is Method.IVIR else _DEFAULTS.point_generation,
        view_count=group.view_count,
        map_resolution_px=group.map_resolution_px,
        soft_shadows=group.use_soft_shadows,
        omni_shadows=group.use_omni_shadows,
        stochastic_culling=group.stochastic_culling,
        culling_area_texels=round(group.culling_area_texels, 6),  # Blender holds float32
        resolve=Resolve(group.resolve.lower()),
        cull_hidden=group.cull_hidden,
        watertight=group.watertight,
        small_triangle_points=group.small_triangle_points,
        back_faces=group.back_faces,
        views_per_thread=group.views_per_thread,
        blocker_sample_count=group.blocker_sample_count,
        filter_sample_count=group.filter_sample_count,
        replay_buffer_mib=group.replay_buffer_mib,
        bounces=group.bounces or None,
        reflection_method=ReflectionMethod(group.reflection_method.lower()),
        planar=group.planar,
        points_per_eye_pixel=group.points_per_eye_pixel,
        reflection_look_up=ReflectionLookUp(group.reflection_look_up.lower()),
        per_reflector=group.per_reflector,
        reflection_map_mib=group.reflection_map_mib,
    )


def is_newer(group: bpy.types.PropertyGroup) -> bool:
    """Whether a later version of VIR has saved the group: what it means may not be understood here."""
    return bool(group.version > VERSION)


def stored_values(group: bpy.types.PropertyGroup) -> Any:
    """What the file holds of a group, by name, also under names that no property has any more. Empty for a group that was never set."""
    if bpy.app.version < (5, 0):
        return group
    held = group.bl_system_properties_get()
    return {} if held is None else held


def _versioned_groups() -> Iterator[bpy.types.PropertyGroup]:
    for owner in (*bpy.data.scenes, *bpy.data.lights):
        yield owner.vir


@bpy.app.handlers.persistent
def _bring_up_to_date(*_: Any) -> None:
    """After opening, appending and linking; also what is linked, which would be misread otherwise. Files on disk are not touched."""
    for group in _versioned_groups():
        # 0: holds nothing, or was set since the file was opened
        while 0 < group.version < VERSION:
            try:
                MIGRATIONS[group.version](group)
            except Exception:  # the other groups are still to come
                traceback.print_exc()
                break
            group.version += 1
    write_names([scene.vir for scene in bpy.data.scenes], OBJECT_NAMES)


@bpy.app.handlers.persistent
def _stamp(*_: Any) -> None:
    """Before saving. Groups that hold nothing stay that way: files without VIR are not touched by it."""
    write_names([scene.vir for scene in bpy.data.scenes], OBJECT_NAMES)
    for group in _versioned_groups():
        # others have their version: a newer one, or one that could not be brought up to date and is to be tried again
        is_unstamped = group.id_data.library is None and group.version == 0
        if is_unstamped and stored_values(group).keys():
            group.version = VERSION
