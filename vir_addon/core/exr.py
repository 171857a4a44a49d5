"""All passes of a frame in one multilayer EXR that Blender and compositing tools read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .. import __version__
from .errors import DeviceError, UsageError
from .files import whole_file
from .pass_set import PassSet, PassStatistics


def channel_name(view_layer_name: str, pass_name: str, channel: str = "V") -> str:
    """'View.Layer', 'VIR Shadow Key' -> 'View_Layer.VIR Shadow Key.V'. Readers split at dots, so the names' own dots go."""
    return f"{view_layer_name.replace('.', '_')}.{pass_name.replace('.', '_')}.{channel}"


def write_exr(target: Path, layers: Mapping[str, PassSet], *, scene_name: str, frame: int, pixel_aspect: float = 1.0) -> None:
    """Write every image of every view layer as a channel V, or R, G and B: 32-bit float, one part, ZIP; how each was made as attributes.

    layers: view layer name -> its passes. pixel_aspect: a pixel's width divided by its height, as Blender writes it into its own files

    Raises UsageError when `target` cannot be written, when there are no images or when two would share a channel, DeviceError when OpenEXR
    is not installed.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise DeviceError("writing EXR files needs the OpenEXR package: pip install OpenEXR==3.5.3") from error
    channels = _channels(layers)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "pixelAspectRatio": float(pixel_aspect),
        **_attributes(layers, scene_name, frame),
    }
    with whole_file(target) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:  # how the package reports a full disk
            raise OSError(str(error)) from error


def _channels(layers: Mapping[str, PassSet]) -> dict[str, np.ndarray]:
    """Channel name -> (height, width) float32 with row 0 at the top, as EXR has it."""
    channels: dict[str, np.ndarray] = {}
    for view_layer_name, passes in layers.items():
        for pass_name, image in passes.images.items():
            planes = {"V": image} if image.ndim == 2 else {letter: image[..., index] for index, letter in enumerate("RGB")}
            for letter, plane in planes.items():
                name = channel_name(view_layer_name, pass_name, letter)
                if name in channels:
                    raise UsageError(f"two passes would be written to the channel {name}; rename one of the lights or view layers")
                channels[name] = np.ascontiguousarray(plane[::-1], dtype=np.float32)
    if not channels:
        raise UsageError("there is no pass to write")
    return channels


def _attributes(layers: Mapping[str, PassSet], scene_name: str, frame: int) -> dict[str, str | int]:
    """Text attributes that Blender shows as the image's metadata; `frame` also as a number for scripts."""
    attributes: dict[str, str | int] = {
        "Software": f"VIR {__version__}",
        "Scene": scene_name,
        "Frame": str(frame),
        "vir:frame": frame,
    }
    for view_layer_name, passes in layers.items():
        attributes["vir:device"] = passes.statistics.device
        for made in passes.statistics.passes:
            attributes[f"vir:{channel_name(view_layer_name, made.pass_name)}"] = _how_made(made)
    return {name: value for name, value in attributes.items() if value != ""}


def _how_made(made: PassStatistics) -> str:
    if made.view_count == 0:
        return f"{made.method}: {made.reason}"
    return f"{made.method}, {made.view_count} views at {made.map_resolution_px} px, standard error {made.error_estimate:.2g}"
