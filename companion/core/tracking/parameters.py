"""Modal and gust parameters that are adapted in flight, as logarithms with normal priors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.tracking.states import ModeFamily
from companion.params.airframe import Gust, Mode, Uncertain
from companion.records import Floats, Ints

# of a family's first mode with the gust's corners, and of each further one (by definition)
FIRST_PARAMETERS, FURTHER_PARAMETERS = 5, 4
FREQUENCY, DAMPING, LOAD, CORNER_1, CORNER_2 = range(FIRST_PARAMETERS)  # a further mode has the first three as well
COHERENCE = 3  # of a further mode, behind its load (by definition)
# numerical: least and most of each; no wing or gust comes near, and no fit runs away
_FIRST_LIMITS = ([0.2, 1e-3, 1e-12, 0.05, 0.05], [200.0, 0.5, 1e6, 2000.0, 2000.0])
_FURTHER_LIMITS = ([0.5, 2e-3, 1e-14, 0.07], [400.0, 0.12, 1e5, 14.0])  # numerical: likewise

_CORNER_HZ = (8.0, 60.0)  # chosen: of a gust that the airframe does not describe
_CORNER_SIGMA = 2.0  # chosen: wide open, a factor of 7
_LOAD_SIGMA = 2.5  # chosen: wide open, a factor of 12
_RATIO = 0.003  # chosen: of a further mode's load density to the first's
_RATIO_SIGMA = 3.0  # chosen: wide open, a factor of 20
_COHERENCE_SIGMA = 1.0  # chosen, in Fisher's z: wide open, one sigma is a correlation of 0.76
_SIGMA_FLOOR = 1e-6  # numerical: keeps a certain parameter where it is
# chosen, of the log parameters of the first mode and of each further one: smaller changes need no trial
_SMALL_CHANGE, _SMALL_CHANGE_FURTHER = (0.02, 0.5, 0.7, 1.0, 1.0), (0.05, 0.7, 1.0, 0.7)
_NEGLIGIBLE_LOG_LOAD = np.log(1e-6)  # chosen: a further mode's load over the first's, below any sensor's noise


class ParameterIndex(NamedTuple):
    """Places of the parameters of one or two families in one vector, family after family.

    Attributes
    ----------
    first : (families,) int64
        Each family's first frequency, with which its parameters begin.
    end : (families,) int64
        One past each family's last parameter.
    further : (f,) int64
        Frequency of each further mode.
    further_first : (f,) int64
        First frequency of the same family.
    """

    first: Ints
    end: Ints
    further: Ints
    further_first: Ints


def parameter_index(mode_counts: Sequence[int]) -> ParameterIndex:
    """Places of the parameters of families with so many modes each."""
    sizes = FIRST_PARAMETERS + FURTHER_PARAMETERS * (np.array(mode_counts, np.int64) - 1)
    end = np.cumsum(sizes)
    first = end - sizes
    further = [
        (at, start)
        for start, stop in zip(first, end, strict=True)
        for at in range(start + FIRST_PARAMETERS, stop, FURTHER_PARAMETERS)
    ]
    further_places = np.array(further, np.int64).reshape(-1, 2).T
    return ParameterIndex(first, end, further_places[0].copy(), further_places[1].copy())


def joined(first: Sequence[float], further: Sequence[float], modes: int) -> Floats:
    """A family's vector (p,) of what holds for its first mode and the gust, and for each further mode."""
    return np.array([*first, *(modes - 1) * list(further)])


def parameter_limits(modes: int) -> tuple[Floats, Floats]:
    """Lowest and highest value of each parameter of a family, (p,) each."""
    low, high = (joined(first, further, modes) for first, further in zip(_FIRST_LIMITS, _FURTHER_LIMITS, strict=True))
    return low, high


@dataclass(frozen=True, slots=True)
class LoadedMode:
    """One mode under its load.

    Attributes
    ----------
    load : float
        One-sided density of its load at the frequency at which it is stated, (m/s^2)^2/Hz.
    coherence : float
        Correlation of its load with the first mode's, -1 to 1; 1 for the first mode itself.
    """

    frequency_hz: float
    damping: float
    load: float
    coherence: float = 1.0


