"""Blender's lights -> `core.scene.Light`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from ...core.material_program import LUMINANCE
from ...core.scene import Light, LightShape
from .camera import shear_of

_AREA_SHAPES = {
    "SQUARE": LightShape.RECTANGLE,
    "RECTANGLE": LightShape.RECTANGLE,
    "DISK": LightShape.ELLIPSE,
    "ELLIPSE": LightShape.ELLIPSE,
}
_LARGEST = 1e15
"""Of a light's numbers. Beyond it one is as good as infinite: products of a few no longer fit into single precision."""
_LARGEST_SHEAR = 1e-3
"""of a rectangle that is not worth a word"""
_OTHER_SHAPES = {"POINT": LightShape.POINT, "SPOT": LightShape.SPOT, "SUN": LightShape.SUN}


@dataclass
class LightRow:
    """A light as the depsgraph's iterator shows it, with all that must be read before the iterator moves on."""

    object_name: str
    instancer_name: str | None
    """the object that brings it in, for lights inside instances"""
    persistent_id: tuple[int, ...]
    world_from_object: np.ndarray
    """(4, 4) float64, Blender's world"""
    object_uid: int
    """session_uid of the original object, whose light linking counts"""
    shape: LightShape
    size_x_m: float
    size_y_m: float
    spread_rad: float
    strength_rgb: np.ndarray
    """(3,) float64"""
    casts_shadow: bool
    has_soft_falloff: bool
    cone_rad: float
    cone_blend: float
    is_wanted: bool
    own_view_count: int | None


def read_light(item: bpy.types.DepsgraphObjectInstance) -> LightRow:
    light_object = item.object
    data = light_object.data
    shape = _OTHER_SHAPES.get(data.type) or _AREA_SHAPES[data.shape]
    size_x_m, size_y_m = _read_sizes(data, shape)
    wishes: Any = getattr(data, "vir", None)  # there while the extension is enabled
    return LightRow(
        object_name=light_object.name,
        instancer_name=item.parent.name if item.is_instance else None,
        persistent_id=tuple(item.persistent_id) if item.is_instance else (),
        world_from_object=np.array(item.matrix_world, dtype=np.float64),
        object_uid=(item.instance_object if item.is_instance else light_object).original.session_uid,
        shape=shape,
        size_x_m=size_x_m,
        size_y_m=size_y_m,
        spread_rad=data.spread if shape.is_area else math.pi,
        strength_rgb=compute_strength(data, item.matrix_world),
        casts_shadow=data.use_shadow,
        has_soft_falloff=shape.is_omni and data.use_soft_falloff,
        cone_rad=data.spot_size if shape is LightShape.SPOT else 2.0 * math.pi,
        cone_blend=data.spot_blend if shape is LightShape.SPOT else 0.0,
        is_wanted=wishes is None or wishes.use_pass,
        own_view_count=wishes.view_count if wishes is not None and wishes.use_own_views else None,
    )


def _read_sizes(data: bpy.types.Light, shape: LightShape) -> tuple[float, float]:
    """Full widths before the object's scale. Spheres: the diameter. Suns: the diameter of the disc at a distance of 1 m."""
    if shape.is_area:
        return data.size, data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size
    if shape is LightShape.SUN:
        radius = math.tan(0.5 * min(data.angle, math.radians(179.0)))
        return 2.0 * radius, 2.0 * radius
    return 2.0 * data.shadow_soft_size, 2.0 * data.shadow_soft_size


def compute_strength(data: bpy.types.Light, matrix_world) -> np.ndarray:
    """(3,) float64, of linear Rec. 709: the factor that makes a mean over samples of the light an irradiance.

    With s(angle) = max(0, 1 - tan(angle) / tan(spread / 2)), which is 1 for a spread of pi, and d the distance in metres:

        area         irradiance = strength * mean(cos_receiver * cos_light * s / d^2)     strength = power / pi * (spread's gain)
        point, spot  irradiance = strength * mean(cos_receiver / d^2)                     strength = power / (4 pi)
        sun          irradiance = strength * mean(cos_receiver)                           strength = power

    An area light's radiance is power / (pi * area), and the integral over it is area * mean, so its area drops out. A narrower spread
    keeps the power and so is brighter ahead: the gain is tan(h) / (tan(h) - h), where h = spread / 2. Colour, temperature, exposure and
    a plain Emission node count. Without "Normalize" Blender multiplies the power by the area, and so does this.
    """
    color = np.array(data.color, dtype=np.float64)
    if data.use_temperature:
        color = color * np.array(data.temperature_color, dtype=np.float64)
    power = color * _emission_of_nodes(data) * data.energy * 2.0**data.exposure
    if not data.normalize:
        power = power * data.area(matrix_world=matrix_world)
    if data.type == "SUN":
        return power
    if data.type != "AREA":
        return power / (4.0 * math.pi)
    half_spread = 0.5 * data.spread
    if half_spread >= 0.5 * math.pi - 1e-6:
        return power / math.pi
    # x / (x - atan(x)) without the cancellation: tan(h) - h is about h^3 / 3 for small h.
    tan_half = math.tan(half_spread)
    excess = tan_half - half_spread if half_spread > 1e-2 else half_spread**3 / 3.0
    return power / math.pi * tan_half / max(excess, 1e-12)


