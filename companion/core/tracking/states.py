"""Where each state and each constant error lives, and the constants' priors.

The *fast* state is what moves (modes, gust loads, rigid roll, drifting biases); the *constants* are errors that do not
move in a flight (scale, misalignment, stamp offset, slope factor, trim; the biases of the root's rates wander slowly,
and what is known of them ages). The filter carries the fast state together with its exact sensitivity to every constant
(Friedland's separated bias estimation, IEEE TAC 14, 1969), so that a constant costs one column instead of one state.

Rows of a measurement: of both tips the mean and the first moment of the vertical axis, the bending slope seen by the
lateral axis and the roll rate; then the root's roll rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.params.airframe import Airframe, Mode, Sensor, Uncertain
from companion.records import Floats
from companion.units import GRAVITY_MPS2

ROWS = 9
Z_LEFT, Z_RIGHT, M_LEFT, M_RIGHT, Y_LEFT, Y_RIGHT, P_LEFT, P_RIGHT, P_ROOT = range(ROWS)
FAMILY_STATES = 8
SENSOR_ERRORS = ("kz", "ky", "kp", "mx", "my", "mz", "tau")
ROOT_ERRORS = ("bp", "br")  # biases of its rates: the tips' centripetal force is reckoned from them

_ABSENT_MPS2 = 10.0  # sigma of the root's force along an axis that it does not send
_SECOND_RATIO = 5.5  # of an unknown second mode's frequency: 6.3 for a bare cantilever, less with a tip mass
_SECOND_SPREAD = 0.3
_STAMP_JITTER_S = 3e-4  # of an autopilot that stamps at the instant of sending
_USUAL_TURN_RADPS2 = 1.0  # roll acceleration


@dataclass(frozen=True, slots=True)
class Family:
    """Indices of the modes that move both tips alike (``sign`` = +1, +1) or against each other (-1, +1).

    The states are deflection and rate, the gust's two poles, and the same of the second mode.
    """

    q: int
    v: int
    gust_1: int
    gust_2: int
    q2: int
    v2: int
    sign: tuple[float, float]
    mode: Mode
    second: Mode

    @property
    def span(self) -> slice:
        """All its states."""
        return slice(self.q, self.q + FAMILY_STATES)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The map of the state vector; each is itself alone, so that what hangs on it can be kept.

    Attributes
    ----------
    size : int
        Number of fast states.
    roll, turn : int
        Rigid roll rate and roll acceleration.
    bias : tuple of (row, index)
        The rows that have a bias, relative to the root's where that matters, and the state that holds it.
    constants : tuple of str
        Names, ``left.kz`` and so on.
    constant_sigma : (c,) float64
    """

    symmetric: Family
    antisymmetric: Family
    size: int
    roll: int
    turn: int
    bias: tuple[tuple[int, int], ...]
    constants: tuple[str, ...]
    constant_sigma: Floats

    def column(self, name: str) -> int | None:
        """Column of a constant in ``[state | sensitivities]``, None where its prior has no width."""
        return self.constants.index(name) + 1 if name in self.constants else None

    @property
    def families(self) -> tuple[Family, Family]:
        """Symmetric, antisymmetric."""
        return self.symmetric, self.antisymmetric

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Indices of deflection and rate of every mode."""
        return [pair for family in self.families for pair in ((family.q, family.v), (family.q2, family.v2))]

    @property
    def biases(self) -> slice:
        """All bias states."""
        return slice(self.turn + 1, self.size)


def make_layout(airframe: Airframe) -> Layout:
    """Lay out the states that this airframe needs."""
    wing = airframe.wing
    symmetric = _family(0, (1.0, 1.0), wing.symmetric, wing.second_symmetric)
    antisymmetric = _family(FAMILY_STATES, (-1.0, 1.0), wing.antisymmetric, wing.second_antisymmetric)
    rows = [
        first + side
        for first, axis in ((Z_LEFT, "z"), (Y_LEFT, "y"), (P_LEFT, "p"))
        for side, sensor in ((0, airframe.left), (1, airframe.right))
        if axis in sensor.sends
    ]
    roll = 2 * FAMILY_STATES
    bias = tuple((row, roll + 2 + at) for at, row in enumerate(rows))
    named = [(name, sigma) for name, sigma in _constants(airframe) if sigma > 0.0]
    return Layout(
        symmetric=symmetric,
        antisymmetric=antisymmetric,
        size=roll + 2 + len(bias),
        roll=roll,
        turn=roll + 1,
        bias=bias,
        constants=tuple(name for name, _ in named),
        constant_sigma=np.array([sigma for _, sigma in named]),
    )


def _family(at: int, sign: tuple[float, float], mode: Mode, second: Mode | None) -> Family:
    return Family(at, at + 1, at + 2, at + 3, at + 4, at + 5, sign, mode, second or unknown_second(mode))


def unknown_second(mode: Mode) -> Mode:
    """A second mode about which nothing was said: it is there, somewhere, and has to be found."""
    ratio = _SECOND_RATIO
    frequency = ratio * mode.frequency_hz.value
    slope = mode.slope_factor_radpm.value * 3.4  # of a cantilever with a tip mass; it hardly bends the tip
    return Mode(
        frequency_hz=Uncertain(frequency, _SECOND_SPREAD * frequency),
        damping=Uncertain(0.02, 0.015),
        slope_factor_radpm=Uncertain(slope, 0.3 * slope),
    )


def _constants(airframe: Airframe) -> list[tuple[str, float]]:
    wing = airframe.wing
    named = [
        ("trim", wing.trim_bend_m.sigma),
        ("bend_per_g", wing.bend_per_g_m.sigma),
        ("slope.symmetric", wing.symmetric.slope_factor_radpm.sigma),
        ("slope.antisymmetric", wing.antisymmetric.slope_factor_radpm.sigma),
    ]
    if wing.second_symmetric is not None:
        named.append(("slope.second_symmetric", wing.second_symmetric.slope_factor_radpm.sigma))
    if wing.second_antisymmetric is not None:
        named.append(("slope.second_antisymmetric", wing.second_antisymmetric.slope_factor_radpm.sigma))
    for place, sensor in (("left", airframe.left), ("right", airframe.right), ("root", airframe.root)):
        named += [(f"{place}.{error}", _error_sigma(sensor, error)) for error in SENSOR_ERRORS]
    named.append(("bz", _common_bias_sigma(airframe)))
    root = airframe.root
    named += [(f"root.{error}", root.gyro_bias_sigma_radps) for error in ROOT_ERRORS if error[-1] in root.sends]
    return named


def _common_bias_sigma(airframe: Airframe) -> float:
    """Of what the vertical biases have in common, their mean weighted by how well each is known; 0 where not wanted.

    The lateral axis shows slope times force, so that a tip's vertical bias makes every slope too large. The states hold
    biases against the root; with their common part they are each one's own. A scale error that is as uncertain says
    the same already.
    """
    tips = (airframe.left, airframe.right)
    told = all("y" in tip.sends and "z" in tip.sends for tip in tips)
    sigmas = [sensor.accel_bias_sigma_mps2 for sensor in (*tips, airframe.root)]
    if not told or min(sigmas) <= max(tip.accel_scale_sigma for tip in tips) * GRAVITY_MPS2:
        return 0.0
    return float(np.sum(np.power(sigmas, -2.0)) ** -0.5)


def _error_sigma(sensor: Sensor, error: str) -> float:
    axis = error[-1]
    if error == "tau":
        return sensor.time_offset_sigma_s
    if error == "kp":
        return sensor.gyro_scale_sigma if "p" in sensor.sends else 0.0
    if error[0] == "k":
        return sensor.accel_scale_sigma if axis in sensor.sends else 0.0
    return sensor.misalignment_sigma_rad


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the cell averages.

    Attributes
    ----------
    own : (9,) float64
        Variance of each row by its own sensor.
    root_z, root_y : float
        Variance that the root's accelerometer adds to both tips at once.
    bias_prior : (b, b) float64
        Prior covariance of the biases.
    own_bias : (2, 2) float64
        Of each tip's own vertical bias beside what all three have in common, the shares of the states that hold left's
        and right's against the root.
    bias_time_s : float
        Their correlation time.
    sample_s : float
        Time between two samples of a tip.
    """

    own: Floats
    root_z: float
    root_y: float
    bias_prior: Floats
    own_bias: Floats
    bias_time_s: float
    sample_s: float