@dataclass(frozen=True, slots=True)
class ModeParameters:
    """One family: its modes under loads of one gust, whose spectrum has two corners.

    The first load's one-sided density is ``load / ((1 + (f/corner_1)^2) (1 + (f/corner_2)^2))``, scaled so that
    ``load`` is its value at ``reference_hz``. Every other load has the same shape, and is stated at its own mode's
    frequency. One gust lifts the whole span: each load is correlated with the first, with either sign, and two others
    so far as both are with the first, ``c_j c_k``, which is a correlation matrix for any ``c``.

    Attributes
    ----------
    modes : tuple of LoadedMode
        The lowest first.
    log_sigma : (5 + 4 (m - 1),) float64
        Standard deviation of each entry of :meth:`log_params`.
    slow_corner_hz : float
        The filter takes a lower corner above it for this one: the fit cannot exclude it (:mod:`.adaptation.slow_load`).
    noise_ratio : float
        Density of the vertical axes' noise over the believed one: the root's in the symmetric family, the tips' in the
        antisymmetric one.
    """

    modes: tuple[LoadedMode, ...]
    corner_1_hz: float
    corner_2_hz: float
    reference_hz: float
    log_sigma: Floats
    slow_corner_hz: float = math.inf
    noise_ratio: float = 1.0

    @property
    def frequency_hz(self) -> float:
        """Natural frequency of the first mode, Hz."""
        return self.modes[0].frequency_hz

    @property
    def damping(self) -> float:
        """Damping ratio of the first mode."""
        return self.modes[0].damping

    @property
    def white_loads(self) -> list[float]:
        """One-sided density of the white noise ahead of each load's two poles, (m/s^2)^2/Hz."""
        stated_hz = [self.reference_hz, *(mode.frequency_hz for mode in self.modes[1:])]
        return [mode.load * self._roll_off(at_hz) for mode, at_hz in zip(self.modes, stated_hz, strict=True)]

    def _roll_off(self, frequency_hz: float) -> float:
        """Ratio of the load's density at zero frequency to that at ``frequency_hz``."""
        return (1.0 + (frequency_hz / self.corner_1_hz) ** 2) * (1.0 + (frequency_hz / self.corner_2_hz) ** 2)

    def cautious(self) -> ModeParameters:
        """Same family with the lower corner as the filter takes it."""
        if self.corner_1_hz <= self.corner_2_hz:
            return dataclasses.replace(self, corner_1_hz=min(self.slow_corner_hz, self.corner_1_hz))
        return dataclasses.replace(self, corner_2_hz=min(self.slow_corner_hz, self.corner_2_hz))

    def log_params(self) -> Floats:
        """Logarithms of the parameters in the order of this module's indices, (5 + 4 (m - 1),).

        A coherence c enters as the logarithm of ``sqrt((1 + c) / (1 - c))``, Fisher's z.
        """
        first, *others = self.modes
        values = [first.frequency_hz, first.damping, first.load, self.corner_1_hz, self.corner_2_hz]
        for mode in others:
            values += [mode.frequency_hz, mode.damping, mode.load, np.exp(np.arctanh(mode.coherence))]
        return np.asarray(np.log(np.array(values)))

    def with_log_params(
        self, log_params: Floats, log_sigma: Floats, slow_corner_hz: float = math.inf, noise_ratio: float = 1.0
    ) -> ModeParameters:
        """Parameters at ``log_params`` with ``log_sigma``, both (5 + 4 (m - 1),)."""
        v = [float(value) for value in np.exp(log_params)]
        modes = [LoadedMode(v[FREQUENCY], v[DAMPING], v[LOAD])]
        for at in range(FIRST_PARAMETERS, len(v), FURTHER_PARAMETERS):
            coherence = float(np.tanh(log_params[at + COHERENCE]))
            modes.append(LoadedMode(v[at + FREQUENCY], v[at + DAMPING], v[at + LOAD], coherence))
        beside = self.reference_hz, log_sigma, slow_corner_hz, noise_ratio
        return ModeParameters(tuple(modes), v[CORNER_1], v[CORNER_2], *beside)


def prior_parameters(family: ModeFamily, gust: Gust) -> ModeParameters:
    """Airframe's belief: log-normal, relative sigma as stated; gust and further loads wide open."""
    first, *others = family.modes
    frequency, damping = first.frequency_hz.value, first.damping.value
    corners = [corner if corner > 0.0 else default for corner, default in zip(gust.corners_hz, _CORNER_HZ, strict=True)]
    omega = 2.0 * np.pi * frequency
    load = max(gust.deflection_rms_m.value, 1e-5) ** 2 * 8.0 * damping * omega**3
    load_sigma = max(_LOAD_SIGMA, 2.0 * _relative_sigma(gust.deflection_rms_m))
    sigma = [*_shape_sigmas(first), load_sigma, _CORNER_SIGMA, _CORNER_SIGMA]
    modes = [LoadedMode(frequency, damping, float(load))]
    for mode in others:
        sigma += [*_shape_sigmas(mode), _RATIO_SIGMA, _COHERENCE_SIGMA]
        modes.append(LoadedMode(mode.frequency_hz.value, mode.damping.value, float(_RATIO * load), 0.0))
    return ModeParameters(tuple(modes), corners[0], corners[1], frequency, np.array(sigma))


def alike(new: Sequence[ModeParameters], old: Sequence[ModeParameters]) -> bool:
    """Whether a change of the parameters is too small for a trial."""
    return all(_close(*family) for family in zip(new, old, strict=True))


def _close(new: ModeParameters, old: ModeParameters) -> bool:
    """Whether one family's parameters changed little; those of a negligible further mode do not count."""
    new_log, old_log = new.cautious().log_params(), old.cautious().log_params()
    close = np.abs(new_log - old_log) < joined(_SMALL_CHANGE, _SMALL_CHANGE_FURTHER, len(new.modes))
    for at in range(FIRST_PARAMETERS, len(new_log), FURTHER_PARAMETERS):
        load = max(log_params[at + LOAD] - log_params[LOAD] for log_params in (new_log, old_log))
        if load < _NEGLIGIBLE_LOG_LOAD:  # what it is makes no difference
            close[[at + FREQUENCY, at + DAMPING, at + COHERENCE]] = True
    return bool(close.all())


def _shape_sigmas(mode: Mode) -> tuple[float, float]:
    """Relative sigmas of frequency and damping."""
    return _relative_sigma(mode.frequency_hz), _relative_sigma(mode.damping)


def _relative_sigma(belief: Uncertain) -> float:
    """Sigma over value, with a floor that keeps a certain parameter where it is."""
    return max(belief.sigma / belief.value, _SIGMA_FLOOR) if belief.value > 0.0 else _SIGMA_FLOOR
