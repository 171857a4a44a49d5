"""The running sums of one pass: what it is so far, and how far it may be off."""

from __future__ import annotations

import math

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored
from ...device.interface import Device, Texture, TextureFormat
from ...device.owned import Owned
from .tiles import PROBE_STEP_PX, PROBES_PER_ROW, SIZE_CONSTANTS, TILE_PX, Tiles, grid_shape, spread_to_pixels, with_neighbours

LEAST_RATIO = 1e-6
"""less is 0: a hundred times what samples that nothing is known of (RESOLVE) may make of it"""
ERROR_TILE_PX = 16
MIN_SETTLING_VIEWS = 16
MIN_SETTLING_BATCHES = 2
MIN_SETTLING_EYE_SHARE = 1 / 4
"""What so many well-distributed light samples and sub-pixel offsets see alike is taken to be alike. Slivers that none of the offsets has
met yet count in the pass as much as there are offsets left: with an eighth of 32 seen, the still life at 1920 x 1080 is off by 0.0022,
with a quarter by 0.0010."""
MIN_EARLY_SETTLING_VIEWS = 8
MIN_EARLY_SETTLING_EYE_SHARE = 1 / 8
EARLY_SETTLING_TILES = 2
"""So few light samples, those of a first batch, are enough for what is lit or background so many tiles around: most of a picture with
much ground or sky. Shadows that they miss are faint, and as a rule there is one nearby that they do not miss."""
SETTLE_RADIUS_PX = 3
"""Filters reach 1.5 pixels, and penumbrae do not begin at once: within three pixels of anything else looking up goes on."""
MAX_UNEVENNESS = 2.0
"""Where places near each other get as much more light than others, at the rim of a spot or beside a lamp, the first light samples say
little of how much it is in the end."""
STATE_MIXED, STATE_LIT, STATE_DARK, STATE_BACKGROUND = 1, 2, 4, 8
"""What a pass has found of a pixel or a tile so far: something between, always lit, never lit, always background."""
_PROBED_AT = np.clip((np.arange(TILE_PX) + 0.5) / PROBE_STEP_PX - 0.5, 0, 1)
_CELLS_TO_PIXELS = np.stack([1 - _PROBED_AT, _PROBED_AT], axis=1).astype(np.float32)
"""(TILE_PX, PROBES_PER_ROW): linear between the middles of a tile's two cells"""
SETTLED_DEFINES = {"STATE_LIT": STATE_LIT, "STATE_DARK": STATE_DARK, "STATE_BACKGROUND": STATE_BACKGROUND}
ROUND_SUMS_TEXT = "sums over rounds: shadowed s, delivered d, squared deviations of s from the ratio so far, surface samples"
PROBED_LIGHT_TEXT = "sums over probes of settled tiles: light delivered, and what the rounds in the pixel's sums let expect"
SETTLED_LIGHT_TEXT = "x: what all rounds deliver over what those in the sums do, of every probe's cell"
SUMS_TEXTURES = {"round_sums": Sampled("sampler2D", ROUND_SUMS_TEXT)}
TILE_ROUNDS_TEXTURES = {"tile_rounds": Sampled("sampler2D", "x: rounds in the sums of every tile")}

PASS_ERROR = ComputeDeclaration(
    name="pass_error",
    text="sums the squared standard error of a pass over tiles",
    source="pass_error.comp.glsl",
    local_size=(8, 8, 1),
    textures=SUMS_TEXTURES,
    images={"tile_sums": Stored("RGBA32F", "write", "sum of squared errors and number of lit pixels of every tile")},
    constants=SIZE_CONSTANTS,
)

PASS_STATES = ComputeDeclaration(
    name="pass_states",
    text="tells pixels that are wholly lit, dark or background so far from the others",
    source="pass_states.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        **SUMS_TEXTURES,
        **TILE_ROUNDS_TEXTURES,
        "positions": Sampled("sampler2D", "position (world space) and instance number, -1 for the background"),
        "normals": Sampled("sampler2D", "geometric normal (world space)"),
    },
    images={"states": Stored("R32UI", "write", "one bit a state")},
    constants=SIZE_CONSTANTS,
    defines={**SETTLED_DEFINES, "STATE_MIXED": STATE_MIXED, "TILE_PX": TILE_PX},
)