def make_noise(airframe: Airframe, layout: Layout, step_s: float) -> Noise:
    """Noise per cell: a one-sided density S averaged over ``step_s`` has variance S / (2 step).

    Its first moment, ``integral (t - middle) n dt / step^2``, has a twelfth of that.
    """
    root, tips = airframe.root, (airframe.left, airframe.right)
    per_cell = 1.0 / (2.0 * step_s)
    accel = [sensor.accel_noise_mps2_rthz**2 * per_cell for sensor in tips]
    gyro = [sensor.gyro_noise_radps_rthz**2 * per_cell for sensor in (*tips, root)]
    root_accel = root.accel_noise_mps2_rthz**2 * per_cell
    gyro[-1] += _undone_gain(root, step_s) * (_STAMP_JITTER_S * _USUAL_TURN_RADPS2) ** 2
    return Noise(
        own=np.array([*accel, accel[0] / 12.0, accel[1] / 12.0, *accel, *gyro]),
        root_z=root_accel if "z" in root.sends else _ABSENT_MPS2**2,
        root_y=root_accel if "y" in root.sends else _ABSENT_MPS2**2,
        bias_prior=_bias_prior(airframe, layout),
        own_bias=_own_bias(airframe),
        bias_time_s=max(min(sensor.bias_time_s for sensor in (root, *tips)), step_s),
        sample_s=1.0 / min(sensor.rate_hz for sensor in tips),
    )


