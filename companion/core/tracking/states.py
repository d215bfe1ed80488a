"""State vector, measurement rows and bias parameters of the filter, with units, P0, R and the row that each shows in.

*States* move: modes, gust loads, rigid roll, drifting sensor biases. *Bias parameters* stay constant in a flight:
scale, misalignment, stamp offset, trim (the biases of the root's rates and the slope factors wander slowly, and what is
known of them ages). The filter carries the states together with their exact sensitivity to every bias parameter
(separated bias estimation; Friedland, IEEE TAC 14, 1969), so that a parameter costs one column instead of one state.

| state | unit | P0 | Q |
|---|---|---|---|
| ``q``, ``v`` of each mode | m, m/s | stationary | through the load, :mod:`companion.core.tracking.model` |
| ``gust_1``, ``gust_2`` of each mode | m/s^2 | stationary | white noise through two real poles |
| ``roll_rate``, ``roll_accel`` | rad/s, rad/s^2 | 3^2, 21^2 | first-order process, 0.1 Hz, driven by white jerk |
| ``row_bias_states`` | m/s^2, rad/s | ``bias_prior_covariance`` | first-order process, ``bias_time_s`` |

Measurement rows: of both tips the mean and the first moment of the vertical axis (m/s^2), the bending slope seen by the
lateral axis (rad) and the roll rate (rad/s); then the root's roll rate. R: :class:`SensorNoise`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS
from companion.core.wing.foreshortening import foreshortening_pm
from companion.params.airframe import FAMILIES, Airframe, Mode, Sensor, Uncertain, Wing
from companion.records import Floats
from companion.units import GRAVITY_MPS2

ROWS = 9  # measurements of one epoch, in the order of the next line (by definition)
Z_LEFT, Z_RIGHT, M_LEFT, M_RIGHT, Y_LEFT, Y_RIGHT, P_LEFT, P_RIGHT, P_ROOT = range(ROWS)
MODE_STATES = 4  # deflection, rate and two load states (by definition)

_ABSENT_AXIS_SIGMA_MPS2 = 10.0  # chosen, 1 g: sigma of the root's force along an axis that it does not send
_SECOND_FREQUENCY_RATIO = 5.5  # derived: a cantilever's is 6.27 (Euler-Bernoulli), less with a tip mass
_SECOND_FREQUENCY_SIGMA = 0.3  # chosen, relative: covers bare cantilevers and heavy tips
_SIGMA_FLOOR = 1e-9  # numerical: of a slope factor that is certain
_STAMP_JITTER_S = 3e-4  # chosen: of an autopilot that stamps at the instant of sending
_TYPICAL_ROLL_ACCEL_RADPS2 = 1.0  # chosen: turns stamp jitter into an error of the rate


@dataclass(frozen=True, slots=True)
class ModeFamily:
    """Modes that move both tips alike (``sign`` = +1, +1) or against each other (-1, +1): indices and beliefs.

    Each mode has deflection (m at the tip, up), rate and the two poles of its gust load, in this order.

    Attributes
    ----------
    q : int
        Index of the first mode's deflection.
    sign : (float, float)
        Lift of the left and right tip per deflection.
    names : tuple of str
        What the airframe calls each mode.
    modes : tuple of Mode
        Beliefs, the lowest mode first.
    """

    q: int
    sign: tuple[float, float]
    names: tuple[str, ...]
    modes: tuple[Mode, ...]

    @property
    def v(self) -> int:
        """Index of the first mode's rate."""
        return self.q + 1

    @property
    def gust_2(self) -> int:
        """Index of the load on the first mode."""
        return self.q + 3

    @property
    def span(self) -> slice:
        """All states of the family."""
        return slice(self.q, self.q + MODE_STATES * len(self.modes))

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Indices of deflection and rate of every mode."""
        return [(q, q + 1) for q in range(self.q, self.span.stop, MODE_STATES)]


@dataclass(frozen=True, slots=True, eq=False)
class StateLayout:
    """Map of the state vector; compared by identity, so that what depends on it can be cached.

    Attributes
    ----------
    symmetric, antisymmetric : ModeFamily
    size : int
        Number of states n.
    roll_rate, roll_accel : int
        Indices of the rigid roll rate and acceleration.
    row_bias_states : tuple of (row, index)
        Measurement rows with a drifting bias, relative to the root's where that matters, and the state that holds it.
    bias_parameters : tuple of str
        Names, ``left.kz`` and so on, (c,).
    bias_parameter_sigma : (c,) float64
        Prior standard deviations.
    foreshortening : float
        Foreshortening of the bent wing over that of a uniform cantilever.
    tip_y_m : (float, float)
        Body y of the left and right tip station.
    senses_roll : bool
        Whether any station sends the roll rate.
    """

    symmetric: ModeFamily
    antisymmetric: ModeFamily
    size: int
    roll_rate: int
    roll_accel: int
    row_bias_states: tuple[tuple[int, int], ...]
    bias_parameters: tuple[str, ...]
    bias_parameter_sigma: Floats
    foreshortening: float
    tip_y_m: tuple[float, float]
    senses_roll: bool

    def column(self, name: str) -> int | None:
        """Column of a bias parameter in ``[x | V]``; None where its prior has no width."""
        return self.bias_parameters.index(name) + 1 if name in self.bias_parameters else None

    @property
    def families(self) -> tuple[ModeFamily, ModeFamily]:
        """Symmetric, antisymmetric."""
        return self.symmetric, self.antisymmetric

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Indices of deflection and rate of every mode."""
        return [pair for family in self.families for pair in family.pairs]

    @property
    def ranks(self) -> int:
        """Number of modes of the family that has more."""
        return max(len(family.modes) for family in self.families)

    def slope_factor(self, rank: int) -> Uncertain:
        """Slope factor of both families' modes of a rank, rad/m: their mean by the inverse of their variances."""
        factors = [family.modes[rank].slope_factor_radpm for family in self.families if rank < len(family.modes)]
        return _weighted_mean(factors)

    @property
    def slope_factors(self) -> list[tuple[int, int, int, tuple[float, float]]]:
        """Uncertain slope factors: column, deflection and rate state of the mode, sign at left and right tip."""
        terms = []
        for family in self.families:
            for name, (q, v) in zip(family.names, family.pairs, strict=True):
                column = self.column(f"slope.{name}")
                if column is not None:
                    terms.append((column, q, v, family.sign))
        return terms

    @property
    def vertical_only_tips(self) -> tuple[bool, bool]:
        """Whether the left and right tip send neither lateral axis nor roll rate, which would show vibration."""
        rows = {row for row, _ in self.row_bias_states}
        left, right = (rows.isdisjoint((lateral, lateral + P_LEFT - Y_LEFT)) for lateral in (Y_LEFT, Y_RIGHT))
        return left, right

    @property
    def bias_states(self) -> slice:
        """All drifting biases."""
        return slice(self.roll_accel + 1, self.roll_accel + 1 + len(self.row_bias_states))