SETTLE_TILES = ComputeDeclaration(
    name="settle_tiles",
    text="finds the tiles that need not be looked up any more",
    source="settle_tiles.comp.glsl",
    local_size=(8, 8, 1),
    textures={**SUMS_TEXTURES, "states": Sampled("usampler2D", "one bit a state")},
    images={"tile_states": Stored("R32UI", "write", "the state of all of a tile and around it; 0 where there are several")},
    constants={**SIZE_CONSTANTS, "is_combined": Constant("int", "1: how much light there is counts as well")},
    defines={"SETTLE_RADIUS_PX": SETTLE_RADIUS_PX, "MAX_UNEVENNESS": MAX_UNEVENNESS, "TILE_PX": TILE_PX, "STATE_MIXED": STATE_MIXED},
)

COMBINE_PASSES = ComputeDeclaration(
    name="combine_passes",
    text="adds a light's pass to a picture that stays on the device",
    source="combine_passes.comp.glsl",
    local_size=(8, 8, 1),
    textures={**SUMS_TEXTURES, **TILE_ROUNDS_TEXTURES, "settled_light": Sampled("sampler2D", SETTLED_LIGHT_TEXT)},
    images={"picture": Stored("RGBA32F", "read_write", "shadowed and delivered light, and the share of eye samples that saw a surface")},
    constants={
        **SIZE_CONSTANTS,
        "weight": Constant("float", "what the light counts"),
        "is_first": Constant("int", "1: the picture has nothing yet"),
    },
    defines={"TILE_PX": TILE_PX, "PROBE_STEP_PX": PROBE_STEP_PX},
)