def _own_bias(airframe: Airframe) -> Floats:
    """``b_left = common + (w_right + w_root) (b_left - b_root) - w_right (b_right - b_root)``, and so for the right."""
    sigmas = np.array([sensor.accel_bias_sigma_mps2 for sensor in (airframe.left, airframe.right, airframe.root)])
    if not sigmas.all():
        return np.zeros((2, 2))
    left, right, root = sigmas**-2.0 / np.sum(sigmas**-2.0)
    return np.array([[right + root, -right], [-left, left + root]])


def _undone_gain(root: Sensor, step_s: float) -> float:
    """By how much undoing the root's low-pass raises the variance of what is wrong with single samples.

    That is ``|1/H|^2 = 1 + (f/cutoff)^4`` over what smoothing and averaging over the cells let through.
    """
    if root.lowpass_gyro_hz <= 0.0:
        return 0.0
    f = np.linspace(0.0, 0.5 * root.rate_hz, 200)
    passed = np.cos(np.pi * f * step_s) ** 4 * np.sinc(f * step_s) ** 2
    return float(np.mean((1.0 + (f / root.lowpass_gyro_hz) ** 4) * passed))


def _bias_prior(airframe: Airframe, layout: Layout) -> Floats:
    """Vertical and lateral rows are differences to the root and share its bias.

    So do the roll rates: the rigid roll rate of the state is the one that the root's gyro shows, bias included.
    """
    prior = np.zeros((len(layout.bias), len(layout.bias)))
    root, tips = airframe.root, (airframe.left, airframe.right)
    for i, (row, _) in enumerate(layout.bias):
        gyro = row >= P_LEFT
        sensor = tips[row % 2]
        prior[i, i] = (sensor.gyro_bias_sigma_radps if gyro else sensor.accel_bias_sigma_mps2) ** 2
        shared = root.gyro_bias_sigma_radps if gyro else root.accel_bias_sigma_mps2
        for j, (other, _) in enumerate(layout.bias):
            if other // 2 == row // 2:
                prior[i, j] += shared**2
    return prior
