"""Phase and frequency from one accelerometer, causally, where the frequencies move: a beam whose support travels.

The wing tracker believes that a frequency stays for seconds and that a root IMU and two tips report. A laboratory rig
has one accelerometer, and its frequency may change by half within a tenth of a second. The model is the same modal
equation ``q'' + 2 zeta omega q' + omega^2 q = g`` for a few resonances, with ``ln omega`` of each as a further state
that wanders about its usual value (first-order Gauss-Markov); the accelerometer reads the sum of all ``q''``. An
extended Kalman filter follows them. What drives a resonance also moves the support, so one factor, learned from the
innovations, scales load and wander together: quick while the support travels, steady while it rests.

The filter's phase is that of the displacement: in free decay the acceleration leads ``-q`` by ``2 zeta`` rad, which the
model knows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats, Reject

_STEP = 1e-3
_LOAD_POWER = 0.5  # of the factor: the judged resonance is driven less abruptly than those above it
_WANDER_POWER = 0.25
_LEARNING = 0.1  # per sample
_MAX_WANDERS = 2.5  # wanders
_MAX_EXCESS_NIS = 10.0  # a larger squared innovation teaches no more
_FACTOR = (0.001, 30.0)


@dataclass(frozen=True, slots=True)
class Resonance:
    """Prior of a single resonance.

    Attributes
    ----------
    frequency_hz : float
        Its usual frequency.
    wander : float
        Standard deviation of ln(frequency) about that.
    settle_s : float
        Correlation time of the wandering.
    damping : float
        Ratio; believed to be right within a factor of two.
    load : float
        Density of the driving force per modal mass, (m/s^2)^2 s, at a factor of 1.
    """

    frequency_hz: float
    wander: float
    settle_s: float
    damping: float
    load: float


@dataclass(frozen=True, slots=True)
class PhaseEstimate:
    """The first resonance at an instant: ``q(t) = amplitude cos(phase(t))``.

    ``amplitude_mps2`` is that of ``omega^2 q``; the phase lies in (-pi, pi].
    """

    phase_rad: float
    phase_sigma_rad: float
    frequency_hz: float
    frequency_sigma_hz: float
    amplitude_mps2: float


class SingleSensorModeEkf:
    """Follow resonances through one accelerometer; the first is the one that is asked for."""

    def __init__(
        self, resonances: tuple[Resonance, ...], rate_hz: float, noise_mps2: float, sensor_lag_s: float = 0.0
    ) -> None:
        """Start at rest.

        Parameters
        ----------
        resonances : tuple of Resonance
            The wanted one first; include every one that is strong at the filter's rate.
        rate_hz : float
            Of the samples, evenly spaced.
        noise_mps2 : float
            White noise of one sample, standard deviation, as it is at rest.
        sensor_lag_s : float
            By how much a reading is late (sensor, filter, averaging); phases are given in true time.
        """
        self._rate_hz, self._noise, self._lag_s = rate_hz, noise_mps2, sensor_lag_s
        self._nominal_radps = 2.0 * np.pi * np.array([r.frequency_hz for r in resonances])
        self._damping = np.array([r.damping for r in resonances])
        self._load = np.array([r.load for r in resonances]) / rate_hz
        self._log_frequency_sigma = np.array([r.wander for r in resonances])
        self._autocorrelation = np.exp(-1.0 / (rate_hz * np.array([r.settle_s for r in resonances])))
        self._state = np.zeros((len(resonances), 3))  # omega0^2 q, omega0 q', ln(omega/omega0); omega0 the usual one
        start = np.stack([np.full(len(resonances), noise_mps2**2)] * 2 + [self._log_frequency_sigma**2], axis=1)
        self._covariance: Floats = np.diag(start.ravel())
        n = len(resonances)
        self._step: Floats = np.diag(
            np.tile([1.0, 1.0, 0.0], n) + np.repeat(self._autocorrelation, 3) * np.tile([0.0, 0.0, 1.0], n)
        )
        corners = 3 * np.arange(n)[:, np.newaxis, np.newaxis]
        self._rows, self._columns = corners + np.arange(2)[:, np.newaxis], corners + np.arange(3)
        self._factor = 1.0

    def add(self, acceleration_mps2: float) -> None:
        """Take the next sample; one that is not finite only lets time pass."""
        self._predict()
        if np.isfinite(acceleration_mps2):
            self._correct(acceleration_mps2)

    def phase(self, lead_s: float = 0.0) -> PhaseEstimate | Reject:
        """The first resonance ``lead_s`` after the newest sample's stamp, from samples up to it alone.

        Rejected while the displacement is not twice its own sigma: it has no phase then. The sigma does not hold for
        the first cycles of a blow out of stillness, which nothing foretells.
        """
        ahead_s = lead_s + self._lag_s
        free_motion, by_log_frequency, omegas = self._free_motion(ahead_s)
        motion, by_log_frequency_0, frequency = free_motion[0], by_log_frequency[0], float(omegas[0])
        transition = np.array(
            [[*motion[0], by_log_frequency_0[0]], [*motion[1], by_log_frequency_0[1]], [0.0, 0.0, 1.0]]
        )
        covariance = transition @ self._covariance[:3, :3] @ transition.T
        covariance[1, 1] += self._load[0] * self._rate_hz * ahead_s * self._factor**_LOAD_POWER
        p, u = motion @ self._state[0, :2]
        ratio = frequency / self._nominal_radps[0]
        square = p**2 + (u / ratio) ** 2
        if square <= 4.0 * max(covariance[0, 0], covariance[1, 1] / ratio**2):
            return Reject.NO_MODE
        gradient = np.array([u / ratio, -p / ratio, 0.0]) / square
        drag = 2.0 * self._damping[0]  # between acceleration and -q; the ratio is known no better than to its own size
        hz = frequency / (2.0 * np.pi)
        return PhaseEstimate(
            phase_rad=float(np.arctan2(-u / ratio, p)),
            phase_sigma_rad=float(np.sqrt(gradient @ covariance @ gradient + drag**2)),
            frequency_hz=float(hz),
            frequency_sigma_hz=float(hz * np.sqrt(self._covariance[2, 2])),
            amplitude_mps2=float(np.sqrt(square) * ratio**2),
        )

    def _predict(self) -> None:
        step, (free_motion, by_log_frequency, _), factor = (
            self._step,
            self._free_motion(1.0 / self._rate_hz),
            self._factor,
        )
        by_log_frequency = by_log_frequency * self._credibility()[:, np.newaxis]
        step[self._rows, self._columns] = np.concatenate([free_motion, by_log_frequency[:, :, np.newaxis]], axis=2)
        self._state[:, :2] = np.einsum("kij,kj->ki", free_motion, self._state[:, :2])
        self._state[:, 2] *= self._autocorrelation
        noise = np.zeros_like(self._state)
        noise[:, 1] = self._load * factor
        noise[0, 1] = self._load[0] * factor**_LOAD_POWER
        noise[:, 2] = self._log_frequency_sigma**2 * (1.0 - self._autocorrelation**2) * factor**_WANDER_POWER
        self._covariance = step @ self._covariance @ step.T
        self._covariance.flat[:: len(step) + 1] += noise.ravel()

    def _correct(self, acceleration_mps2: float) -> None:
        """Reading ``-sum (omega/omega0)^2 p + 2 zeta (omega/omega0) u``, linearised."""
        p, u, ratio = self._state[:, 0], self._state[:, 1], np.exp(self._state[:, 2])
        drag = 2.0 * self._damping * ratio
        by_frequency = -(2.0 * ratio**2 * p + drag * u) * self._credibility()
        H = np.stack([-(ratio**2), -drag, by_frequency], axis=1).ravel()
        innovation = acceleration_mps2 + float(np.sum(ratio**2 * p + drag * u))
        PHT = self._covariance @ H
        variance = float(H @ PHT) + self._noise**2
        self._state += (PHT * (innovation / variance)).reshape(self._state.shape)
        self._state[:, 2] = np.clip(
            self._state[:, 2], -_MAX_WANDERS * self._log_frequency_sigma, _MAX_WANDERS * self._log_frequency_sigma
        )
        covariance = self._covariance - np.outer(PHT, PHT) / variance
        self._covariance = 0.5 * (covariance + covariance.T)
        excess_nis = min(innovation**2 / variance - 1.0, _MAX_EXCESS_NIS)
        self._factor = float(np.clip(self._factor * np.exp(_LEARNING * excess_nis), *_FACTOR))

    def _credibility(self) -> Floats:
        """Share of each resonance's estimated power that is not its own uncertainty.

        Noise that is taken for motion would teach a frequency; by this share it is believed.
        """
        variance = self._covariance.diagonal().reshape(self._state.shape)[:, :2].sum(axis=1)
        power = np.sum(self._state[:, :2] ** 2, axis=1)
        ratio: Floats = power / (power + variance)
        return ratio

    def _free_motion(self, seconds: float) -> tuple[Floats, Floats, Floats]:
        """Free motion (k, 2, 2) of each (p, u) over a time, what ln omega changes of its end (k, 2); omega, rad/s."""
        omega = self._nominal_radps * np.exp(self._state[:, 2])
        motion = _free_transition(omega, self._damping, seconds, self._nominal_radps)
        faster = _free_transition(omega * np.exp(_STEP), self._damping, seconds, self._nominal_radps)
        return motion, np.einsum("kij,kj->ki", faster - motion, self._state[:, :2]) / _STEP, omega


def _free_transition(omega_radps: Floats, damping: Floats, seconds: float, usual_radps: Floats) -> Floats:
    """Exact free motion (k, 2, 2) of ``(usual^2 q, usual q')``."""
    ringing = omega_radps * np.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * omega_radps * seconds)
    cos, sin = decay * np.cos(ringing * seconds), decay * np.sin(ringing * seconds)
    drag, across = damping * omega_radps / ringing * sin, usual_radps / ringing * sin
    motion = [[cos + drag, across], [-((omega_radps / usual_radps) ** 2) * across, cos - drag]]
    return np.asarray(np.array(motion).transpose(2, 0, 1))