class PassAccumulator:
    """Sums of one light's pass over rounds, each a look-up of the picture at one sub-pixel offset with its share of a batch's views. A pass
    is sum s / sum d: 0 shadowed to 1 lit."""

    def __init__(self, device: Device, width: int, height: int) -> None:
        self.device, self.width, self.height = device, width, height
        zeros = np.zeros((height, width, 4), np.float32)
        rows, columns = grid_shape(width, height)
        self.tile_states = np.zeros((rows, columns), np.uint32)
        """of settled tiles; 0: looked up"""
        self._growth = np.zeros((1, rows, columns))
        """of each of a batch's rounds: of tiles that are looked up again from it on, what their sums grow by for the rounds that they
        were left out of; otherwise 0"""
        cells = PROBES_PER_ROW * rows, PROBES_PER_ROW * columns, 2
        self._probed, self._probed_before = np.zeros(cells), np.zeros(cells)
        """of `probed_light`, up to this batch: since the tile settled last, and before"""
        with Owned() as owned:
            self.round_sums = owned.own(device.upload_texture(zeros))
            self.disagreeing = owned.own(device.create_texture(columns, rows, TextureFormat.R32UI))
            """set by probes for settled tiles that are not what they were"""
            self.probed_light = owned.own(self.device.upload_texture(np.zeros((*cells[:2], 4), np.float32)))
            tiles = (-(-width // ERROR_TILE_PX), -(-height // ERROR_TILE_PX))
            # made beforehand: errors are asked for when a render is closed, also one that ended because there is no memory
            self._error_sums = owned.own(device.create_texture(*tiles, TextureFormat.RGBA32F))
            self._owned = owned.pop_all()
        self.round_count = 0
        self._settled_rounds = np.zeros((rows, columns))
        """rounds in the sums of settled tiles"""
        self.settling_count = 0
        """how often tiles to settle were looked for"""
        self.has_settled = False
        """for good"""

    @property
    def looked_up(self) -> np.ndarray:
        """(rows, columns) bool"""
        return self.tile_states == 0

    def begin_batch(self, round_count: int) -> None:
        """round_count: how many eye samples of the picture the batch looks up"""
        self.round_count += round_count
        self._growth = np.zeros((round_count, *self.tile_states.shape))
        if self.settling_count:
            probed = self._read_probed()
            self._probed_before = np.where(_spread_to_cells(self.looked_up)[..., None], probed, self._probed_before)
            self._probed = probed - self._probed_before

    def rounds_before(self, part: int) -> int:
        """the batch's round with this number"""
        return self.round_count - len(self._growth) + part

    def tiles_to_look_up(self, part: int, turns: np.ndarray) -> Tiles:
        """For RESOLVE, the batch's round with this number. turns: (rows, columns) as of TURN_DEFINES, -1 for tiles without one"""
        return Tiles(self.device, self.looked_up & (turns >= 0), np.stack([turns, self._growth[part]], axis=-1))

    def tiles_to_probe(self, wanted: np.ndarray, is_first_face: np.ndarray) -> Tiles:
        """Settled ones, for RESOLVE with PROBES. (rows, columns) bool each; is_first_face: whether no face before this one is seen in"""
        per_round = np.divide(is_first_face, self._settled_rounds, out=np.zeros(wanted.shape), where=self._settled_rounds > 0)
        return Tiles(self.device, ~self.looked_up & wanted, np.stack([self.tile_states, per_round], axis=-1))

    def settle(self, positions: Texture, normals: Texture, *, early: bool, is_combined: bool) -> None:
        """Leave tiles out of later batches that lie in the middle of what is wholly lit, dark or background so far.

        positions, normals: of the latest eye G-buffer. Surfaces that meet or pass each other are looked up on. early: only tiles that have
        nothing dark nearby. is_combined: how much light there is counts beside other lights'
        """
        rows, columns = self.tile_states.shape
        size = {"width": self.width, "height": self.height}
        with Owned() as temporary:
            states = temporary.own(self.device.create_texture(self.width, self.height, TextureFormat.R32UI))
            tile_states = temporary.own(self.device.create_texture(columns, rows, TextureFormat.R32UI))
            self.device.compute_kernel(PASS_STATES).dispatch_grid(
                (self.width, self.height),
                round_sums=self.round_sums,
                tile_rounds=temporary.own(self._tile_rounds_texture()),
                positions=positions,
                normals=normals,
                states=states,
                **size,
            )
            self.device.compute_kernel(SETTLE_TILES).dispatch_grid(
                (columns, rows),
                round_sums=self.round_sums,
                states=states,
                tile_states=tile_states,
                is_combined=int(is_combined),
                **size,
            )
            found = self.device.read(tile_states)
        if early:
            others = (found != STATE_LIT) & (found != STATE_BACKGROUND)
            for _ in range(EARLY_SETTLING_TILES):
                others = with_neighbours(others)
            found = np.where(others, 0, found)
        self._settled_rounds = np.where(self.looked_up, self.round_count, self._settled_rounds)
        self.tile_states = np.where(self.looked_up, found, self.tile_states).astype(np.uint32)
        self.settling_count += 1
        self.has_settled = not early

    def reopen(self, skipped_count: int) -> np.ndarray:
        """Look tiles up again that the latest probes found changed, and those around them.

        The rounds that they were left out of count as found by probes: as they were, with as much light as there was. skipped_count: rounds
        of this batch that the tiles take no part in any more. Returns (rows, columns) bool, the tiles.
        """
        reopened = with_neighbours(self.device.read(self.disagreeing) > 0) & ~self.looked_up
        if reopened.any():
            self.tile_states = np.where(reopened, 0, self.tile_states).astype(np.uint32)
            rows, columns = reopened.shape
            of_tiles = self._probed.reshape(rows, PROBES_PER_ROW, columns, PROBES_PER_ROW, 2).sum(axis=(1, 3))
            rounds = self.rounds_before(skipped_count) / self._settled_rounds[reopened]
            self._growth[skipped_count, reopened] = 1 + (rounds - 1) * _later_light(of_tiles)[reopened]
        return reopened

    @property
    def settled_share(self) -> float:
        """of the tiles"""
        return 1 - float(self.looked_up.mean())

    def compute_error(self) -> float:
        """RMS over lit pixels of the standard error, from the spread between rounds. Rounds are stratified together, so the
        true error of their mean is smaller. Infinite before there are two rounds."""
        if self.round_count < 2:
            return math.inf
        self.device.compute_kernel(PASS_ERROR).dispatch_grid(
            (self._error_sums.width, self._error_sums.height),
            round_sums=self.round_sums,
            tile_sums=self._error_sums,
            width=self.width,
            height=self.height,
        )
        sums = self.device.read(self._error_sums).astype(np.float64)
        squared, count = sums[..., 0].sum(), sums[..., 1].sum()
        correction = self.round_count / (self.round_count - 1)
        return math.sqrt(correction * squared / count) if count else 0.0

    def read(self, *, is_combined: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(height, width) float32 each: shadowed, delivered (per round), and the share of eye samples that saw a surface. is_combined: how
        much is delivered counts beside other lights', and is put right in settled tiles"""
        sums = self.device.read(self.round_sums)
        tile_rounds = self._tile_rounds
        rounds = spread_to_pixels(tile_rounds, self.width, self.height).astype(np.float32)
        shadowed, delivered, surface_share = (sums[..., channel] / rounds for channel in (0, 1, 3))
        if is_combined:
            light = self._settled_light()
            shadowed, delivered = light * shadowed, light * delivered
        return shadowed, delivered, surface_share

    def _read_probed(self) -> np.ndarray:
        """(rows of cells, columns of cells, 2) as `probed_light`"""
        return self.device.read(self.probed_light)[..., :2].astype(np.float64)

    def _settled_light_of_cells(self) -> np.ndarray:
        """(rows of cells, columns of cells) float32 as SETTLED_LIGHT_TEXT says. In the combined pass lights lie beside each other that have
        had unlike shares of their samples."""
        rows, columns = self.tile_states.shape
        if not self.settling_count:
            return np.ones(self._probed.shape[:2], np.float32)
        probed = (self._read_probed() - self._probed_before).reshape(rows, PROBES_PER_ROW, columns, PROBES_PER_ROW, 2)
        # where nothing was probed, as beyond the picture's edge, what the rest of the tile tells
        known = np.where(probed[..., 1:] > 0, probed, probed.sum(axis=(1, 3), keepdims=True))
        # of all rounds, those that settled tiles were left out of
        late_share = 1 - self._tile_rounds / max(self.round_count, 1)
        light = 1 + late_share[:, None, :, None] * (_later_light(known) - 1)
        return light.reshape(self._probed.shape[:2]).astype(np.float32)

    def _settled_light(self) -> np.ndarray:
        """(height, width) float32, linear between the middles of a tile's cells"""
        rows, columns = self.tile_states.shape
        cells = self._settled_light_of_cells().reshape(-1, columns, PROBES_PER_ROW)
        in_rows = (cells @ _CELLS_TO_PIXELS.T).reshape(rows, PROBES_PER_ROW, columns * TILE_PX)
        return (_CELLS_TO_PIXELS @ in_rows).reshape(rows * TILE_PX, -1)[: self.height, : self.width]

    def add_to(self, picture: Texture, weight: float, *, is_first: bool) -> None:
        """picture: of `COMBINE_PASSES`; `pass_image` says what it means"""
        with Owned() as temporary:
            self.device.compute_kernel(COMBINE_PASSES).dispatch_grid(
                (self.width, self.height),
                round_sums=self.round_sums,
                tile_rounds=temporary.own(self._tile_rounds_texture()),
                settled_light=temporary.own(self._settled_light_texture()),
                picture=picture,
                width=self.width,
                height=self.height,
                weight=weight,
                is_first=int(is_first),
            )

    @property
    def _tile_rounds(self) -> np.ndarray:
        """(rows, columns) rounds in the sums of every tile"""
        return np.where(self.looked_up, max(self.round_count, 1), self._settled_rounds)

    def _tile_rounds_texture(self) -> Texture:
        texels = np.zeros((*self.tile_states.shape, 4), np.float32)
        texels[..., 0] = self._tile_rounds
        return self.device.upload_texture(texels)

    def _settled_light_texture(self) -> Texture:
        light = self._settled_light_of_cells()
        return self.device.upload_texture(np.stack([light, *3 * [np.zeros_like(light)]], axis=-1))

    def release(self) -> None:
        self._owned.close()


def _spread_to_cells(grid: np.ndarray) -> np.ndarray:
    """(rows, columns) values of tiles -> those of their cells"""
    return grid.repeat(PROBES_PER_ROW, axis=0).repeat(PROBES_PER_ROW, axis=1)


def _later_light(probed: np.ndarray) -> np.ndarray:
    """(...) of (..., 2) sums of PROBED_LIGHT_TEXT: what rounds deliver that are not in a tile's sums over what those in it do; 1 where that
    is not known"""
    return np.divide(probed[..., 0], probed[..., 1], out=np.ones(probed.shape[:-1]), where=probed[..., 1] > 0)


def pass_image(shadowed: np.ndarray, delivered: np.ndarray, surface_share: np.ndarray) -> np.ndarray:
    """The pass's meaning in one place: shadowed / delivered where the light delivers anything; where it delivers nothing, surfaces
    (turned away from the whole light) are 0 and the background is 1."""
    lit = delivered > 0
    ratio = np.divide(shadowed, delivered, out=np.zeros_like(shadowed), where=lit)
    # the sums' terms come in different orders: a ratio of 1 may be off by a rounding; samples that nothing is known of are in one of 0
    return np.where(lit, np.where(ratio > LEAST_RATIO, np.minimum(ratio, 1), 0), 1 - surface_share).astype(np.float32)
