"""Modal and gust parameters that are adapted in flight, as logarithms with normal priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.tracking.states import ModeFamily
from companion.params.airframe import Gust, Uncertain
from companion.records import Floats

FREQUENCY, DAMPING, LOAD, CORNER_1, CORNER_2, FREQUENCY_2, DAMPING_2, LOAD_2, COHERENCE = range(9)
PARAMETERS = 9  # of one family
LIMITS = (
    np.array([0.2, 1e-3, 1e-12, 0.05, 0.05, 0.5, 2e-3, 1e-14, 0.07]),
    np.array([200.0, 0.5, 1e6, 2000.0, 2000.0, 400.0, 0.12, 1e5, 14.0]),
)

_CORNER_HZ = (8.0, 60.0)  # chosen: of a gust that the airframe does not describe
_CORNER_SIGMA = 2.0  # chosen: wide open, a factor of 7
_LOAD_SIGMA = 2.5  # chosen: wide open, a factor of 12
_RATIO_2 = 0.003  # chosen: of the second mode's load density to the first's
_RATIO_2_SIGMA = 3.0  # chosen: wide open, a factor of 20
_COHERENCE_SIGMA = 1.0  # chosen, in Fisher's z: wide open, one sigma is a correlation of 0.76
_SIGMA_FLOOR = 1e-6  # numerical: keeps a certain parameter where it is


@dataclass(frozen=True, slots=True)
class ModeParameters:
    """One family: a mode and the next one under loads of one gust, whose spectrum has two corners.

    The first load's one-sided density is ``load / ((1 + (f/corner_1)^2) (1 + (f/corner_2)^2))``, scaled so that
    ``load`` is its value at ``reference_hz``. The second load has the same shape, and ``load_2`` is its value at
    ``frequency_2_hz``. One gust lifts the whole span: the two loads are correlated, with either sign.

    Attributes
    ----------
    load, load_2 : float
        (m/s^2)^2/Hz.
    coherence : float
        Correlation of the second load with the first, -1 to 1.
    log_sigma : (9,) float64
        Standard deviation of each entry of :meth:`log_params`.
    """

    frequency_hz: float
    damping: float
    load: float
    corner_1_hz: float
    corner_2_hz: float
    frequency_2_hz: float
    damping_2: float
    load_2: float
    coherence: float
    reference_hz: float
    log_sigma: Floats

    @property
    def white_load(self) -> float:
        """One-sided density of the white noise ahead of the first load's two poles, (m/s^2)^2/Hz."""
        return self.load * self._roll_off(self.reference_hz)

    @property
    def white_load_2(self) -> float:
        """One-sided density of the white noise ahead of the second load's two poles, (m/s^2)^2/Hz."""
        return self.load_2 * self._roll_off(self.frequency_2_hz)

    def _roll_off(self, frequency_hz: float) -> float:
        """Ratio of the load's density at zero frequency to that at ``frequency_hz``."""
        return (1.0 + (frequency_hz / self.corner_1_hz) ** 2) * (1.0 + (frequency_hz / self.corner_2_hz) ** 2)

    def log_params(self) -> Floats:
        """Logarithms of the parameters in the order of this module's indices, (9,).

        The coherence c enters as the logarithm of ``sqrt((1 + c) / (1 - c))``, Fisher's z.
        """
        first = [self.frequency_hz, self.damping, self.load, self.corner_1_hz, self.corner_2_hz]
        fisher_z_ratio = np.exp(np.arctanh(self.coherence))
        log_params: Floats = np.log(
            np.array([*first, self.frequency_2_hz, self.damping_2, self.load_2, fisher_z_ratio])
        )
        return log_params

    def with_log_params(self, log_params: Floats, log_sigma: Floats) -> ModeParameters:
        """Parameters at ``log_params`` (9,) with ``log_sigma`` (9,)."""
        v = [float(value) for value in np.exp(log_params)]
        coherence = float(np.tanh(log_params[COHERENCE]))
        return ModeParameters(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], coherence, self.reference_hz, log_sigma)


def prior_parameters(family: ModeFamily, gust: Gust) -> ModeParameters:
    """Airframe's belief: log-normal, relative sigma as stated; gust and second load wide open."""
    mode, second = family.mode, family.second
    frequency, damping = mode.frequency_hz.value, mode.damping.value
    corners = [corner if corner > 0.0 else default for corner, default in zip(gust.corners_hz, _CORNER_HZ, strict=True)]
    omega = 2.0 * np.pi * frequency
    load = max(gust.deflection_rms_m.value, 1e-5) ** 2 * 8.0 * damping * omega**3
    sigma = [
        _relative_sigma(mode.frequency_hz),
        _relative_sigma(mode.damping),
        max(_LOAD_SIGMA, 2.0 * _relative_sigma(gust.deflection_rms_m)),
        _CORNER_SIGMA,
        _CORNER_SIGMA,
        _relative_sigma(second.frequency_hz),
        _relative_sigma(second.damping),
        _RATIO_2_SIGMA,
        _COHERENCE_SIGMA,
    ]
    return ModeParameters(
        frequency_hz=frequency,
        damping=damping,
        load=float(load),
        corner_1_hz=corners[0],
        corner_2_hz=corners[1],
        frequency_2_hz=second.frequency_hz.value,
        damping_2=second.damping.value,
        load_2=float(_RATIO_2 * load),
        coherence=0.0,
        reference_hz=frequency,
        log_sigma=np.array(sigma),
    )


def _relative_sigma(belief: Uncertain) -> float:
    """Sigma over value, with a floor that keeps a certain parameter where it is."""
    return max(belief.sigma / belief.value, _SIGMA_FLOOR) if belief.value > 0.0 else _SIGMA_FLOOR
