"""What a user may ask for. Front ends fill this in; the plan decides what becomes of it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from .errors import UsageError

MAX_TAPS = 128
"""of pcss, for each of its two searches: a table of all taps is 4 KiB"""

MAX_REFLECTION_SAMPLES = 1024
MAX_BOUNCES = 8
"""each keeps a G-buffer of what it met"""
POISSON_SAMPLES, RECURSIVE_SAMPLES, ADAPTIVE_STEP = 25, 4, 4
"""of filtering by the normal's gradient as published: rays of a pixel, those of them that go on from what they met, and how many are added
at a time where their number adapts"""
CUBE_SIZES_PX = range(32, 1025, 32)
"""sides of faces of reflectors' cubes"""


class Method(enum.Enum):
    AUTO = "auto"
    MVR = "mvr"
    IVIR = "ivir"
    MICRO = "micro"
    HYBRID = "hybrid"
    VIR = "vir"
    VWSS = "vwss"
    EPR = "epr"
    PCSS = "pcss"

    @property
    def uses_points(self) -> bool:
        """Whether maps are splatted from points, which may be kept from batch to batch."""
        return self in (Method.IVIR, Method.HYBRID, Method.VIR, Method.VWSS, Method.EPR)

    @property
    def may_be_bufferless(self) -> bool:
        """Whether maps can be splatted without keeping points; with AUTO it counts for lights that a method with points is chosen for."""
        return self in (Method.AUTO, Method.IVIR, Method.HYBRID, Method.VWSS, Method.EPR)

    @property
    def may_cull_at_random(self) -> bool:
        """Whether small triangles may be culled stochastically; with AUTO it counts for lights that such a method is chosen for."""
        return self in (Method.AUTO, Method.IVIR, Method.HYBRID, Method.EPR)

    @property
    def shrinks_cut_outs(self) -> bool:
        """Whether RESOLVE takes all that is in the maps for points and what the rasterizer draws into them for half a texel too large."""
        return self in (Method.IVIR, Method.VIR)

    @property
    def tells_planes(self) -> bool:
        """Whether texels that no point wrote have the depth that is seen through their centre, and RESOLVE can tell them apart."""
        return self in (Method.MVR, Method.MICRO, Method.HYBRID, Method.EPR)

    @property
    def resolve_flags(self) -> tuple[str, ...]:
        """How RESOLVE has to look at the maps. Points of vwss lie at centres of texels, of its own view, and do not enlarge outlines."""
        if self is Method.HYBRID:
            return ("POINT_MAPS", "MIXED_MAPS", "SMALL_FACETS")
        if self is Method.EPR:
            return ("POINT_MAPS", "MIXED_MAPS")
        return ("POINT_MAPS",) if self.shrinks_cut_outs else ()


class Effect(enum.Enum):
    SHADOW = "shadow"
    REFLECTION = "reflection"


class ReflectionLookUp(enum.Enum):
    MARCH = "march"
    """Rays are followed through the depths of a reflector's map."""
    DIRECTION = "direction"
    """Maps are looked up as if all were infinitely far away, as published."""
    SHADED = "shaded"
    """So are cubes that are shaded whole before, and mip-mapped: the papers' baseline. One bounce, no mirrored views."""
    LAZY = "lazy"
    """So are cubes by all samples of a pixel at once, and of their texels those that any asks for are shaded, once each, and filtered: the
    eye-based deferred shading of Gavane & Watson 2022 b (sections 4.1.2 and 4.1.3). Blocks of texels of one object share what is shaded,
    as those of a splat do there, with `points_per_eye_pixel` of them for a pixel. One bounce, no mirrored views."""

    @property
    def shades_texels(self) -> bool:
        """not what rays meet"""
        return self in (ReflectionLookUp.SHADED, ReflectionLookUp.LAZY)


class ReflectionWords(enum.Enum):
    """What ivir writes into the texels of cubes that are shaded whole."""

    NUMBERS = "numbers"
    """depth and a triangle's number, from which the texel is shaded"""
    PACKED = "packed"
    """points are shaded, and a texel has 13 bits of depth and 19 of colour in one word, as published (Gavane & Watson 2022, section 5.1)"""
    WIDE = "wide"
    """points are shaded, and a texel has 32 bits of each, depth first and then the colour at that depth"""


class ReflectionFilter(enum.Enum):
    """What a pixel's rays are reflected from."""

    EYE = "eye"
    """Each from an eye sample of its own: edges of reflectors and their materials are filtered as well."""
    POISSON = "poisson"
    """All from one eye sample: its normal's gradient tells those of other places in the pixel, a Poisson-disc pattern of them, as published
    (Gavane & Watson 2022 b, section 4.1.3). Of them RECURSIVE_SAMPLES go on to further bounces."""
    ADAPTIVE = "adaptive"
    """The same, ADAPTIVE_STEP at a time until the pixel's variance declines no more."""


