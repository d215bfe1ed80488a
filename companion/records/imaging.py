"""Images with their measured exposure, and matched features."""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.records.vocabulary import Bytes, ClockName, Floats, Ints, Side

PLAN_UNKNOWN = -1
"""No camera knows which plan opened its shutter; pairing by exposure time is the service's business (convention)."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One image with its measured exposure.

    Attributes
    ----------
    image : (rows, columns) uint8
    mid_exposure_ns : int
        Middle of the exposure of the middle row, on ``clock``.
    row_time_ns : int
        Time between the starts of two rows; 0 for a global shutter.
    plan_id : int
        The plan that fired it, or :data:`PLAN_UNKNOWN`.
    """

    side: Side
    sequence: int
    clock: ClockName
    mid_exposure_ns: int
    exposure_ns: int
    row_time_ns: int
    plan_id: int
    image: Bytes


@dataclass(frozen=True, slots=True)
class FramePair:
    """A left and a right frame of the same shot."""

    pair_id: int
    left: Frame
    right: Frame


@dataclass(frozen=True, slots=True)
class Flow:
    """Features of a left image found again in the left image of an earlier pair: what the flight moved meanwhile.

    Attributes
    ----------
    earlier_pair_id : int
        The earlier pair.
    index : (m,) int64
        Their places among the matches of the pair.
    earlier_px : (m, 2) float64
        Column, row in the earlier image, raw (distorted) pixels.
    sigma_px : (m,) float64
        One-sigma of either coordinate.
    """

    earlier_pair_id: int
    index: Ints
    earlier_px: Floats
    sigma_px: Floats


@dataclass(frozen=True, slots=True)
class MatchSet:
    """Matched features of one pair, in raw (distorted) pixels: what vision hands to the correction.

    Attributes
    ----------
    left_px, right_px : (n, 2) float64
        Column, row of each match.
    sigma_px : (n,) float64
        One-sigma of the match along the epipolar line.
    mid_exposure_ns : (2,) int64
        Left and right mid-exposure on ``clocks``.
    filled : int
        So many at the end are no features but places between them, found by dense disparity: for the obstacle picture.
    flow : Flow or None
        Features that the left image of an earlier pair shows too.
    """

    pair_id: int
    plan_id: int
    clocks: tuple[ClockName, ClockName]
    mid_exposure_ns: Ints
    exposure_ns: int
    row_time_ns: int
    left_px: Floats
    right_px: Floats
    sigma_px: Floats
    matched_host_ns: int
    filled: int = 0
    flow: Flow | None = None

    def features(self) -> MatchSet:
        """The same without what fills the picture: ranges and rotations are taken from features alone."""
        if not self.filled:
            return self
        triangulated = slice(0, len(self.sigma_px) - self.filled)
        return replace(
            self,
            left_px=self.left_px[triangulated],
            right_px=self.right_px[triangulated],
            sigma_px=self.sigma_px[triangulated],
            filled=0,
        )
