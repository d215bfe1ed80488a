"""Rules of trust of ranges: matches against the sensors, a range or obstacle by itself, or against earlier ones.

A blow, a wrong stamp or an error of the tracker can turn a camera unnoticed. This shows in two ways. The matches leave
an innovation: a rotation beyond the predicted one. And the range jumps. Either reopens the drift filter: the sigma of
the toe grows at once to that of a blow (:data:`KNOCK_RAD`), and ranges are trusted again when matches have measured
the toe anew. Equations and limits: GATES.md.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.inverse_depth import RangeProduct
from companion.core.stereo.vehicle_motion import LEVEL_RAD
from companion.params.settings import Settings
from companion.records import Bools, CorrectedRange, Floats, Ints, Reject

KNOCK_RAD = 0.005
"""Sigma, per axis, of the turn by a blow or by an undetected fault of the tracker (choice)."""
RANGE_MEMORY_NS = 2_000_000_000
"""A range older than this is not compared with a new one: at flight speed the surface is another (choice)."""
_CONSISTENT_SIGMAS = 4.0  # a jump by chance once in 16,000 pairs of Gaussian ranges (choice)
_AGREEING_TO_TRUST = 3  # ranges in a row: wrong ones do not agree three times by chance (choice)
_FRESH_NS = 500_000_000  # so long one agreement with a trusted range is enough (choice)
_CONFIRMED_SIGMAS = 2.0  # of the first range after the toe was learnt anew: of sound ones 95 % pass at once (choice)
_AGREEING_ANEW = 2  # ranges after the toe was learnt anew that must agree, if the first does not pass (choice)
_APART_TO_DOUBT = 2  # ranges away from the trusted one: one may be a wrong match, two are not (choice)
_SURFACE_NS = 5_000_000_000  # a new surface must stay so long where no matches test the toe (choice)
_OUTLIER_SQUARE = 30.7  # chi-square of three degrees of freedom: one in a million (derived)
_OUTLIERS_TO_REOPEN = 3  # in a row: a stamp is wrong for one pair, a camera stays turned (choice)
_ALLOWED_SIGMAS = 1.0  # Page's test finds shifts of twice this soonest (choice)
# threshold of the sums of Page's test (choice; judged by sitl_tests/faults/camera_faults.py)
_KNOCKED_SIGMAS = 10.0
_DOUBT_SIGMAS = 2.5  # chance explains one innovation in eighty beyond this (choice)
_TERRAIN_SLACK_MPS = 8.0  # slope of terrain under a downward pair at flight speed (choice)
_STEEPEST = 1.0  # steepest slope of terrain, trees and houses, where the flow of a pair confirms its toe (choice)
_OBSTACLE_MATCHES = 2  # matches that agree: one wrong match is no obstacle (choice)
_CLEAR_MATCHES = 3  # far matches that clear a sector: two wrong ones may agree, three hardly (choice)
_OBSTACLE_SIGMAS = 3.0  # largest difference of two distances of one obstacle, by noise (choice)
_OBSTACLE_DEPTH = 0.1  # depth of one obstacle over its distance: a tree's crown is one obstacle (choice)
_SURE_SIGMAS = 2.0  # a clear sector is beyond the largest range in 97.7 % of cases (derived)
_CARRIED = 0.5  # share of the granted variance that the next pair has: stamps may be wrong again (choice)


class MatchVerdict(enum.Enum):
    """Result of the test of a pair's matches against the believed rotation."""

    AGREE = enum.auto()
    OUTLIER = enum.auto()
    KNOCKED = enum.auto()


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """Rotation (3,), rad, by the matches beyond the predicted one, and its covariance (3, 3) without a fault, rad^2."""

    rotation_rad: Floats
    covariance: Floats

    def loosened(self, covariance: Floats) -> Innovation:
        """The same with more covariance, (3, 3) rad^2."""
        return Innovation(self.rotation_rad, self.covariance + covariance)