def _emission_of_nodes(data: bpy.types.Light) -> np.ndarray:
    """(3,) colour times strength of an unlinked Emission node at the light's output; ones where there is none, or more than that."""
    # From 5.0 on lights always use their nodes, and asking warns of the property's removal.
    tree = data.node_tree if bpy.app.version >= (5, 0, 0) or data.use_nodes else None
    output = next((node for node in tree.nodes if node.type == "OUTPUT_LIGHT" and node.is_active_output), None) if tree else None
    if output is None or not output.inputs["Surface"].is_linked:
        return np.ones(3)
    emission = output.inputs["Surface"].links[0].from_node
    if emission.type != "EMISSION" or any(socket.is_linked for socket in emission.inputs):
        return np.ones(3)
    return np.array(emission.inputs["Color"].default_value[:3]) * emission.inputs["Strength"].default_value


class UnusableLight(Exception):  # noqa: N818  a reason, caught where lights are placed
    """The text says what is wrong with it."""


def place_light(row: LightRow, name: str, world_origin_m: np.ndarray) -> Light:
    """Raises UnusableLight."""
    numbers: dict[str, ArrayLike] = {
        "position or scale": row.world_from_object,
        "size or angle": (row.size_x_m, row.size_y_m, row.spread_rad, row.cone_rad, row.cone_blend),
        "strength or colour": row.strength_rgb,
    }
    for what, values in numbers.items():
        if not (np.abs(values) <= _LARGEST).all():
            raise UnusableLight(f"the light has a {what} that is not a finite number (or beyond 1e15)")
    placed = _orthonormal(row.world_from_object[:3, :3], is_flat=row.shape.is_area)
    if placed is None:
        raise UnusableLight("the light has a scale of zero")
    axes, width_factor, height_factor = placed
    world_from_light = np.eye(4)
    world_from_light[:3, :3] = axes
    world_from_light[:3, 3] = row.world_from_object[:3, 3] - world_origin_m
    # The radius of points, spots and suns is not scaled with the object in Blender.
    scale_x, scale_y = (width_factor, height_factor) if row.shape.is_area else (1.0, 1.0)
    size_x_m, size_y_m = row.size_x_m * scale_x, row.size_y_m * scale_y
    disc_turn_rad = 0.0
    if row.shape is LightShape.ELLIPSE and _is_sheared(row):
        world_from_light[:3, :3], size_x_m, size_y_m, disc_turn_rad = _principal_axes(axes, row)
    return Light(
        name=name,
        shape=row.shape,
        world_from_light=world_from_light,
        size_x_m=size_x_m,
        size_y_m=size_y_m,
        spread_rad=row.spread_rad,
        strength=float(np.array(LUMINANCE) @ row.strength_rgb),
        strength_rgb=tuple(row.strength_rgb.tolist()),
        casts_shadow=row.casts_shadow,
        has_soft_falloff=row.has_soft_falloff,
        cone_rad=row.cone_rad,
        cone_blend=row.cone_blend,
        cone_scale=_cone_scale(row),
        disc_turn_rad=disc_turn_rad,
        is_wanted=row.is_wanted,
        own_view_count=row.own_view_count,
    )


def notes_on_lights(rows: list[LightRow]) -> list[str]:
    """On area lights that are no rectangles along their axes any more. Nor does Cycles, as of 5.2, draw places on one evenly: its picture
    is that of a light elsewhere. An ellipse stays one."""
    return [
        f"The light '{name}' is sheared, as by a parent that is scaled unevenly; it is taken without the shear, with its width and area."
        for name, row in name_lights(rows)
        if row.shape is LightShape.RECTANGLE and np.isfinite(row.world_from_object).all() and _is_sheared(row)
    ]


