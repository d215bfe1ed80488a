"""Unbounded ground texture: band-limited noise in octaves of equal contrast, deterministic by seed.

Every octave is the same noise tile, turned, shifted and scaled differently on every surface, so that the periods of the
octaves never meet again: the pattern as a whole does not repeat. An octave is sampled only where the image can resolve
it, with the weight that lens and pixel give it there; that is the anti-aliasing, and no level of detail ever switches.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft

from companion.records import Floats

Image32 = npt.NDArray[np.float32]
Image16 = npt.NDArray[np.uint16]

PERIOD_TEXELS = 1280  # chosen: texels after which the ground repeats: the tile stays small, octaves never meet again
CENTRE_PER_TEXEL = 1.0 / 8.0
"""Centre frequency of the tile's band: low for bilinear sampling, high for the processor's cache (choice)."""

# convention: the middle of a uint16; five sigma of the noise fit into its range
ZERO_LEVEL, LEVELS_PER_RMS = 32768, 6000
_REPEATS = 3  # copies side by side, so that a window never wraps (choice)

_COARSEST, _FINEST = -8, 9  # octaves, 2^k cycles per metre: 256 m to 2 mm (choice)
_LENS_SIGMA_PX = 0.45  # chosen: a good small lens blurs by about half a pixel
_FADE_FROM, _FADE_TO = 0.22, 0.36  # cycles per pixel at an octave's centre: full weight, none (choice)
_GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))  # by definition: no two octaves line up


@dataclass(frozen=True, slots=True)
class Octave:
    """One octave on one surface: ``texel = scale * turn @ (u, v) + offset``."""

    cycles_per_m: float
    turn: Floats
    offset: Floats

    def texel_from_plane(self, origin_m: Floats) -> Floats:
        """Affine map (2, 3) from metres about ``origin_m`` to texels, reduced by whole periods in double precision."""
        linear = self.cycles_per_m / CENTRE_PER_TEXEL * self.turn
        start = np.mod(linear @ origin_m + self.offset, PERIOD_TEXELS)
        return np.column_stack([linear, start])


def noise_period(seed: int) -> Image32:
    """One period of noise of one octave about :data:`CENTRE_PER_TEXEL`, mean 0, rms 1, (1280, 1280).

    Its spectrum falls to nothing an octave from the centre, as a squared cosine of log frequency.
    """
    generator = np.random.default_rng([seed, 0x7E47])
    fx, fy = np.meshgrid(fft.rfftfreq(PERIOD_TEXELS), fft.fftfreq(PERIOD_TEXELS))
    radius = np.hypot(fx, fy)
    radius[0, 0] = 1e-9
    distance = np.minimum(np.abs(np.log2(radius / CENTRE_PER_TEXEL)), 1.0)
    # equal power per octave of a plane asks for a density of 1/f^2, an amplitude of 1/f
    amplitude = np.cos(0.5 * np.pi * distance) ** 2 / radius
    wave = generator.standard_normal((*amplitude.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    tile = fft.irfft2((amplitude * wave).astype(np.complex64), s=(PERIOD_TEXELS, PERIOD_TEXELS))
    return np.ascontiguousarray(tile / tile.std(), dtype=np.float32)


class NoiseTile:
    """The noise as the renderer samples it: three periods each way, so that a view seldom meets the border.

    Wrapping at a border is exact but many times slower. A second copy lies transposed: a view that runs along the
    tile's columns is sampled from there, in the order of memory.
    """

    def __init__(self, seed: int) -> None:
        levels = np.rint(noise_period(seed) * LEVELS_PER_RMS + ZERO_LEVEL)
        period = np.clip(levels, 0, 65535).astype(np.uint16)
        self.upright: Image16 = np.tile(period, (_REPEATS, _REPEATS))
        self.transposed: Image16 = np.tile(np.ascontiguousarray(period.T), (_REPEATS, _REPEATS))

    def along_rows(self, texel_from_cell: Floats) -> tuple[Image16, Floats]:
        """The copy whose rows the image's rows follow best, and the map (3, 3) into it."""
        if abs(texel_from_cell[0, 0]) >= abs(texel_from_cell[1, 0]):
            return self.upright, texel_from_cell
        return self.transposed, texel_from_cell[[1, 0, 2]]


def within_tile(texel_from_cell: Floats, width: int, height: int) -> Floats:
    """Shift maps (k, 3, 3) by whole periods so that the corners of a ``width`` x ``height`` view start in the first."""
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], dtype=np.float64)
    mapped = corners @ texel_from_cell.transpose(0, 2, 1)
    lowest = np.min(mapped[..., :2] / mapped[..., 2:], axis=1)
    shifted = texel_from_cell.copy()
    shifted[:, :2] -= (np.floor(lowest / PERIOD_TEXELS) * PERIOD_TEXELS)[..., None] * texel_from_cell[:, 2:]
    return np.asarray(shifted)


def octaves_of(seed: int, surface: int) -> tuple[Octave, ...]:
    """Place every octave on a surface."""
    generator = np.random.default_rng([seed, surface])
    start = generator.uniform(0.0, 2.0 * math.pi)
    placed = []
    for number, exponent in enumerate(range(_COARSEST, _FINEST + 1)):
        angle = start + number * _GOLDEN_ANGLE_RAD
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        placed.append(Octave(2.0**exponent, turn, generator.uniform(0.0, PERIOD_TEXELS, 2)))
    return tuple(placed)


def weight(cycles_per_px: Floats, width_px: int) -> Floats:
    """Weight (n,) of an octave with so many cycles per pixel: lens and pixel response, nothing unresolved or unseen."""
    logs, table = _weight_table(width_px)
    return np.interp(np.log2(cycles_per_px), logs, table)


def visible_cycles_per_px(width_px: int) -> tuple[float, float]:
    """Least and most cycles per pixel of an octave that has any weight."""
    return 0.5 / width_px, _FADE_TO


@functools.cache
def _weight_table(width_px: int) -> tuple[Floats, Floats]:
    logs = np.linspace(-12.0, 2.0, 1401)
    return logs, _weight(2.0**logs, width_px)


def _weight(cycles_per_px: Floats, width_px: int) -> Floats:
    blur = np.exp(-2.0 * (math.pi * _LENS_SIGMA_PX * cycles_per_px) ** 2) * np.sinc(cycles_per_px)
    fine = 1.0 - _smooth(np.log2(cycles_per_px / _FADE_FROM) / math.log2(_FADE_TO / _FADE_FROM))
    coarse = _smooth(np.log2(cycles_per_px * width_px) + 1.0)  # a wave twice as long as the image is only brightness
    return np.asarray(blur * fine * coarse)


def _smooth(u: Floats) -> Floats:
    clipped = np.clip(u, 0.0, 1.0)
    return np.asarray(clipped**2 * (3.0 - 2.0 * clipped))