@dataclass(slots=True)
class MatchTest:
    """Test of the matches against the predicted relative rotation of the cameras, pair by pair and over pairs.

    One pair shows pitch and roll well and yaw weakly. A pair whose innovation has a normalised square that chance does
    not give is an outlier: its stamp is wrong, or a camera has just been turned. Several outliers in a row mean a
    turned camera. A fault that no single pair shows is found by the cumulative sums of each axis' normalised innovation
    (Page's test, two-sided). Until then an axis is granted the variance of its innovation beyond two and a half sigma,
    and the next pair half of that.
    """

    _sums: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    _doubt_rad2: Floats = field(default_factory=lambda: np.zeros(3))
    _outliers: int = 0  # in a row

    def take(self, innovation: Innovation) -> tuple[MatchVerdict, Floats]:
        """Judge one pair. Also give the covariance (3, 3), rad^2, that its innovation is granted."""
        sigma_rad = np.sqrt(np.diag(innovation.covariance))
        square = innovation.rotation_rad @ np.linalg.solve(innovation.covariance, innovation.rotation_rad)
        if square > _OUTLIER_SQUARE:
            self._outliers += 1
        else:
            unit = innovation.rotation_rad / sigma_rad
            self._sums = np.maximum(self._sums + np.stack([unit, -unit]) - _ALLOWED_SIGMAS, 0.0)
            self._outliers = 0
        if self._outliers >= _OUTLIERS_TO_REOPEN or self._sums.max() > _KNOCKED_SIGMAS:
            self._sums, self._doubt_rad2, self._outliers = np.zeros((2, 3)), np.zeros(3), 0
            return MatchVerdict.KNOCKED, np.zeros((3, 3))
        beyond_rad2 = np.maximum(innovation.rotation_rad**2 - (_DOUBT_SIGMAS * sigma_rad) ** 2, 0.0)
        self._doubt_rad2 = np.maximum(np.minimum(beyond_rad2, KNOCK_RAD**2), _CARRIED * self._doubt_rad2)
        if self._outliers:
            return MatchVerdict.OUTLIER, KNOCK_RAD**2 * np.eye(3)
        return MatchVerdict.AGREE, np.diag(self._doubt_rad2)


@dataclass(slots=True)
class RangeGate:
    """Trust a range when it agrees with the ranges before it, the last trusted one and the climb rate.

    A range that passed its own checks is compared with the last one, moved on by the climb rate (the range of cameras
    that look down grows in a climb). Ranges to the ground are compared as heights: in a bank the range grows by
    1/cos(bank), and the ground has not moved. ``_AGREEING_TO_TRUST`` ranges must agree among themselves. One that
    agrees with a trusted one just before is trusted at once. Ranges that have left the last trusted one are not trusted
    for agreeing with each other: either the surface or the cameras have changed, and ``jumped`` asks that the toe be
    learnt anew.
    After that (:meth:`reopened`) the sigma of a range is what matches have measured since. The first one must lie close
    to the last trusted one, or agree with the next. Several that agree are a new surface. Where no matches are used, a
    new surface must stay for ``_SURFACE_NS``.

    These rules are for a view of one lasting surface, the ground. A pair that looks ahead sees another obstacle every
    few seconds (``lasting_surface`` false). There a jump is no evidence against the toe, and several ranges that agree
    are enough.
    """

    closing_mps_per_climb: float
    lasting_surface: bool = True
    _last: _RangeAt | None = None
    _trusted: _RangeAt | None = None
    _departed: _RangeAt | None = None  # first range that left the last trusted one
    _agreeing: int = 0
    _apart: int = 0  # ranges since then that have not come back
    _reopened: bool = False

    @property
    def jumped(self) -> bool:
        """Whether ranges have left the last trusted one and the toe has not been doubted since."""
        return self.lasting_surface and self._apart >= _APART_TO_DOUBT and not self._reopened

    def reopened(self) -> None:
        """Begin to count anew: from here on the toe is learnt anew, and ranges before do not count."""
        self._reopened, self._agreeing = True, 0

    def judge(
        self,
        measured: CorrectedRange,
        climb_mps: float,
        slack_mps: float,
        lasting_m: float = 0.0,
        attitude_rad: tuple[float, float] | None = None,
    ) -> CorrectedRange:
        """Withdraw the trust of a range that jumps.

        Parameters
        ----------
        measured : CorrectedRange
            Newest range.
        climb_mps : float
            Climb rate, m/s, up positive.
        slack_mps : float
            Further rate of the range by terrain and speed, m/s: :func:`range_slack_mps`.
        lasting_m : float
            The part of its sigma that neighbouring ranges share, m. It explains no jump.
        attitude_rad : tuple of float, optional
            Roll and pitch at the exposures; without them the aircraft counts as level.
        """
        if not measured.trusted:
            return measured
        tilt_rad = attitude_rad if attitude_rad is not None and self.lasting_surface else (0.0, 0.0)
        level = _RangeAt.of(measured, min(lasting_m, measured.sigma_m), *tilt_rad)
        moving = _Moving(self.closing_mps_per_climb * climb_mps, slack_mps)
        follows = self._last is not None and level.t_ns - self._last.t_ns < RANGE_MEMORY_NS
        agrees = follows and moving.agree(self._last, level)
        self._agreeing = self._agreeing + 1 if agrees else 1
        self._last = level
        if not self._trustworthy(level, moving):
            return dataclasses.replace(measured, trusted=False, reject=Reject.INCONSISTENT)
        self._trusted, self._departed, self._apart, self._reopened = level, None, 0, False
        return measured

    def _trustworthy(self, level: _RangeAt, moving: _Moving) -> bool:
        several = self._agreeing >= _AGREEING_TO_TRUST
        if self._trusted is None:
            return several
        if moving.agree(self._trusted, level) and not self._stays_apart(level, moving):
            self._departed, self._apart = None, 0
            fresh = level.t_ns - self._trusted.t_ns < (RANGE_MEMORY_NS if self._reopened else _FRESH_NS)
            confirmed = self._agreeing >= _AGREEING_ANEW or moving.confirms(self._trusted, level)
            return several or (fresh and (confirmed or not self._reopened))
        if self._departed is None or self._agreeing == 1:
            self._departed = level
        self._apart += 1
        stayed = level.t_ns - self._departed.t_ns >= _SURFACE_NS
        return several and (not self.lasting_surface or self._reopened or stayed)

    def _stays_apart(self, level: _RangeAt, moving: _Moving) -> bool:
        """Whether a range lies nearer to those that departed: the slack, which grows with time, must not accept it."""
        if self._departed is None or self._trusted is None:
            return False
        return moving.between_m(self._departed, level) < moving.between_m(self._trusted, level)


