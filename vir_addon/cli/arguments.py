"""The command line's grammar."""

from __future__ import annotations

import argparse
import enum
from functools import partial
from pathlib import Path
from typing import Any

from .. import __version__
from ..core.errors import UsageError
from ..core.settings import (
    ADAPTIVE_STEP,
    POISSON_SAMPLES,
    RECURSIVE_SAMPLES,
    Effect,
    Method,
    PointGeneration,
    PointStorage,
    ReflectionFilter,
    ReflectionLookUp,
    ReflectionMethod,
    ReflectionWords,
    Resolve,
    Settings,
)

EXIT_STATUS_TEXT = "exit status: 0 done, 2 wrong usage, 3 the scene cannot be rendered, 4 no usable device, 130 stopped with Ctrl-C"


FRAME_MAX = 1_048_574
"""Blender's last frame; its first is as far below zero"""


def parse_frames(text: str) -> list[int]:
    """'1-24', '1-24:2' (every second), '3,7,10-12' -> frame numbers in order, each once."""
    frames: dict[int, None] = {}
    for part in text.split(","):
        span, _, step = part.partition(":")
        # a minus at the start belongs to the number: '-5-10' is -5 to 10
        cut = span.find("-", 1)
        try:
            first = int(span if cut < 0 else span[:cut])
            last = first if cut < 0 else int(span[cut + 1 :])
            stride = int(step) if step else 1
        except ValueError:
            raise argparse.ArgumentTypeError(f"{part!r} is not a frame or a range such as 1-24 or 1-24:2") from None
        if last < first or stride < 1:
            raise argparse.ArgumentTypeError(f"{part!r} has no frames")
        if max(-first, last) > FRAME_MAX:
            raise argparse.ArgumentTypeError(f"{part!r} is outside of Blender's frames, {-FRAME_MAX} to {FRAME_MAX}")
        frames |= dict.fromkeys(range(first, last + 1, stride))
    return list(frames)


