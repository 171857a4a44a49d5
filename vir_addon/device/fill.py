"""Setting every texel of an unsigned texture: a triangle over the whole viewport.

Drawn where there is no clear for unsigned textures: clearing with a float colour is undefined for them, and a compute kernel
took twice as long.
"""

import numpy as np

from .declaration import Constant, RasterDeclaration

FILL = RasterDeclaration(
    name="fill",
    text="sets every texel to one value",
    vertex_source="fill.vert.glsl",
    fragment_source="fill.frag.glsl",
    constants={"value": Constant("int", "what every channel becomes; the bits count, not the sign")},
    output_name="filled",
    output_type="uvec4",
)
COVERING_TRIANGLE = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], np.float32)


def signed_bits(value: int) -> int:
    """The int of the same 32 bits: both backends take the value of an unsigned texture as a signed integer."""
    return value - (1 << 32) if value >> 31 else value