@dataclass(frozen=True, slots=True)
class _RangeAt:
    """Range, sigma and time of a judged pair, as the gate remembers it: vertical, if the aircraft looks down.

    ``per_tilt_m`` is the derivative of the height by roll and by pitch, m/rad.
    """

    t_ns: int
    range_m: float
    sigma_m: float
    lasting_m: float
    per_tilt_m: tuple[float, float]

    @classmethod
    def of(cls, measured: CorrectedRange, lasting_m: float, roll_rad: float, pitch_rad: float) -> _RangeAt:
        """Turn a range along body z into the height ``Z cos(roll) cos(pitch)`` over level ground."""
        range_m, upright = measured.range_m, math.cos(roll_rad) * math.cos(pitch_rad)
        by_roll_m = -range_m * math.sin(roll_rad) * math.cos(pitch_rad)
        by_pitch_m = -range_m * math.cos(roll_rad) * math.sin(pitch_rad)
        sigma_m, lasting_m = abs(upright) * measured.sigma_m, abs(upright) * lasting_m
        return cls(measured.t_host_ns, upright * range_m, sigma_m, lasting_m, (by_roll_m, by_pitch_m))


@dataclass(frozen=True, slots=True)
class _Moving:
    """Change of ranges with time: a known rate, and a slack to both sides, m/s."""

    rate_mps: float
    slack_mps: float

    def between_m(self, before: _RangeAt, after: _RangeAt) -> float:
        """Absolute difference of a range from the prediction by an earlier one, m."""
        return abs(after.range_m - before.range_m - self.rate_mps * 1e-9 * (after.t_ns - before.t_ns))

    def agree(self, before: _RangeAt | None, after: _RangeAt) -> bool:
        """Whether both may be of one surface, seen by cameras that have not turned."""
        if before is None or after.t_ns <= before.t_ns:
            return False
        slack_m = self.slack_mps * 1e-9 * (after.t_ns - before.t_ns)
        return self.between_m(before, after) <= _CONSISTENT_SIGMAS * _parting_sigma_m(before, after) + slack_m

    def confirms(self, before: _RangeAt, after: _RangeAt) -> bool:
        """Whether the earlier one predicts the later one closely, without slack."""
        return self.between_m(before, after) <= _CONFIRMED_SIGMAS * _parting_sigma_m(before, after)