def make_layout(airframe: Airframe) -> StateLayout:
    """State vector, measurement rows with biases and bias parameters that an airframe needs."""
    wing = airframe.wing
    symmetric = _mode_family(0, (1.0, 1.0), wing, 0)
    antisymmetric = _mode_family(symmetric.span.stop, (-1.0, 1.0), wing, 1)
    rows = [
        first + side
        for first, axis in ((Z_LEFT, "z"), (Y_LEFT, "y"), (P_LEFT, "p"))
        for side, sensor in ((0, airframe.left), (1, airframe.right))
        if axis in sensor.sends
    ]
    roll_rate = antisymmetric.span.stop
    row_bias_states = tuple((row, roll_rate + 2 + at) for at, row in enumerate(rows))
    named = [(name, sigma) for name, sigma in _bias_parameters(airframe) if sigma > 0.0]
    layout = StateLayout(
        symmetric=symmetric,
        antisymmetric=antisymmetric,
        size=roll_rate + 2 + len(row_bias_states),
        roll_rate=roll_rate,
        roll_accel=roll_rate + 1,
        row_bias_states=row_bias_states,
        bias_parameters=tuple(name for name, _ in named),
        bias_parameter_sigma=np.array([sigma for _, sigma in named]),
        foreshortening=wing.shortening.value,
        tip_y_m=(airframe.left.position_m[1], airframe.right.position_m[1]),
        senses_roll=any("p" in sensor.sends for sensor in (airframe.root, airframe.left, airframe.right)),
    )
    foreshortening_sigma = dict(named).get("shortening", 0.0)
    if foreshortening_sigma == 0.0 or layout.ranks == 1:
        return layout
    return replace(
        layout,
        bias_parameters=(*layout.bias_parameters, "further_shortening"),
        bias_parameter_sigma=np.append(
            layout.bias_parameter_sigma, np.hypot(foreshortening_sigma, _foreshortening_by_slope(layout))
        ),
    )


