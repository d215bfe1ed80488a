"""Modes of each run of a vibration test whose force was measured, and what changed from run to run.

Around each peak a run's responses are one mode and what lies beside it,

    H_o(omega) = -omega^2 r_o / (omega_n^2 - omega^2 + 2 j zeta omega_n omega) + c_o + d_o (omega - omega_c),

with omega_n and zeta of the run and r_o, c_o, d_o of each response: nuisances that are projected out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import find_peaks

from companion.errors import RecordingError
from companion.records import Complexes, Floats

# chosen: half-width of the fit: of the peak's frequency, some widths of a lightly damped mode; and at least
_WIDTH, _LEAST_WIDTH_HZ = 0.03, 0.3
_REACH = 0.035  # of a mode's frequency, by which it may change from run to run (choice)
_SMOOTHED = 7  # bins of the moving average in which peaks are sought (choice)
_PROMINENCE = 0.7  # chosen: prominence of a peak in the logarithm: a factor of two
# chosen: starts of the fit, from a metal frame's to a wing's in air; the best one counts
_DAMPINGS = (0.003, 0.01, 0.03)
_LEAST_FREEDOM = 1  # convention: numbers about a peak beyond the unknowns; with none the sigma would be 0
_MOST_LEFT = 0.5  # share of the responses about a peak that a mode may leave (choice)


@dataclass(frozen=True, slots=True)
class VibrationRun:
    """One run: ``response`` (m, k) of m points to the measured force, m/s^2/N, at ``frequency_hz`` (k,)."""

    name: str
    frequency_hz: Floats
    response: Complexes
    constants: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ModeOfRun:
    """A mode as one run shows it; ``deviation`` is what the model leaves of the responses, as a share."""

    frequency_hz: float
    frequency_sigma_hz: float
    damping: float
    damping_sigma: float
    deviation: float


@dataclass(frozen=True, slots=True)
class ModeOverRuns:
    """One mode in all runs, in their order."""

    runs: tuple[str, ...]
    of_runs: tuple[ModeOfRun, ...]

    @property
    def near_hz(self) -> float:
        """Median of the natural frequencies, by which the mode is named."""
        return float(np.median(self.frequency_hz))

    @property
    def frequency_hz(self) -> Floats:
        """Natural frequency in each run, (runs,)."""
        return np.array([mode.frequency_hz for mode in self.of_runs])

    @property
    def sigma_hz(self) -> Floats:
        """Standard deviation of each run's natural frequency, (runs,)."""
        return np.array([mode.frequency_sigma_hz for mode in self.of_runs])


def responses(
    force_n: Floats, accelerations_mps2: Floats, rate_hz: float, band_hz: tuple[float, float]
) -> tuple[Floats, Complexes]:
    """Lines and responses (m, k) of a whole record of accelerations (n, m): for sweeps that begin and end at rest."""
    f_hz = np.fft.rfftfreq(len(force_n), 1.0 / rate_hz)
    inside = (f_hz > band_hz[0]) & (f_hz < band_hz[1])
    force = np.fft.rfft(force_n - force_n.mean())[inside]
    acceleration = np.fft.rfft(accelerations_mps2 - accelerations_mps2.mean(0), axis=0)[inside]
    return np.asarray(f_hz[inside]), np.asarray((acceleration / force[:, None]).T)


def modes_of_runs(runs: Sequence[VibrationRun]) -> tuple[list[ModeOverRuns], list[str]]:
    """Modes by frequency, and a sentence about each peak that is none: one mode does not describe it, or few lines do.

    Raises
    ------
    RecordingError
        The record is too short: too few lines in the band, or about every peak.
    """
    f_hz = runs[0].frequency_hz
    if len(f_hz) < _SMOOTHED:
        raise RecordingError(f"record longer: {len(f_hz)} lines of the spectrum lie in band_hz, {_SMOOTHED} are needed")
    level = _smooth(np.mean([_level(run.response) for run in runs], axis=0))
    peaks, _ = find_peaks(np.log(level), prominence=_PROMINENCE)
    names = tuple(run.name for run in runs)
    modes, notes, short = [], [], []
    for k in peaks:
        try:
            mode = ModeOverRuns(names, tuple(mode_of(run, float(f_hz[k])) for run in runs))
        except RecordingError as error:
            short.append(error)
            continue
        remains = float(np.median([each.deviation for each in mode.of_runs]))
        if remains < _MOST_LEFT:
            modes.append(mode)
        else:
            notes.append(
                f"the peak near {f_hz[k]:.2f} Hz is no mode: one leaves {100 * remains:.0f} % of it; was it excited?"
            )
    if short and not modes:
        raise short[0]
    return modes, [*notes, *(f"a peak is left out: {error}" for error in short)]


def mode_of(run: VibrationRun, near_hz: float) -> ModeOfRun:
    """The mode of one run that peaks nearest to a frequency.

    Raises
    ------
    RecordingError
        Too few lines lie about the peak.
    """
    level = np.where(np.abs(run.frequency_hz - near_hz) < _REACH * near_hz, _smooth(_level(run.response)), 0.0)
    peak_hz = float(run.frequency_hz[int(np.argmax(level))])
    inside = np.abs(run.frequency_hz - peak_hz) < max(_WIDTH * peak_hz, _LEAST_WIDTH_HZ)
    omega, measured = 2.0 * np.pi * run.frequency_hz[inside], run.response[:, inside].T
    # real and imaginary each; the mode and the two beside it are complex in every response
    freedom = measured.size * 2 - 2 - 6 * measured.shape[1]
    if freedom < _LEAST_FREEDOM:
        needed = math.ceil(3.0 + 0.5 * (2 + _LEAST_FREEDOM) / measured.shape[1])
        raise RecordingError(
            f"run {run.name}: record longer: {len(omega)} lines of the spectrum about the peak at {peak_hz:.2f} Hz, "
            f"{needed} are needed"
        )

    def left(guess: Floats) -> Floats:
        design = _design(omega, guess)
        residual = design @ np.linalg.lstsq(design, measured, rcond=None)[0] - measured
        return np.concatenate([residual.real.ravel(), residual.imag.ravel()])

    tries = [least_squares(left, [peak_hz, np.log(zeta)], x_scale=[0.01 * peak_hz, 0.3]) for zeta in _DAMPINGS]
    best = min(tries, key=lambda solution: float(solution.cost))
    variance = 2.0 * float(best.cost) / freedom
    slope = np.asarray(best.jac, dtype=np.float64)
    spread = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)) * variance)
    zeta = float(np.exp(best.x[1]))
    relative_misfit = float(np.sqrt(2.0 * best.cost / np.sum(np.abs(measured) ** 2)))
    return ModeOfRun(float(best.x[0]), float(spread[0]), zeta, zeta * float(spread[1]), relative_misfit)


def _design(omega: Floats, guess: Floats) -> Complexes:
    natural, zeta = 2.0 * np.pi * guess[0], np.exp(guess[1])
    mode = -(omega**2) / (natural**2 - omega**2 + 2j * zeta * natural * omega)
    beside = (omega - omega.mean()) / (omega[-1] - omega[0])
    return np.stack([mode, np.ones_like(mode), beside + 0j], axis=1)


def _level(response: Complexes) -> Floats:
    return np.asarray(np.sqrt(np.mean(np.abs(response) ** 2, axis=0)))


def _smooth(level: Floats) -> Floats:
    return np.convolve(level, np.ones(_SMOOTHED) / _SMOOTHED, mode="same")