def _parting_sigma_m(before: _RangeAt, after: _RangeAt) -> float:
    """Sigma of the difference of two ranges, less the part that they share, m.

    The axes of the autopilot against those of the cameras err by a constant, which shows as the attitude changes.
    """
    shared_m2 = min(before.lasting_m, after.lasting_m) ** 2
    level_m = LEVEL_RAD * math.dist(before.per_tilt_m, after.per_tilt_m)
    return math.sqrt(max(before.sigma_m**2 + after.sigma_m**2 - 2.0 * shared_m2, 0.0) + level_m**2)


# ------------------------------------------------------------------------------------ one range, one obstacle


def range_reject(matches: int, range_m: float, sigma_m: float, settings: Settings) -> Reject | None:
    """Reason not to trust one range by itself (few matches, out of range, large sigma); None where it is sound."""
    if matches < settings.min_matches and settings.product != RangeProduct.NEAREST:
        return Reject.NO_MATCHES
    if not settings.min_range_m <= range_m <= settings.max_range_m:
        return Reject.OUT_OF_RANGE
    if not sigma_m <= settings.trust_ratio * range_m:  # NaN, too, is no sigma
        return Reject.SIGMA_TOO_LARGE
    return None


def ground_reject(on_ground: bool | None) -> Reject | None:
    """Reason not to trust a pair of an aircraft on the ground; None in the air, and where its state is unknown.

    Wheels carry the weight, and bumps excite the wing: neither the static bend nor the spectrum of the excitation is
    that of the model in flight.
    """
    return Reject.ON_GROUND if on_ground else None


def withheld(measured: CorrectedRange, reason: Reject | None) -> CorrectedRange:
    """The range, not trusted where the wing, the stamps or the matches give a reason: that is named before its own."""
    if reason is None:
        return measured
    return dataclasses.replace(measured, trusted=False, reject=reason)


def range_slack_mps(looks_down: bool, airspeed_mps: float, *, toe_confirmed: bool) -> float:
    """Rate at which a range may change beyond the climb rate, m/s: terrain, and ahead the closing speed.

    ``toe_confirmed`` is whether the flow of this very pair agrees with the estimated toe. A jump is then the surface's,
    up to a slope of 45 degrees, and no sign of turned cameras.
    """
    if not looks_down:
        return _TERRAIN_SLACK_MPS + airspeed_mps
    return max(_TERRAIN_SLACK_MPS, _STEEPEST * airspeed_mps) if toe_confirmed else _TERRAIN_SLACK_MPS


def precise(inverse_pm: Floats, sigma_pm: Floats, settings: Settings) -> Bools:
    """Whether (n,) inverse depths, 1/m, are known to the trust ratio; False where one is not a number."""
    precise_enough: Bools = sigma_pm <= settings.trust_ratio * inverse_pm
    return precise_enough


def surely_beyond(inverse_pm: Floats, sigma_pm: Floats, slant: Floats, settings: Settings) -> Bools:
    """Whether (n,) points lie beyond the largest range; ``slant`` is their horizontal distance per unit of depth.

    Rays that diverge by more than two sigma meet nowhere. They are a wrong match, which clears nothing.
    """
    room = _SURE_SIGMAS * sigma_pm
    beyond: Bools = ((inverse_pm + room) * settings.max_range_m < slant) & (inverse_pm > -room)
    return beyond


def clears(far_matches: Ints) -> Bools:
    """Whether counts (n,) of far matches clear their sectors."""
    return far_matches >= _CLEAR_MATCHES


def nearest_supported(distance_m: Floats, sigma_m: Floats) -> tuple[float, float]:
    """Nearest distance on which enough points (n,) agree, and its sigma, m; zeros without one."""
    for index in np.argsort(distance_m, kind="stable"):
        gap = np.abs(distance_m - distance_m[index])
        allowed = np.maximum(_OBSTACLE_SIGMAS * np.hypot(sigma_m, sigma_m[index]), _OBSTACLE_DEPTH * distance_m[index])
        alike = gap <= allowed
        if np.count_nonzero(alike) >= _OBSTACLE_MATCHES:
            group, weight = distance_m[alike], sigma_m[alike] ** -2.0
            return float(np.average(group, weights=weight)), float(sigma_m[alike].min())
    return 0.0, 0.0
