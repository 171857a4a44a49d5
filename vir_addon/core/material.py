"""What surfaces look like, and the world around them, as plain data: what reflections are shaded with.

Colours are linear with Blender's default primaries (Rec. 709). All numbers of a material are colours of three channels here; a number has
the same value in each.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

Rgb: TypeAlias = tuple[float, float, float]
UvRows: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float]]
IDENTITY_UV_ROWS: UvRows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


class Extension(enum.Enum):
    """What an image is beyond its edges."""

    REPEAT = "repeat"
    MIRROR = "mirror"
    EXTEND = "extend"
    CLIP = "clip"
    """texels of value 0"""


class LayerKind(enum.Enum):
    UV = "uv"
    COLOR = "color"
    GENERATED = "generated"
    """from 0 to 1 over the mesh's box, before it was deformed"""


@dataclass(frozen=True)
class Layer:
    """Names values at the corners of triangles. A mesh without such a layer has zeros there."""

    kind: LayerKind
    name: str = ""
    """'': the one that Blender marks for rendering"""


@dataclass(frozen=True, eq=False)
class ImageTexels:
    """A picture as renderers interpolate it: values first, then what they encode."""

    name: str
    texels: np.ndarray
    """(height, width, 1, 3 or 4) uint8 or float32, row 0 at the bottom, v = 0; the fourth channel, if there, is alpha, and the others are
    multiplied with it"""
    is_srgb: bool = False
    """colours are sRGB-encoded"""


@dataclass(frozen=True)
class Constant:
    value: Rgb


@dataclass(frozen=True)
class ImageSample:
    """An image at a place given by a UV map."""

    image: ImageTexels
    layer: Layer = Layer(LayerKind.UV)
    uv_rows: UvRows = IDENTITY_UV_ROWS
    """place in the image, whose corners are (0, 0) and (1, 1) = uv_rows @ (u, v, 1)"""
    extension: Extension = Extension.REPEAT
    is_interpolated: bool = True
    """bilinearly between texels' centres; otherwise a texel is one value throughout"""
    is_alpha: bool = False
    """The value is the alpha of an image of four channels."""
    divides_by_alpha: bool = False
    """The colour of an image of four channels without the alpha that is multiplied into it."""


@dataclass(frozen=True)
class CornerValue:
    """Values of a layer, linear between a triangle's corners."""

    layer: Layer


class Operation(enum.Enum):
    """Channel by channel unless it says otherwise; a, b and c are the operands."""

    ADD = "a + b"
    SUBTRACT = "a - b"
    MULTIPLY = "a b"
    DIVIDE = "a / b, 0 where b is 0"
    POWER = "a to the power of b, 0 where that is not real"
    MINIMUM = "the smaller of a and b"
    MAXIMUM = "the larger of a and b"
    GREATER_THAN = "1 where a > b, otherwise 0"
    FLOOR = "the largest integer that is not above a"
    ABSOLUTE = "a without its sign"
    CLAMP = "a between 0 and 1"
    MIX = "a (1 - c) + b c"
    RED = "the red channel of a in all three"
    GREEN = "the green channel of a in all three"
    BLUE = "the blue channel of a in all three"
    LUMINANCE = "the luminance of a in all three"
    RGB_TO_HSV = "hue, saturation and value of the colour a"
    HSV_TO_RGB = "the colour whose hue, saturation and value are a"


@dataclass(frozen=True)
class Combination:
    operation: Operation
    operands: tuple[MaterialInput, ...]

    def __post_init__(self) -> None:
        # kept, as an operand that many share would be walked through again and again
        object.__setattr__(self, "_hash", hash((self.operation, self.operands)))

    def __hash__(self) -> int:
        return self._hash  # type: ignore[attr-defined]


@dataclass(frozen=True)
class TableLookup:
    """A curve or colour ramp: the operand's red channel chooses a place between the first and the last of a table's values."""

    operand: MaterialInput
    table: ImageTexels
    """(1, entry_count, 3) float32, linear between entries"""


MaterialInput: TypeAlias = Constant | ImageSample | CornerValue | Combination | TableLookup
"""A colour at every place of a surface, as an expression."""

BLACK, WHITE = Constant((0.0, 0.0, 0.0)), Constant((1.0, 1.0, 1.0))


@dataclass(frozen=True)
class NormalMap:
    """A normal in tangent space: x along u, y along v, z the shading normal."""

    color: MaterialInput
    """each component from -1 to 1 stands as 0 to 1"""
    strength: MaterialInput
    """0: the shading normal, 1: the map's"""
    layer: Layer = Layer(LayerKind.UV)
    """the UV map whose u and v these are"""


@dataclass(frozen=True, eq=False)
class Material:
    """A surface as a sum of lobes, which Blender's shaders and what mixes them come to.

    The reflection distribution is

        dielectric_weight D + metal_weight M + (1 - albedo of dielectric_weight D) diffuse / pi

    with D a GGX lobe under the Fresnel reflectance of `ior` times `specular_tint`, M one that reflects `metal` straight on; a clear coat
    lies over all of it. Emission is added, under the coat as well. Transmitted light has no part in it. Where several BSDFs are mixed,
    what they have one of (roughness, tints) is the mean by their shares.
    """

    name: str
    diffuse: MaterialInput = Constant((0.8, 0.8, 0.8))
    """albedo of the diffuse lobe"""
    dielectric_weight: MaterialInput = WHITE
    ior: MaterialInput = Constant((1.5, 1.5, 1.5))
    """index of refraction that gives the dielectric lobe its Fresnel reflectance"""
    specular_tint: MaterialInput = WHITE
    """colour of the dielectric lobe straight on; of the metallic one at 82 degrees, in relation to Schlick's curve (F82)"""
    metal_weight: MaterialInput = BLACK
    metal: MaterialInput = BLACK
    """reflectance of the metallic lobe straight on"""
    has_metal_fresnel: bool = True
    """False: the metallic lobe reflects `metal` in all directions (Glossy BSDF)"""
    roughness: MaterialInput = Constant((0.5, 0.5, 0.5))
    """of both lobes, as artists know it: the GGX width is its square"""
    coat_weight: MaterialInput = BLACK
    coat_roughness: MaterialInput = Constant((0.03, 0.03, 0.03))
    coat_ior: MaterialInput = Constant((1.5, 1.5, 1.5))
    emission: MaterialInput = BLACK
    """radiance"""
    normal_map: NormalMap | None = None
    is_fallback: bool = False
    """The nodes could not be read: this is the viewport's colour."""


@dataclass(frozen=True, eq=False)
class World:
    """What surrounds the scene."""

    radiance: Rgb = (0.0, 0.0, 0.0)
    """of every direction; a factor of the image where there is one"""
    image: ImageTexels | None = None
    """equirectangular: the direction (x, y, z) is at u = 0.5 - atan2(y, x) / 2 pi, v = 0.5 + asin(z) / pi"""
    image_from_world: np.ndarray | None = None
    """(3, 3) float64, turns a direction before it is looked up; with an image only"""
    is_fallback: bool = False
    """The nodes could not be read: this is the viewport's colour."""