def _foreshortening_by_slope(layout: StateLayout) -> float:
    """Relative sigma of what a second mode adds to the foreshortening, by that of its slope factor, which tells it."""
    second, lever_m = layout.slope_factor(1), abs(layout.tip_y_m[1])
    expected, steeper = (
        foreshortening_pm((0, 1), lever_m, (0.0, slope_radpm))[0, 1]
        for slope_radpm in (second.value, second.value + second.sigma)
    )
    return float(abs(steeper / expected - 1.0)) if expected else 0.0


def _weighted_mean(beliefs: list[Uncertain]) -> Uncertain:
    """Mean of beliefs by the inverse of their variances."""
    weights = np.array([max(belief.sigma, _SIGMA_FLOOR) ** -2.0 for belief in beliefs])
    mean = weights @ np.array([belief.value for belief in beliefs]) / weights.sum()
    return Uncertain(float(mean), float(weights.sum() ** -0.5))


def _mode_family(at: int, sign: tuple[float, float], wing: Wing, parity: int) -> ModeFamily:
    """Family whose states begin at index ``at``: the symmetric (parity 0) or antisymmetric (1) modes of a wing."""
    named, first = wing.family(parity), FAMILIES[parity]
    if len(named) == 1 and wing.assume_second:
        named[f"second_{first}"] = unknown_second(named[first])
    return ModeFamily(at, sign, tuple(named), tuple(named.values()))


def unknown_second(mode: Mode) -> Mode:
    """Prior of a second mode that the airframe does not describe: a cantilever's, with wide sigmas."""
    ratio = _SECOND_FREQUENCY_RATIO
    frequency = ratio * mode.frequency_hz.value
    slope = mode.slope_factor_radpm.value * 3.4  # of a cantilever with a tip mass; it hardly bends the tip
    return Mode(
        frequency_hz=Uncertain(frequency, _SECOND_FREQUENCY_SIGMA * frequency),
        damping=Uncertain(0.02, 0.015),
        slope_factor_radpm=Uncertain(slope, 0.3 * slope),
    )


def _bias_parameters(airframe: Airframe) -> list[tuple[str, float]]:
    """Names and prior sigmas of all bias parameters; sigma 0 where a parameter does not exist."""
    wing = airframe.wing
    named = [
        ("trim", wing.trim_bend_m.sigma),
        ("bend_per_g", wing.bend_per_g_m.sigma),
        *((f"slope.{name}", mode.slope_factor_radpm.sigma) for name, mode in wing.modes.items()),
    ]
    for place, sensor in (("left", airframe.left), ("right", airframe.right), ("root", airframe.root)):
        named += [(f"{place}.{name}", error.sigma(sensor)) for name, error in SENSOR_ERRORS.items()]
    named.append(("bz", _common_bias_sigma(airframe)))
    lateral = any("y" in sensor.sends and "z" in sensor.sends for sensor in (airframe.left, airframe.right))
    foreshortening = wing.shortening
    named.append(
        ("shortening", foreshortening.sigma / foreshortening.value if lateral and foreshortening.value > 0.0 else 0.0)
    )
    return named + [(f"root.{name}", error.sigma(airframe.root)) for name, error in ROOT_ERRORS.items()]