def _is_sheared(row: LightRow) -> bool:
    return shear_of(row.world_from_object[:3, :2]) > _LARGEST_SHEAR


def _principal_axes(axes: np.ndarray, row: LightRow) -> tuple[np.ndarray, float, float, float]:
    """(3, 3) axes of a light, in the plane of these, along which a sheared ellipse is longest and shortest, how long it is there, and how
    far its samples turn (`Light.disc_turn_rad`).

    Its x axis is the one nearest to that of the light: which of them is longest, and which end of it is which, may change between two
    frames. Where the shear turns an ellipse by more than 45 degrees the nearest is the next one; samples stay where they are.
    """
    diameters = axes[:, :2].T @ row.world_from_object[:3, :2] * [row.size_x_m, row.size_y_m]
    # a mirrored light has its samples where it would have them without shear: along its own axes, which are not mirrored
    diameters[:, 1] *= -1.0 if np.linalg.det(diameters) < 0.0 else 1.0
    directions, lengths, turned = np.linalg.svd(diameters)
    along, across = (0, 1) if abs(directions[0, 0]) >= abs(directions[0, 1]) else (1, 0)
    sign = math.copysign(1.0, directions[0, along])
    x, z = axes[:, :2] @ directions[:, along] * sign, axes[:, 2]
    turn_rad = math.atan2(-sign * turned[along, 1], sign * turned[along, 0])
    return np.stack([x, np.cross(z, x), z], axis=1), float(lengths[along]), float(lengths[across]), turn_rad


def _cone_scale(row: LightRow) -> tuple[float, float]:
    """A spot's cone is scaled with its object: twice as wide along x where x is scaled twice as much as z."""
    scale = np.linalg.norm(row.world_from_object[:3, :3], axis=0)
    if row.shape is not LightShape.SPOT or not scale.all():
        return 1.0, 1.0
    return float(scale[0] / scale[2]), float(scale[1] / scale[2])


def _orthonormal(axes: np.ndarray, is_flat: bool) -> tuple[np.ndarray, float, float] | None:
    """(3, 3) right-handed axes of a light, and the factors for its width and height. None: degenerate.

    An area light keeps the plane that its x and y axes span, its x axis and, under shear, its area; it shines to the side to which the
    object's -z points. Other lights keep -z.
    """
    x_axis, y_axis, z_axis = axes.T
    width_factor = float(np.linalg.norm(x_axis))
    normal = np.cross(x_axis, y_axis)
    area_factor = float(np.linalg.norm(normal))
    if is_flat:
        if width_factor == 0.0 or area_factor <= 1e-7 * width_factor * float(np.linalg.norm(y_axis)):
            return None
        x = x_axis / width_factor
        z = normal / area_factor * (-1.0 if normal @ z_axis < 0.0 else 1.0)
        return np.stack([x, np.cross(z, x), z], axis=1), width_factor, area_factor / width_factor
    if np.linalg.norm(z_axis) == 0.0:
        z_axis = normal if area_factor > 0.0 else np.array([0.0, 0.0, 1.0])
    z = z_axis / np.linalg.norm(z_axis)
    x = x_axis - z * (x_axis @ z)
    if np.linalg.norm(x) <= 1e-6 * width_factor:
        # Any direction across will do: these lights are round, and a scale of zero leaves no x axis.
        across = np.eye(3)[np.argmin(np.abs(z))]
        x = across - z * (across @ z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1), 1.0, 1.0


def name_lights(rows: list[LightRow]) -> list[tuple[str, LightRow]]:
    """Unique names that do not depend on the order of the rows, sorted by name.

    A light of its own keeps its name, one inside an instance is called "Key (Instancer)"; further ones of the same name, in the order of
    their persistent ids, "Key (Instancer) 2" and so on.
    """
    ordered = sorted(rows, key=lambda row: (_plain_name(row), row.persistent_id, row.world_from_object.tobytes()))
    used: set[str] = set()
    named = []
    for row in ordered:
        plain = name = _plain_name(row)
        count = 1
        while name in used:
            count += 1
            name = f"{plain} {count}"
        used.add(name)
        named.append((name, row))
    return sorted(named, key=lambda pair: pair[0])


def _plain_name(row: LightRow) -> str:
    return row.object_name if row.instancer_name is None else instanced_name(row.object_name, row.instancer_name)


def instanced_name(object_name: str, instancer_name: str) -> str:
    return f"{object_name} ({instancer_name})"
