"""States of the epipolar filter, their order, and their priors before a pair's matches.

The wing tracker's slow error (trim bend, tilt bias) turns the cameras about one axis that the rig determines. It is a
state, so that it has the tracker's own sigma: see :class:`BendBelief`. An error of scale of the tracker (gyros, slope
factor) turns the cameras by a constant fraction of the fast bend. It is another state, learned over pairs.

Matches of one pair, and of consecutive pairs, share errors: interpolation, lenses and blur leave hundredths of a pixel
that stay in their places. Across the epipolar lines they look like a yaw. This false yaw is a constant state. It is
observed together with the true yaw, and no number of pairs separates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.lens_residual import CONSIDERED, CONSIDERED_IN_FLOW, PAIR_TERMS
from companion.records import Floats

PITCH, YAW, ROLL, BASELINE_Y, BASELINE_Z = range(5)
BASELINE = slice(BASELINE_Y, BASELINE_Z + 1)
PARALLAX_STATES = BASELINE_Z + 1 + PAIR_TERMS  # states with a column of their own in the parallax (by definition)
LENS = slice(BASELINE_Z + 1, PARALLAX_STATES)
CONSIDERED_STATES = [LENS.start + term for term in CONSIDERED]
CONSIDERED_IN_FLOW_STATES = [LENS.start + term for term in CONSIDERED_IN_FLOW]
BEND, YAW_BIAS, BEND_SCALE = range(PARALLAX_STATES, PARALLAX_STATES + 3)
SLOW_STATES = BEND_SCALE + 1  # states of the slow part (by definition)
FAST = slice(SLOW_STATES, SLOW_STATES + 3)
# errors of velocity over ground (m/s) and of rates of turn (rad/s), which predict the flow
VELOCITY, TURN_RATE = slice(FAST.stop, FAST.stop + 3), slice(FAST.stop + 3, FAST.stop + 6)
FLIGHT = slice(VELOCITY.start, TURN_RATE.stop)
PERSISTENT_STATES = TURN_RATE.stop  # states that stay from pair to pair
# and two of this pair's baseline direction, three of its innovation (by definition)
ALL_STATES = PERSISTENT_STATES + 5
SHIFT = slice(PERSISTENT_STATES, PERSISTENT_STATES + 2)
INNOVATION = slice(PERSISTENT_STATES + 2, ALL_STATES)

SYSTEMATIC_DOWN_RAD = (1e-4, 3e-4, 1e-4)
"""Sigma of pitch, yaw and roll in rendered pairs over ground whose cameras have not turned, rad (measured)."""

DEFAULT_LENS = (0.0007, 0.002, 0.0006, 0.0006, 0.00024, 0.00024, 0.001, 0.0003, 0.0003)
"""Sigma of a pair's lens terms by the defaults of an airframe's camera (derived)."""


@dataclass(frozen=True, slots=True)
class ExtrinsicsPrior:
    """Prior of the slow relative rotation and of the lens terms, before any pair.

    Attributes
    ----------
    rotation_rad : float
        Sigma about each axis, at the start and after a long time without matches: mounting and thermal set.
    walk_rad_rts : float
        Its random walk, rad per square root of a second. It is pulled back so that its sigma stays ``rotation_rad``.
    baseline_rad : float
        Sigma of the baseline's direction, a constant: mounting, static bend that differs between the wings.
    lens : tuple of float
        Sigma of each term of the lens residual, in the order of ``lens_residual``; constants.
    yaw_bias_rad : float
        Sigma of the false yaw by matching errors that all pairs share; a constant.
    bend_scale : float
        Sigma of the relative error of the fast part of the tracked bend; a constant of a flight.
    turn_rate_radps : float
        Sigma of the root gyro's bias, rad/s, each axis; a constant.
    parallax_rad : float
        Sigma that slanted surfaces and lens models add to every parallax, rad, beyond the stated sigma of the match.
    systematic_rad : tuple of float
        Sigma of the pitch, yaw and roll that interpolation, lenses, slopes and the cameras' places feign for seconds.
        The test for a turned camera allows them.
    """

    rotation_rad: float = 0.005
    walk_rad_rts: float = 0.0005
    baseline_rad: float = 0.001
    lens: tuple[float, ...] = DEFAULT_LENS
    yaw_bias_rad: float = 0.0
    bend_scale: float = 0.0
    turn_rate_radps: float = 0.001
    parallax_rad: float = 0.00005
    systematic_rad: tuple[float, float, float] = SYSTEMATIC_DOWN_RAD

    def variances(self) -> Floats:
        """Variances (14,) of rotation, baseline and lens terms before any pair."""
        sigmas = [self.rotation_rad] * 3 + [self.baseline_rad] * 2 + list(self.lens)
        return np.array(sigmas, dtype=np.float64) ** 2

    @property
    def time_s(self) -> float:
        """Correlation time of the rotation, s: an Ornstein-Uhlenbeck process with this sigma and walk.

        Infinite for a rotation without sigma: it changes only when the filter is reopened.
        """
        if self.rotation_rad <= 0.0:
            return math.inf
        return 2.0 * (self.rotation_rad / max(self.walk_rad_rts, 1e-12)) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class BendBelief:
    """Lasting errors of the wing tracker in the slope common to both tips: a slow one, and one of scale.

    Attributes
    ----------
    direction : (3,) float64
        Relative rotation per radian of that slope, in the epipolar frame.
    sigma_rad : float
        Sigma of the slow error of the slope, now.
    time_s : float
        Correlation time of the slow error: that of the inertial biases.
    fast_rad : float
        Fast part of the tracked slope. An error of scale turns the cameras by a constant fraction of it.
    """

    direction: Floats
    sigma_rad: float
    time_s: float
    fast_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FastBelief:
    """Error of the wing tracker's fast part, a process of first order, and that of the stamps, white.

    Attributes
    ----------
    covariance : (3, 3) float64
        Covariance of pitch, yaw, roll by the fast part in the epipolar frame, now, rad^2.
    time_s : float
        Correlation time of the fast part; 0: independent from pair to pair.
    stamps : (3, 3) float64
        Covariance of the cameras' turn between the stamped exposures and the true ones, rad^2.
    """

    covariance: Floats
    time_s: float = 0.0
    stamps: Floats = field(default_factory=lambda: np.zeros((3, 3)))


NO_BEND = BendBelief(np.zeros(3), 0.0, 1000.0)
NO_SHIFT = np.zeros((2, 2))


def rotation_rows(bend: BendBelief) -> Floats:
    """Rows (3, all states) of the sum of all states in the relative rotation: slow part, fast part, innovation."""
    rows = np.zeros((3, ALL_STATES))
    rows[:, :3] = rows[:, FAST] = rows[:, INNOVATION] = np.eye(3)
    rows[:, BEND], rows[:, BEND_SCALE] = bend.direction, bend.fast_rad * bend.direction
    return rows


def with_lens_rows(rotation: Floats) -> Floats:
    """Rows (12, all states): the three of a rotation, and below them those of the nine lens terms."""
    return np.concatenate([rotation, np.eye(rotation.shape[1])[LENS]])