def _common_bias_sigma(airframe: Airframe) -> float:
    """Sigma of the inverse-variance mean of the three z biases, m/s^2; 0 without lateral axes or a certain scale.

    The lateral axis shows slope times force, so that a tip's vertical bias makes every slope too large. The states hold
    biases against the root; with their common part they give each sensor's own. A scale error that is as uncertain has
    the same signature already.
    """
    tips = (airframe.left, airframe.right)
    lateral_and_vertical = all("y" in tip.sends and "z" in tip.sends for tip in tips)
    sigmas = [sensor.accel_bias_sigma_mps2 for sensor in (*tips, airframe.root)]
    if not lateral_and_vertical or min(sigmas) <= max(tip.accel_scale_sigma for tip in tips) * GRAVITY_MPS2:
        return 0.0
    return float(np.sum(np.power(sigmas, -2.0)) ** -0.5)


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of the averaged measurement rows.

    Attributes
    ----------
    sensor_variance : (9,) float64
        Variance of each row by its own sensor.
    root_z_variance, root_y_variance : float
        Variance that the root's accelerometer adds to both tips at once, (m/s^2)^2.
    bias_prior_covariance : (b, b) float64
        Prior covariance of the drifting biases.
    bias_projection : (2, 2) float64
        A tip's own vertical bias is the common bias plus this matrix times the tips' biases against the root.
    bias_time_s : float
        Correlation time of the drifting biases.
    sample_s : float
        Time between two samples of a tip.
    """

    sensor_variance: Floats
    root_z_variance: float
    root_y_variance: float
    bias_prior_covariance: Floats
    bias_projection: Floats
    bias_time_s: float
    sample_s: float


def make_noise(airframe: Airframe, layout: StateLayout, step_s: float) -> SensorNoise:
    """Noise of the rows averaged over epochs of ``step_s``.

    A one-sided density S averaged over h has variance ``S / (2 h)``;
    its first moment, ``integral (t - middle) n dt / h^2``, has a twelfth of that.

    Parameters
    ----------
    airframe : Airframe
        Its sensors.
    layout : StateLayout
        State vector of the airframe.
    step_s : float
        Epoch h.

    Returns
    -------
    SensorNoise
    """
    root, tips = airframe.root, (airframe.left, airframe.right)
    per_epoch = 1.0 / (2.0 * step_s)
    accel = [sensor.accel_noise_mps2_rthz**2 * per_epoch for sensor in tips]
    gyro = [sensor.gyro_noise_radps_rthz**2 * per_epoch for sensor in (*tips, root)]
    root_accel = root.accel_noise_mps2_rthz**2 * per_epoch
    gyro[-1] += _deconvolution_gain(root, step_s) * (_STAMP_JITTER_S * _TYPICAL_ROLL_ACCEL_RADPS2) ** 2
    return SensorNoise(
        sensor_variance=np.array([*accel, accel[0] / 12.0, accel[1] / 12.0, *accel, *gyro]),
        root_z_variance=root_accel if "z" in root.sends else _ABSENT_AXIS_SIGMA_MPS2**2,
        root_y_variance=root_accel if "y" in root.sends else _ABSENT_AXIS_SIGMA_MPS2**2,
        bias_prior_covariance=_bias_prior(airframe, layout),
        bias_projection=_bias_projection(airframe),
        bias_time_s=max(min(sensor.bias_time_s for sensor in (root, *tips)), step_s),
        sample_s=1.0 / min(sensor.rate_hz for sensor in tips),
    )


def _bias_projection(airframe: Airframe) -> Floats:
    """Matrix (2, 2) from the tips' biases against the root to each tip's deviation from the inverse-variance mean.

    ``b_left = mean + (w_right + w_root) (b_left - b_root) - w_right (b_right - b_root)``, and so for the right.
    """
    sigmas = np.array([sensor.accel_bias_sigma_mps2 for sensor in (airframe.left, airframe.right, airframe.root)])
    if not sigmas.all():
        return np.zeros((2, 2))
    left, right, root = sigmas**-2.0 / np.sum(sigmas**-2.0)
    return np.array([[right + root, -right], [-left, left + root]])


def _deconvolution_gain(root: Sensor, step_s: float) -> float:
    """Factor by which undoing the root's low-pass raises the variance of errors of single samples.

    The mean of ``|1/H|^2 = 1 + (f/cutoff)^4`` over what smoothing and averaging over the epochs let through.
    """
    if root.lowpass_gyro_hz <= 0.0:
        return 0.0
    f = np.linspace(0.0, 0.5 * root.rate_hz, 200)
    passed = np.cos(np.pi * f * step_s) ** 4 * np.sinc(f * step_s) ** 2
    return float(np.mean((1.0 + (f / root.lowpass_gyro_hz) ** 4) * passed))


def _bias_prior(airframe: Airframe, layout: StateLayout) -> Floats:
    """Prior covariance (b, b) of the drifting biases.

    Vertical and lateral rows are differences to the root and share its bias. So do the roll rates: the rigid roll rate
    of the state is the one that the root's gyro shows, bias included.
    """
    prior = np.zeros((len(layout.row_bias_states), len(layout.row_bias_states)))
    root, tips = airframe.root, (airframe.left, airframe.right)
    for i, (row, _) in enumerate(layout.row_bias_states):
        gyro = row >= P_LEFT
        sensor = tips[row % 2]
        prior[i, i] = (sensor.gyro_bias_sigma_radps if gyro else sensor.accel_bias_sigma_mps2) ** 2
        shared = root.gyro_bias_sigma_radps if gyro else root.accel_bias_sigma_mps2
        for j, (other, _) in enumerate(layout.row_bias_states):
            if other // 2 == row // 2:
                prior[i, j] += shared**2
    return prior