class ReflectionMethod(enum.Enum):
    """How reflectors' cubes are made."""

    AUTO = "auto"
    MVR = "mvr"
    IVIR = "ivir"
    EPR = "epr"


class PointStorage(enum.Enum):
    BUFFERED = "buffered"
    BUFFERLESS = "bufferless"


class PointGeneration(enum.Enum):
    COMPUTE = "compute"
    RASTERIZER = "rasterizer"
    """A geometry shader places triangles and the hardware rasterizer makes their points, as published."""


class Resolve(enum.Enum):
    AUTO = "auto"
    """ADAPTIVE on a software rasterizer; FULL on a GPU, which looks everything up in less time than it takes to find out what not to."""
    ADAPTIVE = "adaptive"
    """Tiles that the first batches find wholly lit or dark, with all pixels around, are only probed from then on, and looked up again
    where a probe finds something else."""
    FULL = "full"


class Hardware(enum.Enum):
    """What a plan's predictions are for, and so what `auto` chooses by."""

    SOFTWARE = "a software rasterizer"
    GPU = "a GPU"


@dataclass(frozen=True)
class Settings:
    effects: tuple[Effect, ...] = (Effect.SHADOW,)
    method: Method = Method.AUTO
    points: PointStorage = PointStorage.BUFFERED
    """of ivir, hybrid, vwss and epr; with AUTO it counts for lights that ivir is chosen for"""
    point_generation: PointGeneration = PointGeneration.COMPUTE
    """of ivir; other methods have no choice"""
    view_count: int = 64
    """light samples of a light with size; lights without size get one"""
    map_resolution_px: int = 1024
    batch_view_count: int = 8
    """most views of a light in a batch, which never has more than 8: fewer make its steps shorter, and the whole longer"""
    visibility_texel_count: int = 1 << 25
    """most that what pixels see is rasterized with at a time: fewer make steps shorter, and rasterizations more"""
    light_names: tuple[str, ...] | None = None
    """None: every light that the scene shows"""
    soft_shadows: bool = True
    """of area lights and suns; without, their passes are white and nothing is made for them"""
    omni_shadows: bool = True
    """likewise of point lights and spots"""
    stochastic_culling: bool = True
    """ivir, hybrid, points of epr: cull triangles of an area A below T texels with probability 1 - A / T (Gavane & Watson 2022,
    section 3.2)"""
    culling_area_texels: float = 0.1
    """T: a tenth as published in 2022; the preprint of 2020 (section 3.3) has an eighth"""
    resolve: Resolve = Resolve.AUTO
    cull_hidden: bool = True
    """after the first batch of views, leave out buffered points and small triangles that none of its views is near to seeing"""
    watertight: bool = True
    """point spacing that leaves no texel empty (covering radius) instead of the published one point per pixel area"""
    small_triangle_points: int = 8
    """hybrid: triangles that take more points are rasterized, those of more than 32 cells always"""
    back_faces: bool = False
    """vwss: points of back faces as well"""
    views_per_thread: int = 8
    """vwss: maps that one thread writes a point into; 1: serial, 8 and more: all that there are at a time"""
    blocker_sample_count: int = 32
    """pcss: taps that search for blockers, for every eye sample of a pixel"""
    filter_sample_count: int = 64
    """pcss: taps of the filter that the blockers' depth decides the width of"""
    replay_buffer_mib: int = 256
    """memory for what views replay (points, small triangles, maps of pcss and of lights without size) of all lights; what does not fit is
    made again for every batch"""
    bounces: int | None = None
    """how often light is followed from reflector to reflector; None: as often as the scene calls for, at most twice"""
    reflection_method: ReflectionMethod = ReflectionMethod.AUTO
    planar: bool = True
    """mirrored views of flat reflectors; without, they have cubes as all have, which is the papers' baseline"""
    reflection_look_up: ReflectionLookUp = ReflectionLookUp.MARCH
    reflection_words: ReflectionWords = ReflectionWords.NUMBERS
    """of ivir's shaded cubes"""
    reflection_cube_px: int | None = None
    """side of a face of every cube for what the eye sees of a reflector, however large that is in the picture: the papers' baseline, with
    512 in a picture 1920 wide. None: as wide as it is in the picture"""
    reflection_sample_count: int = 32
    """rays of every pixel that shows a reflector, each at another place in the pixel and, on rough surfaces, in another direction"""
    reflection_filter: ReflectionFilter = ReflectionFilter.EYE
    points_per_eye_pixel: float = 0.5
    """rho_scale of epr's cubes, for which the paper found a half best: fewer samples are larger splats; and with lazy look-ups places that
    are shaded for a pixel"""
    per_reflector: bool = False
    """a pair of reflection passes of each reflecting object besides"""
    reflection_map_mib: int = 256
    """memory for the maps of all reflectors; where they would take more they get smaller"""
    hardware: Hardware = Hardware.SOFTWARE
    """what will render: front ends ask the device (`core.plan.settings_for`)"""

    @property
    def has_mirrored_views(self) -> bool:
        """Whether flat reflectors may have one."""
        return self.planar and not self.reflection_look_up.shades_texels

    @property
    def is_adaptive(self) -> bool:
        """Whether tiles settle."""
        return self.resolve is Resolve.ADAPTIVE or (self.resolve is Resolve.AUTO and self.hardware is Hardware.SOFTWARE)

    def __post_init__(self) -> None:
        self._check_effects()
        if not 1 <= self.view_count <= 4096:
            raise UsageError(f"views must be 1 to 4096, not {self.view_count}")
        if self.batch_view_count < 1:
            raise UsageError(f"a batch has at least one view, not {self.batch_view_count}")
        if not 16 <= self.map_resolution_px <= 8192:
            raise UsageError(f"the map resolution must be 16 to 8192, not {self.map_resolution_px}")
        if not 0 <= self.small_triangle_points <= 32:
            raise UsageError(f"a small triangle may have 0 to 32 points, not {self.small_triangle_points}")
        if not 0 < self.culling_area_texels <= 1:
            raise UsageError(f"triangles may be culled below more than 0 and at most 1 texel, not {self.culling_area_texels:g}")
        for name, count in (("blocker", self.blocker_sample_count), ("filter", self.filter_sample_count)):
            if not 1 <= count <= MAX_TAPS:
                raise UsageError(f"the {name} samples of pcss must be 1 to {MAX_TAPS}, not {count}")
        if self.views_per_thread < 1:
            raise UsageError(f"a thread serves at least one view, not {self.views_per_thread}")
        if self.points is PointStorage.BUFFERLESS and not self.method.may_be_bufferless:
            raise UsageError(
                f"points cannot be {self.points.value} with the method {self.method.value}, "
                f"which {'compares neighbours in their buffer' if self.method.uses_points else 'makes none'}; "
                f"choose the method {Method.IVIR.value}, or leave the choice of points out"
            )
        if self.point_generation is not PointGeneration.COMPUTE and self.method is not Method.IVIR:
            raise UsageError(
                f"points are made by the {self.point_generation.value} only with {Method.IVIR.value}, not with {self.method.value}; "
                f"choose the method {Method.IVIR.value}, or leave the choice of point generation out"
            )
        if self.replay_buffer_mib < 1:
            raise UsageError("the replay buffer needs at least 1 MiB")

    def _check_effects(self) -> None:
        if not self.effects:
            raise UsageError(f"choose at least one effect: {', '.join(effect.value for effect in Effect)}")
        if self.bounces is not None and not 1 <= self.bounces <= MAX_BOUNCES:
            raise UsageError(f"reflections may bounce 1 to {MAX_BOUNCES} times, not {self.bounces}")
        look_up = self.reflection_look_up
        if look_up.shades_texels and self.bounces not in (None, 1):
            raise UsageError(f"{look_up.value} cubes show one bounce, not {self.bounces}: choose another look-up for more")
        if look_up is ReflectionLookUp.LAZY and self.reflection_filter is not ReflectionFilter.POISSON:
            raise UsageError(
                f"{look_up.value} look-ups are of all samples from one eye sample: choose the reflection filter "
                f"{ReflectionFilter.POISSON.value}, not {self.reflection_filter.value}"
            )
        is_shaded_ivir = self.reflection_look_up is ReflectionLookUp.SHADED and self.reflection_method is ReflectionMethod.IVIR
        if self.reflection_words is not ReflectionWords.NUMBERS and not is_shaded_ivir:
            raise UsageError(
                f"{self.reflection_words.value} words are what {ReflectionMethod.IVIR.value} writes into {ReflectionLookUp.SHADED.value} "
                "cubes: choose this reflection method and this look-up, or leave the choice of words out"
            )
        if not 1 <= self.reflection_sample_count <= MAX_REFLECTION_SAMPLES:
            raise UsageError(f"reflections take 1 to {MAX_REFLECTION_SAMPLES} samples of a pixel, not {self.reflection_sample_count}")
        if self.per_reflector and self.reflection_filter is ReflectionFilter.ADAPTIVE:
            raise UsageError(
                "passes per reflector count as many samples in every pixel: choose another filter than adaptive, or leave them out"
            )
        if not 0 < self.points_per_eye_pixel <= 4:
            raise UsageError(f"epr takes more than 0 and at most 4 points of an eye's pixel, not {self.points_per_eye_pixel:g}")
        if self.reflection_cube_px is not None and self.reflection_cube_px not in CUBE_SIZES_PX:
            raise UsageError(
                f"reflectors' cubes may be {CUBE_SIZES_PX[0]} to {CUBE_SIZES_PX[-1]} px wide in steps of {CUBE_SIZES_PX.step}, "
                f"not {self.reflection_cube_px}"
            )
        if self.reflection_map_mib < 1:
            raise UsageError("the maps of reflectors need at least 1 MiB")
