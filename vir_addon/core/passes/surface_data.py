"""What surfaces look like, on the device: materials, what they ask for at triangles' corners, the world.

surface_data    the table of reflectance_table.py; the world: radiance and its image's place or -1, three rows of image_from_world;
                per instance its material set's first slot, last slot's number and its mesh's layer table; per material a header (its
                program's place or -1, its normal map's layer or -1, Fresnel of metal) and its constant inputs; per slot of a set its
                material's place; per mesh and layer where its values start, whether there are any and texels a triangle; programs
                (material_program.py); layers: two texels a triangle for uvs, three for colours
surface_images  see material_images.py
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...device.declaration import Sampled
from ...device.interface import Device, Texture, split_integers
from ...device.owned import Owned, Shared
from ..material import BLACK, Constant, ImageTexels, Layer, LayerKind, Material, World
from ..material_program import (
    LUMINANCE,
    MATERIAL_INPUTS,
    MAX_INSTRUCTIONS,
    OP_CODES,
    PAIRED_INPUTS,
    REGISTER_COUNT,
    OpCode,
    Program,
    compile_material,
    material_images,
    material_layers,
)
from ..reflectance_table import COSINE_COUNT, LARGEST_Z, LEAST_Z, ROUGHNESS_COUNT, TABLE_TEXELS, reflectance_table
from ..scene import SceneSnapshot
from .material_images import IMAGE_DEFINES, IMAGE_TEXTURES, pack_images

_WORLD_TEXELS = 4
_WORLD_BASE = ROUGHNESS_COUNT * COSINE_COUNT * TABLE_TEXELS
_INSTANCES_BASE = _WORLD_BASE + _WORLD_TEXELS
_UNCONDITIONAL = "OP_HSV_TO_RGB"
"""what no condition is left for"""

SURFACE_TEXTURES: Mapping[str, Sampled] = {
    "surface_data": Sampled("sampler2D", "reflectance table, world, materials and what they ask for at triangles' corners"),
    **IMAGE_TEXTURES,
}
REFLECTANCE_DEFINES = {
    "TABLE_TEXELS": TABLE_TEXELS,
    "ROUGHNESS_COUNT": ROUGHNESS_COUNT,
    "COSINE_COUNT": COSINE_COUNT,
    "LEAST_Z": LEAST_Z,
    "LARGEST_Z": LARGEST_Z,
}
LUMINANCE_DEFINES = dict(zip(("LUMINANCE_RED", "LUMINANCE_GREEN", "LUMINANCE_BLUE"), LUMINANCE, strict=True))
SURFACE_FLAGS = {
    "PROGRAMS": "inputs of some material are not constant",
    "COATS": "some material has a coat",
    "NORMAL_MAPS": "some material has a normal map",
}
"""Without programs kernels are compiled in less than half of the time, without the others in a tenth less."""
WORLD_FLAGS = {"WORLD_IMAGE": "the sky has an image"}
"""Without, kernels that look the sky up are compiled in a tenth to a fifth less time."""
SURFACE_DEFINES: Mapping[str, int | float] = {
    **IMAGE_DEFINES,
    **{
        name: value
        for name, value in (
            *((f"OP_{code.name}", int(code)) for code in OpCode if code is not OpCode.FIRST_OPERATION),
            *((f"OP_{operation.name}", code) for operation, code in OP_CODES.items()),
        )
        if name != _UNCONDITIONAL
    },
    **{f"INPUT_{name}": index for index, name in enumerate(MATERIAL_INPUTS)},
    **LUMINANCE_DEFINES,
    "PAIRED_INPUTS": PAIRED_INPUTS,
    "REGISTERS": REGISTER_COUNT,
    "MAX_INSTRUCTIONS": MAX_INSTRUCTIONS,
    "WORLD_BASE": _WORLD_BASE,
    "INSTANCES_BASE": _INSTANCES_BASE,
}


class SurfaceRows(NamedTuple):
    """What the textures of surfaces hold, (n, 4) float32 each, and what is in them."""

    data: np.ndarray
    images: np.ndarray
    flags: tuple[str, ...]
    """of kernels that ask for surfaces"""
    emission_flags: tuple[str, ...]
    """of those that only ask what surfaces emit"""
    world_flags: tuple[str, ...]
    """of those that ask for the world"""
    has_emission: bool
    """some surface shines"""


def pack_surfaces(snapshot: SceneSnapshot) -> SurfaceRows:
    """Work for the host alone, and most of an upload."""
    if snapshot.world is None or snapshot.instances.material_set is None:
        raise ValueError("the snapshot was taken without materials")
    materials, meshes = snapshot.materials, snapshot.meshes
    layers = sorted(set().union(*(material_layers(material) for material in materials)), key=lambda one: (one.kind.value, one.name))
    image_rows, image_bases = pack_images(_all_images(materials, snapshot.world))
    layer_index = {layer: index for index, layer in enumerate(layers)}
    programs = [compile_material(material, layer_index, image_bases) for material in materials]
    rows = _Rows()
    rows.add(reflectance_table().reshape(-1, 4))
    rows.add(_world_rows(snapshot.world, image_bases))
    instance_rows = np.zeros((len(snapshot.instances), 4))
    rows.add(instance_rows)
    material_rows = [_material_rows(material, program, layer_index) for material, program in zip(materials, programs, strict=True)]
    material_bases = np.array([rows.add(part) for part in material_rows], np.int64)
    set_bases = np.array([rows.add(_place_rows(material_bases[list(one)])) for one in snapshot.material_sets], np.int64)
    layer_tables = np.zeros((len(meshes), len(layers), 4))
    first_table = rows.add(layer_tables.reshape(-1, 4))
    instance_rows[:] = _instance_rows(snapshot, set_bases, first_table + len(layers) * np.arange(len(meshes)))
    for part, program in zip(material_rows, programs, strict=True):
        part[0, :2] = split_integers(np.array(rows.add(program.rows))) if len(program.rows) else -1.0
    for table, mesh in zip(layer_tables, meshes, strict=True):
        for layer, values in mesh.layers.items():
            if layer in layer_index:
                table[layer_index[layer]] = (
                    *split_integers(np.array(rows.add(_layer_rows(layer, values)))),
                    1.0,
                    _texels_per_triangle(layer),
                )
    has_programs = any(len(program.rows) for program in programs)
    shining = [material for material in materials if material.emission != BLACK]
    return SurfaceRows(
        rows.gather(),
        image_rows,
        flags=("PROGRAMS",) * has_programs + _part_flags(materials),
        # normals count under coats only
        emission_flags=("PROGRAMS",) * any(map(_has_computed_emission, shining))
        + _part_flags([replace(material, normal_map=material.normal_map if _has_coat(material) else None) for material in shining]),
        world_flags=("WORLD_IMAGE",) * (snapshot.world.image is not None),
        has_emission=bool(shining),
    )


class SurfaceData(Shared):
    """Uploads what a snapshot with materials says about surfaces."""

    def __init__(self, snapshot: SceneSnapshot, device: Device, rows: SurfaceRows | None = None) -> None:
        """rows: of this snapshot, if they are packed already"""
        self.snapshot = snapshot
        rows = pack_surfaces(snapshot) if rows is None else rows
        with Owned() as owned:
            self.bindings: dict[str, Texture] = {
                "surface_data": owned.own(device.upload_array(rows.data)),
                "surface_images": owned.own(device.upload_array(rows.images)),
            }
            self.flags, self.emission_flags, self.world_flags = rows.flags, rows.emission_flags, rows.world_flags
            self.has_emission = rows.has_emission
            self._owned = owned.pop_all()

    def _free(self) -> None:
        self._owned.close()


class _Rows:
    """Parts of one array, which know where they will stand before it is put together."""

    def __init__(self) -> None:
        self.end = 0
        self._parts: list[np.ndarray] = []

    def add(self, part: np.ndarray) -> int:
        """Where the part will stand. What it holds may still change."""
        base = self.end
        self._parts.append(part)
        self.end += len(part)
        return base

    def gather(self) -> np.ndarray:
        return np.concatenate(self._parts, dtype=np.float32)


def _has_coat(material: Material) -> bool:
    return material.coat_weight != BLACK


def _part_flags(materials: Sequence[Material]) -> tuple[str, ...]:
    return ("COATS",) * any(map(_has_coat, materials)) + ("NORMAL_MAPS",) * any(material.normal_map is not None for material in materials)


def _has_computed_emission(material: Material) -> bool:
    """Whether programs are needed for what one that shines emits, under its coat."""
    asked = [material.emission]
    if _has_coat(material):
        asked += [material.coat_weight, material.coat_roughness, material.coat_ior]
        asked += [material.normal_map.color, material.normal_map.strength] if material.normal_map else []
    return not all(isinstance(one, Constant) for one in asked)


def _all_images(materials: Iterable[Material], world: World) -> list[ImageTexels]:
    images = [image for material in materials for image in material_images(material)]
    return [world.image, *images] if world.image is not None else images


def _place_rows(places: np.ndarray) -> np.ndarray:
    return np.pad(split_integers(places), ((0, 0), (0, 2)))


def _texels_per_triangle(layer: Layer) -> int:
    return 2 if layer.kind is LayerKind.UV else 3


def _layer_rows(layer: Layer, values: np.ndarray) -> np.ndarray:
    if layer.kind is LayerKind.UV:
        return np.pad(values.reshape(-1, 6), ((0, 0), (0, 2))).reshape(-1, 4)
    return np.pad(values.reshape(-1, 3), ((0, 0), (0, 1)))


def _world_rows(world: World, image_bases: Mapping[ImageTexels, int]) -> np.ndarray:
    rows = np.zeros((_WORLD_TEXELS, 4))
    rows[0] = *world.radiance, -1.0
    if world.image is not None:
        # the first of the images, so its place is exact
        rows[0, 3] = image_bases[world.image]
        rows[1:, :3] = np.eye(3) if world.image_from_world is None else world.image_from_world
    return rows


def _instance_rows(snapshot: SceneSnapshot, set_bases: np.ndarray, layer_tables: np.ndarray) -> np.ndarray:
    instances = snapshot.instances
    assert instances.material_set is not None
    last_slot = np.array([len(one) - 1 for one in snapshot.material_sets])
    rows = np.zeros((len(instances), 4))
    rows[:, :2] = split_integers(set_bases[instances.material_set])
    rows[:, 2] = last_slot[instances.material_set]
    rows[:, 3] = layer_tables[instances.mesh_index]
    return rows


def _material_rows(material: Material, program: Program, layer_index: Mapping[Layer, int]) -> np.ndarray:
    """All but the program's place."""
    rows = np.zeros((2 + PAIRED_INPUTS // 2, 4))
    rows[0, 2] = layer_index[material.normal_map.layer] if material.normal_map else -1.0
    rows[0, 3] = material.has_metal_fresnel
    rows[1:-1, :3] = program.constants[:PAIRED_INPUTS:2]
    rows[1:-1, 3] = program.constants[1:PAIRED_INPUTS:2, 0]
    rows[-1, :3] = program.constants[PAIRED_INPUTS:, 0]
    return rows
