"""Gusts: Dryden turbulence at low altitude, white loads, and loads with two real poles.

A spectrum is unit white noise (see :class:`LoadSpectrum`) through a filter of at most two
states, sampled exactly (Van Loan) at a uniform step. All randomness comes from the generator that is passed in.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from companion.records import Floats

FOOT_M = 0.3048  # by definition


class GustKind(enum.StrEnum):
    """Spectrum of the load on the modes; every kind is scaled to the deflection rms that was drawn."""

    AIRFRAME = "airframe"
    WHITE = "white"
    DRYDEN = "dryden"
    CALM = "calm"


@dataclass(frozen=True, slots=True)
class LoadSpectrum:
    """Unit white noise w through ``C (sI - A)^-1 B``, or the noise itself when ``drift`` is empty.

    Attributes
    ----------
    drift : (n, n) float64
        A, n = 0, 1 or 2; 1/s.
    gain_in : (n,) float64
        B; w has two-sided density 1 per Hz, E[w(t) w(s)] = delta(t - s).
    gain_out : (n,) float64
        C.
    """

    drift: Floats
    gain_in: Floats
    gain_out: Floats

    def draw(self, rng: np.random.Generator, count: int, step_s: float) -> Floats:
        """Samples (count,) at a uniform step, from the stationary start.

        White noise is piecewise constant with variance 1/step, so that its integral over any step is exact.
        """
        states = len(self.drift)
        noise = rng.standard_normal((count + 1, max(states, 1)))
        if not states:
            return noise[:count, 0] / math.sqrt(step_s)
        transition, root = _discretise(self.drift, self.gain_in, step_s)
        start = _root(_stationary(self.drift, self.gain_in)) @ noise[count]
        path = _recursion(transition, noise[:count] @ root.T, start)
        return np.asarray(path @ self.gain_out)


def white_spectrum() -> LoadSpectrum:
    """Unit white load."""
    return LoadSpectrum(np.zeros((0, 0)), np.zeros(0), np.zeros(0))


def pole_spectrum(corners_hz: tuple[float, float]) -> LoadSpectrum:
    """White load through one or two real poles of unit gain at 0 Hz; a corner of 0 is no pole."""
    poles = [2 * math.pi * corner for corner in corners_hz if corner > 0]
    if not poles:
        return white_spectrum()
    if len(poles) == 1:
        return LoadSpectrum(np.array([[-poles[0]]]), np.array(poles), np.ones(1))
    first, second = poles
    return LoadSpectrum(np.array([[-first, 0.0], [second, -second]]), np.array([first, 0.0]), np.array([0.0, 1.0]))


@dataclass(frozen=True, slots=True)
class DrydenScales:
    """Scale lengths and intensities of MIL-F-8785C below 1000 ft (section 3.7.3.4), SI."""

    length_w_m: float
    length_u_m: float
    sigma_w_mps: float
    sigma_u_mps: float

    @classmethod
    def low_altitude(cls, altitude_m: float, wind_at_20ft_mps: float) -> DrydenScales:
        """Give L_w = h, L_u = h/k^1.2, sigma_w = 0.1 W20, sigma_u = sigma_w/k^0.4.

        k = 0.177 + 0.000823 h with h in feet, held inside 10..1000.
        """
        feet = min(max(altitude_m / FOOT_M, 10.0), 1000.0)
        factor = 0.177 + 0.000823 * feet
        sigma_w = 0.1 * wind_at_20ft_mps
        return cls(feet * FOOT_M, feet / factor**1.2 * FOOT_M, sigma_w, sigma_w / factor**0.4)


def dryden_vertical(scales: DrydenScales, airspeed_mps: float) -> LoadSpectrum:
    """Vertical gust velocity: H_w = sigma sqrt(L/V) (1 + sqrt3 (L/V) s) / (1 + (L/V) s)^2, its variance is sigma^2."""
    return _shaped(scales.sigma_w_mps, scales.length_w_m / airspeed_mps)


def dryden_longitudinal(scales: DrydenScales, airspeed_mps: float) -> LoadSpectrum:
    """Longitudinal gust velocity: H_u = sigma sqrt(2 L/V) / (1 + (L/V) s)."""
    rate = airspeed_mps / scales.length_u_m
    return LoadSpectrum(np.array([[-rate]]), np.array([scales.sigma_u_mps * math.sqrt(2 * rate)]), np.ones(1))


def dryden_roll(scales: DrydenScales, airspeed_mps: float, span_m: float) -> LoadSpectrum:
    """Roll gust rate in rad/s: H_p = sigma_w sqrt(0.8/V) (pi/4b)^(1/6) / (L_w^(1/3) (1 + 4b/(pi V) s)).

    The standard's noise has density 1 per rad/s over one side, which is pi times ours per Hz over two sides.
    """
    gain = scales.sigma_w_mps * math.sqrt(0.8 / airspeed_mps) * (math.pi / (4 * span_m)) ** (1 / 6)
    gain *= math.sqrt(math.pi) / scales.length_w_m ** (1 / 3)
    rate = math.pi * airspeed_mps / (4 * span_m)
    return LoadSpectrum(np.array([[-rate]]), np.array([gain * rate]), np.ones(1))


def modal_rms(spectrum: LoadSpectrum, frequency_hz: float, damping: float) -> float:
    """Rms of q in ``q'' + 2 zeta omega q' + omega^2 q = g`` under the unit load, by Lyapunov's equation."""
    omega = 2 * math.pi * frequency_hz
    states = len(spectrum.drift)
    joined = np.zeros((states + 2, states + 2))
    joined[:2, :2] = [[0.0, 1.0], [-(omega**2), -2 * damping * omega]]
    joined[1, 2:] = spectrum.gain_out
    joined[2:, 2:] = spectrum.drift
    gain = np.concatenate([[0.0, 0.0 if states else 1.0], spectrum.gain_in])
    return math.sqrt(_stationary(joined, gain)[0, 0])


def _shaped(sigma: float, lag_s: float) -> LoadSpectrum:
    """Give sigma sqrt(T) (1 + sqrt3 T s)/(1 + T s)^2 in controllable form."""
    rate = 1.0 / lag_s
    scale = sigma * math.sqrt(lag_s) * rate**2
    return LoadSpectrum(
        np.array([[0.0, 1.0], [-(rate**2), -2 * rate]]),
        np.array([0.0, 1.0]),
        scale * np.array([1.0, math.sqrt(3.0) * lag_s]),
    )


def _stationary(drift: Floats, gain: Floats) -> Floats:
    """Solve A P + P A' + B B' = 0."""
    size = len(drift)
    eye = np.eye(size)
    lyapunov = np.kron(drift, eye) + np.kron(eye, drift)
    solved = np.linalg.solve(lyapunov, -np.outer(gain, gain).ravel()).reshape(size, size)
    return (solved + solved.T) / 2


def _discretise(drift: Floats, gain: Floats, step_s: float) -> tuple[Floats, Floats]:
    """Van Loan (1978): transition matrix and a root of the step's noise covariance."""
    size = len(drift)
    block = np.zeros((2 * size, 2 * size))
    block[:size, :size] = -drift
    block[:size, size:] = np.outer(gain, gain)
    block[size:, size:] = drift.T
    power = np.asarray(expm(block * step_s))
    transition = power[size:, size:].T
    return transition, _root(transition @ power[:size, size:])


def _root(covariance: Floats) -> Floats:
    """A square root of a covariance that may be nearly singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _recursion(transition: Floats, noise: Floats, start: Floats) -> Floats:
    """x[k] for x[0] = start, x[k+1] = A x[k] + noise[k]; unrolled in scalars, eight times as fast as in arrays."""
    if len(start) == 1:
        a, x = float(transition[0, 0]), float(start[0])
        (xs,) = noise.T.tolist()
        for k, push in enumerate(xs):  # each push gives its place to what it acts on
            xs[k] = x
            x = a * x + push
        return np.array(xs)[:, None]
    (a, b), (c, d) = transition.tolist()
    x, y = start.tolist()
    xs, ys = noise.T.tolist()
    for k, (push_x, push_y) in enumerate(zip(xs, ys, strict=True)):
        xs[k], ys[k] = x, y
        x, y = a * x + b * y + push_x, c * x + d * y + push_y
    return np.column_stack([xs, ys])