def parse_path(text: str) -> Path:
    """An empty name would be the current folder: what a script gives whose variable is not set."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty")
    return Path(text)


def parse_resolution(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit() and 0 < int(width) <= 16384 and 0 < int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is not a resolution such as 960x540 (up to 16384x16384)")
    return int(width), int(height)


def parse_names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise argparse.ArgumentTypeError("names no light")
    return names


def parse_sample_counts(text: str) -> tuple[int, int]:
    """'32+64' -> (32, 64)"""
    search, plus, of_filter = text.partition("+")
    if not (plus and search.isdigit() and of_filter.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not two counts such as 32+64")
    return int(search), int(of_filter)


def parse_effects(text: str) -> tuple[Effect, ...]:
    """'shadow,reflection' -> both, in the order of `Effect`, each once; so is 'auto', as a plan leaves out what nothing calls for"""
    if text.strip() == "auto":
        return tuple(Effect)
    asked = {_parse_choice(Effect, part.strip()) for part in text.split(",")}
    return tuple(effect for effect in Effect if effect in asked)


def _parse_choice(choices: type[enum.Enum], text: str) -> enum.Enum:
    try:
        return choices(text)
    except ValueError:
        # argparse would name the Python class
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(choice.value for choice in choices)}") from None


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m vir_addon",
        description="Soft-shadow passes, one per light, and reflection passes from a .blend.",
        epilog=EXIT_STATUS_TEXT,
    )
    parser.add_argument("--version", action="version", version=f"VIR {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")

    render = commands.add_parser("render", help="render passes into one multilayer EXR a frame", epilog=EXIT_STATUS_TEXT)
    _add_scene_arguments(render)
    render.add_argument("--output", type=parse_path, required=True, metavar="FOLDER", help="where the files go; made if it is not there")
    render.add_argument("--stats", type=parse_path, metavar="FILE", help="write counts, times and error estimates as JSON")
    render.add_argument("--preview", action="store_true", help="PNGs of all passes and a contact sheet beside the EXR")

    plan = commands.add_parser("plan", help="what would run and why, without running it", epilog=EXIT_STATUS_TEXT)
    _add_scene_arguments(plan)

    commands.add_parser(
        "doctor", help="versions, devices, limits, and what is missing with the command that installs it", epilog=EXIT_STATUS_TEXT
    )
    return parser


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    _add_input_arguments(parser)
    _add_shadow_arguments(parser)
    _add_reflection_arguments(parser)


def _add_input_arguments(parser: argparse.ArgumentParser) -> None:
    defaults = Settings()
    parser.add_argument("scene", type=parse_path, metavar="SCENE.blend")
    parser.add_argument("--scene-name", metavar="NAME", help="which scene of the file; default: the one that was open when it was saved")
    parser.add_argument(
        "--frames", type=parse_frames, metavar="1-24", help="frames, e.g. 1-24, 1-24:2 or 3,7; default: the file's current frame"
    )
    parser.add_argument("--resolution", type=parse_resolution, metavar="960x540", help="of the picture; default: the scene's")
    parser.add_argument(
        "--effects",
        type=parse_effects,
        default=defaults.effects,
        metavar="auto|" + ",".join(effect.value for effect in Effect),
        help="which passes; auto: all that the scene calls for; default: shadow",
    )
    parser.add_argument("--lights", type=parse_names, metavar="Key,Fill", help="only these lights; white in frames without; default: all")
    parser.add_argument(
        "--device",
        choices=("moderngl", "gpu"),
        default="moderngl",
        help="what renders: OpenGL by moderngl (default) or Blender's gpu module",
    )


def _add_shadow_arguments(parser: argparse.ArgumentParser) -> None:
    defaults, group = Settings(), parser.add_argument_group("shadows")
    group.add_argument(
        "--method",
        type=partial(_parse_choice, Method),
        default=defaults.method,
        metavar="|".join(method.value for method in Method),
        help="how depth maps are made; auto (default) picks the cheaper",
    )
    group.add_argument(
        "--points",
        type=partial(_parse_choice, PointStorage),
        default=defaults.points,
        metavar="buffered|bufferless",
        help="whether ivir, hybrid, vwss and epr keep their points between batches (default) or make them anew; others have no choice",
    )
    group.add_argument(
        "--point-generation",
        type=partial(_parse_choice, PointGeneration),
        default=defaults.point_generation,
        metavar="compute|rasterizer",
        help="what makes the points of ivir: kernels (default) or, as published, geometry shader and rasterizer (device moderngl only)",
    )
    group.add_argument(
        "--culling-area",
        type=float,
        metavar="TEXELS",
        help="ivir, hybrid and the points of epr cull smaller triangles at random; at most 1: 0.1 (default) as published, 0.125 as in the "
        "preprint, 0 none",
    )
    group.add_argument(
        "--views",
        type=int,
        default=defaults.view_count,
        metavar="N",
        help=f"light samples of each light with a size; default {defaults.view_count}; pcss has one map whatever this says",
    )
    group.add_argument(
        "--pcss-samples",
        type=parse_sample_counts,
        metavar="N+M",
        help="of pcss: samples that search for blockers and samples of the filter, a look-up; default "
        f"{defaults.blocker_sample_count}+{defaults.filter_sample_count}",
    )
    group.add_argument(
        "--map-resolution",
        type=int,
        default=defaults.map_resolution_px,
        metavar="PX",
        help=f"width and height of depth maps; default {defaults.map_resolution_px}",
    )
    group.add_argument(
        "--resolve",
        type=partial(_parse_choice, Resolve),
        default=defaults.resolve,
        metavar="auto|full|adaptive",
        help="adaptive only probes what 16 samples find wholly lit or dark: faster on a software rasterizer, error below 0.002; full looks "
        "everything up: faster on a GPU; default: auto",
    )


def _add_reflection_arguments(parser: argparse.ArgumentParser) -> None:
    defaults, group = Settings(), parser.add_argument_group("reflections")
    group.add_argument(
        "--bounces",
        type=int,
        default=defaults.bounces,
        metavar="N",
        help="how often light is followed from reflector to reflector; default: 2 where there are several, otherwise 1",
    )
    group.add_argument(
        "--reflection-samples",
        type=int,
        metavar="N",
        help=f"rays of every pixel that shows a reflector; default {defaults.reflection_sample_count}, {POISSON_SAMPLES} where one eye "
        "sample serves all",
    )
    group.add_argument(
        "--reflection-filter",
        type=partial(_parse_choice, ReflectionFilter),
        default=defaults.reflection_filter,
        metavar="eye|poisson|adaptive",
        help="rays from an eye sample each (default); or as published all from one, by its normal's gradient, in a Poisson-disc pattern, "
        f"{RECURSIVE_SAMPLES} of which go on to further bounces; adaptive: {ADAPTIVE_STEP} at a time until their variance declines no more",
    )
    group.add_argument("--per-reflector", action="store_true", help="a pair of reflection passes of each reflecting object besides")
    group.add_argument(
        "--reflection-method",
        type=partial(_parse_choice, ReflectionMethod),
        default=defaults.reflection_method,
        metavar="|".join(method.value for method in ReflectionMethod),
        help="how reflectors' cubes are made: each by the rasterizer (mvr), or from one cloud (ivir, epr); default: the quicker for each",
    )
    group.add_argument(
        "--reflection-look-up",
        type=partial(_parse_choice, ReflectionLookUp),
        default=defaults.reflection_look_up,
        metavar="|".join(each.value for each in ReflectionLookUp),
        help="follow rays through the depths of reflectors' maps (default), or look them up by direction as published: things slide; "
        "shaded: the same in cubes that are shaded whole and mip-mapped, the papers' baseline; lazy: by all samples of --reflection-filter "
        "poisson at once, and what they need is shaded once, as densely as --points-per-eye-pixel says",
    )
    group.add_argument(
        "--reflection-words",
        type=partial(_parse_choice, ReflectionWords),
        default=defaults.reflection_words,
        metavar="|".join(words.value for words in ReflectionWords),
        help="what ivir writes into shaded cubes: numbers of triangles, from which texels are shaded (default), or as published points' "
        "own colours, packed with their depths into 32 bits, or 32 bits of each (wide)",
    )
    group.add_argument(
        "--reflection-cube",
        type=int,
        metavar="PX",
        help="side of a face of reflectors' cubes, the same for all, as the papers' baseline has it: 512 in a picture 1920 wide; default: "
        "as wide as each is in the picture",
    )
    group.add_argument(
        "--reflection-map-mib",
        type=int,
        default=defaults.reflection_map_mib,
        metavar="MIB",
        help=f"memory for the maps of all reflectors, which get smaller where it is too little; default {defaults.reflection_map_mib}",
    )
    group.add_argument(
        "--points-per-eye-pixel",
        type=float,
        metavar="N",
        help="samples of an eye's pixel in cubes made with epr, and places shaded for it with lazy look-ups; default "
        f"{defaults.points_per_eye_pixel:g}",
    )
    group.add_argument(
        "--no-planar",
        action="store_true",
        help="cubes for flat reflectors too, which otherwise have the mirrored eye's view with any method: what the papers compare with",
    )


def _refuse_options_of_reflections(arguments: argparse.Namespace) -> None:
    """Those that change how reflections are made."""
    given = {
        "--reflection-look-up": arguments.reflection_look_up is not Settings.reflection_look_up,
        "--reflection-words": arguments.reflection_words is not Settings.reflection_words,
        "--reflection-cube": arguments.reflection_cube is not None,
        "--reflection-filter": arguments.reflection_filter is not Settings.reflection_filter,
        "--reflection-method": arguments.reflection_method is not Settings.reflection_method,
        "--points-per-eye-pixel": arguments.points_per_eye_pixel is not None,
        "--per-reflector": arguments.per_reflector,
        "--no-planar": arguments.no_planar,
    }
    for option, is_given in given.items():
        if is_given:
            raise UsageError(f"{option} does nothing without reflections; leave it out, or choose --effects reflection")


def settings_of(arguments: argparse.Namespace) -> Settings:
    """Raises UsageError for values out of range, and for options of methods other than the chosen one."""
    method = arguments.method
    options: dict[str, Any] = {}
    if arguments.culling_area is not None:
        if not method.may_cull_at_random:
            fitting = ", ".join(each.value for each in Method if each.may_cull_at_random)
            raise UsageError(f"--culling-area does nothing with the method {method.value}; leave it out, or choose one of {fitting}")
        options["stochastic_culling"] = arguments.culling_area != 0
        options["culling_area_texels"] = arguments.culling_area or Settings.culling_area_texels
    if arguments.pcss_samples is not None:
        if method is not Method.PCSS:
            raise UsageError(f"--pcss-samples does nothing with the method {method.value}; leave it out, or choose {Method.PCSS.value}")
        options["blocker_sample_count"], options["filter_sample_count"] = arguments.pcss_samples
    if Effect.REFLECTION not in arguments.effects:
        _refuse_options_of_reflections(arguments)
    if arguments.points_per_eye_pixel is not None:
        is_lazy = arguments.reflection_look_up is ReflectionLookUp.LAZY
        if arguments.reflection_method not in (ReflectionMethod.AUTO, ReflectionMethod.EPR) and not is_lazy:
            raise UsageError(
                f"--points-per-eye-pixel does nothing with the reflection method {arguments.reflection_method.value}; leave it out, "
                f"or choose {ReflectionMethod.EPR.value}"
            )
        options["points_per_eye_pixel"] = arguments.points_per_eye_pixel
    samples = Settings.reflection_sample_count if arguments.reflection_filter is ReflectionFilter.EYE else POISSON_SAMPLES
    return Settings(
        effects=arguments.effects,
        bounces=arguments.bounces,
        reflection_sample_count=samples if arguments.reflection_samples is None else arguments.reflection_samples,
        reflection_filter=arguments.reflection_filter,
        per_reflector=arguments.per_reflector,
        reflection_map_mib=arguments.reflection_map_mib,
        reflection_method=arguments.reflection_method,
        planar=not arguments.no_planar,
        reflection_cube_px=arguments.reflection_cube,
        reflection_look_up=arguments.reflection_look_up,
        reflection_words=arguments.reflection_words,
        method=method,
        points=arguments.points,
        point_generation=arguments.point_generation,
        view_count=arguments.views,
        map_resolution_px=arguments.map_resolution,
        light_names=arguments.lights,
        resolve=arguments.resolve,
        **options,
    )
