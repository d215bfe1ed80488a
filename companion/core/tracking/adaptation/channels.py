"""Samples that a family is fitted to, and the density of everything in them that is not the wing's."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import load_density
from companion.core.tracking.adaptation.noise_psd import DERIVATIVE, EDGE, NoiseSpectrum, StaticBendResponse
from companion.core.tracking.adaptation.slow_load import SlopeRates, slope_rates
from companion.core.tracking.model import WingParameters
from companion.core.tracking.states import M_LEFT, P_LEFT, P_RIGHT, P_ROOT, Z_LEFT, Z_RIGHT, SensorNoise, StateLayout
from companion.records import Floats
from companion.units import GRAVITY_MPS2

# of the rows: both vertical ones, root roll rate, bend by the load factor, both families' rates of slope (NaN: unknown)
COLUMNS, ROLL, STATIC, SLOPE_RATES = 6, 2, 3, slice(4, 6)


class Channels:
    """Mean of both tips for the symmetric family, half their difference for the other, one tip for both."""

    def __init__(self, layout: StateLayout, noise: SensorNoise, levers_m: tuple[float, float], step_s: float) -> None:
        self._layout, self._noise, self._step_s = layout, noise, step_s
        self._levers_m = levers_m
        self._tips = noise.sensor_variance[[Z_LEFT, Z_RIGHT]] * 2.0 * step_s
        self._root = noise.root_z_variance * 2.0 * step_s
        self._roll = noise.sensor_variance[P_ROOT] * 2.0 * step_s

    def channel(
        self,
        rows: Floats,
        families: tuple[int, ...],
        tip: int,
        parameters: WingParameters,
        aliasing_noise: float,
        bend_per_g_m: float,
    ) -> tuple[Floats, NoiseSpectrum]:
        """Samples of a family's channel and the spectrum of their noise.

        Parameters
        ----------
        rows : (n, COLUMNS) float64
            Stored history, corrected by the bias parameters.
        families : tuple of int
            Both where only one tip is present.
        tip : int
            The tip that is present.
        parameters : (symmetric, antisymmetric)
            As estimated by now.
        aliasing_noise : float
            Mean of ``Epochs.aliasing_noise``.
        bend_per_g_m : float
            As estimated by now.

        Returns
        -------
        samples : (n,) float64
            m/s^2.
        noise_spectrum : NoiseSpectrum
        """
        bend = StaticBendResponse(parameters[0].frequency_hz, parameters[0].damping, bend_per_g_m / GRAVITY_MPS2)
        white, aliasing_density = float(self._tips.sum() / 4.0), self._aliasing_density(parameters, aliasing_noise)
        if families == (0,):
            signs, samples = (1.0, 1.0), 0.5 * (rows[:, 0] + rows[:, 1])
        elif families == (1,):
            signs, samples = (-1.0, 1.0), 0.5 * (rows[:, 1] - rows[:, 0])
        else:
            signs, samples = ((2.0, 0.0), (0.0, 2.0))[tip], rows[:, tip]
            white = float(self._tips[tip])
        aliasing_density *= 0.5 if len(families) == 1 else 1.0  # half the sum of two independent ones
        # a root off the centre line leaves a part of the roll in the mean of both tips
        lever_m = 0.5 * float(np.dot(signs, self._levers_m))
        root, roll = (self._root if 0 in families else 0.0), self._roll * lever_m**2
        if 0 in families:
            samples = samples - _static_bend_reading(rows[:, STATIC], bend, self._step_s)
        if lever_m != 0.0:
            samples = samples - lever_m * self._roll_acceleration(rows[:, ROLL])
        drift_density = self._drift_density(signs)
        return samples, NoiseSpectrum(white, root, bend, roll, aliasing_density, drift_density, self._step_s)

    def _roll_acceleration(self, roll_radps: Floats) -> Floats:
        """Derivative of the roll rate (n,), rad/s^2; 0 at the ends, where it is not known."""
        rises: Floats = np.convolve(roll_radps, DERIVATIVE / self._step_s, mode="same")
        rises[:EDGE], rises[-EDGE:] = 0.0, 0.0
        return rises

    def slope_rates(self, rows: Floats, families: tuple[int, ...]) -> SlopeRates | None:
        """Slow rates of a family's slope, without the static bend's; ``rows`` (n, 6). None without all three gyros."""
        if len(families) > 1:
            return None
        (k,) = families
        factor = self._layout.families[k].modes[0].slope_factor_radpm.value
        rates, variance = rows[:, SLOPE_RATES.start + k], self._noise.sensor_variance
        noise = 0.25 * (variance[P_LEFT] + variance[P_RIGHT])
        if k == 0:
            rates = rates - factor * np.gradient(rows[:, STATIC], self._step_s)
        else:
            noise += variance[P_ROOT]
        return slope_rates(rates, self._step_s, 2.0 * self._step_s * float(noise), factor)

    def _drift_density(self, signs: tuple[float, float]) -> float:
        """Density at 1 Hz of the drifting biases in half the signed sum of both vertical rows; it falls with f^2."""
        at = [index for index, (row, _) in enumerate(self._layout.row_bias_states) if row < M_LEFT]
        if len(at) < len(signs):
            return 0.0
        half = 0.5 * np.array(signs)
        variance = float(half @ self._noise.bias_prior_covariance[np.ix_(at, at)] @ half)
        return variance / (np.pi**2 * self._noise.bias_time_s)

    def _aliasing_density(self, parameters: WingParameters, aliasing_noise: float) -> float:
        """Density by epoch edges that cut samples, for one tip: the load's path inside a sample is unknown.

        ``S T / (3 h) (1 - cos(2 pi f h))`` for samples of ``T`` in epochs of ``h``.
        """
        highest = (0.5 / self._step_s) ** 2
        load = sum(load_density(np.exp(p.log_params()), highest, p.reference_hz) for p in parameters)
        return aliasing_noise * load * self._noise.sample_s / (3.0 * self._step_s)


def _static_bend_reading(static_m: Floats, bend: StaticBendResponse, step_s: float) -> Floats:
    """Vertical reading of the estimated static bend, (n,) m/s^2."""
    ramp = np.linspace(static_m[0], static_m[-1], len(static_m))
    frequency_hz: Floats = np.asarray(np.fft.rfftfreq(len(static_m), step_s), dtype=np.float64)
    lifted = bend.reading(frequency_hz) * np.fft.rfft(static_m - ramp)
    return np.asarray(np.fft.irfft(lifted, len(static_m)), dtype=np.float64)
