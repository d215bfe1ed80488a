"""What a family is fitted to: one channel of the vertical readings, and the density of all that is not the wing's."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import load_density
from companion.core.tracking.adaptation.noise_psd import DERIVATIVE, EDGE, Bend, Floor
from companion.core.tracking.model import Parameters
from companion.core.tracking.states import M_LEFT, P_ROOT, Z_LEFT, Z_RIGHT, Layout, Noise
from companion.records import Floats
from companion.units import GRAVITY_MPS2

COLUMNS, ROLL, STATIC = 4, 2, 3  # of the rows: both vertical ones, root roll rate, bend by the load factor

_MEAN, _HALF_DIFFERENCE = (1.0, 1.0), (-1.0, 1.0)  # twice the share of the left and right row


class Channels:
    """The mean of both tips for the symmetric family, half their difference for the other, one tip for both."""

    def __init__(self, layout: Layout, noise: Noise, levers_m: tuple[float, float], step_s: float) -> None:
        self._layout, self._noise, self._step_s = layout, noise, step_s
        self._lever_m = 0.5 * (levers_m[1] - levers_m[0])
        self._tips = noise.own[[Z_LEFT, Z_RIGHT]] * 2.0 * step_s
        self._root = noise.root_z * 2.0 * step_s
        self._roll = noise.own[P_ROOT] * 2.0 * step_s * self._lever_m**2

    def of(
        self, rows: Floats, families: tuple[int, ...], tip: int, parameters: Parameters, cut: float, bend_per_g_m: float
    ) -> tuple[Floats, Floor]:
        """Samples (n,) and their floor.

        Parameters
        ----------
        rows : (n, COLUMNS) float64
            All that is kept, seen by the constants as known.
        families : tuple of int
            Both where only one tip is there.
        tip : int
            The one that is there.
        parameters : (symmetric, antisymmetric)
            As known by now.
        cut : float
            How much the edges of cells cut samples.
        bend_per_g_m : float
            As known by now.
        """
        cut_density, step_s = self._cut_density(parameters, cut), self._step_s
        bend = Bend(parameters[0].frequency_hz, parameters[0].damping, bend_per_g_m / GRAVITY_MPS2)
        if families == (0,):
            known = _answer(rows[:, STATIC], bend, step_s)
            white = float(self._tips.sum() / 4.0)
            floor = Floor(white, self._root, bend, 0.0, 0.5 * cut_density, self._wander(_MEAN), step_s)
            return 0.5 * (rows[:, 0] + rows[:, 1]) - known, floor
        lift = self._lever_m * np.convolve(rows[:, ROLL], DERIVATIVE / step_s, mode="same")  # of the rigid roll
        lift[:EDGE], lift[-EDGE:] = 0.0, 0.0
        if families == (1,):
            white = float(self._tips.sum() / 4.0)
            floor = Floor(white, 0.0, bend, self._roll, 0.5 * cut_density, self._wander(_HALF_DIFFERENCE), step_s)
            return 0.5 * (rows[:, 1] - rows[:, 0]) - lift, floor
        known = _answer(rows[:, STATIC], bend, step_s)
        alone = (2.0, 0.0) if tip == 0 else (0.0, 2.0)
        floor = Floor(float(self._tips[tip]), self._root, bend, self._roll, cut_density, self._wander(alone), step_s)
        return rows[:, tip] - known - (2 * tip - 1) * lift, floor

    def _wander(self, signs: tuple[float, float]) -> float:
        """Density at 1 Hz of the drifting biases in half the signed sum of both vertical rows; it falls with f^2."""
        at = [index for index, (row, _) in enumerate(self._layout.bias) if row < M_LEFT]
        if len(at) < len(signs):
            return 0.0
        half = 0.5 * np.array(signs)
        variance = float(half @ self._noise.bias_prior[np.ix_(at, at)] @ half)
        return variance / (np.pi**2 * self._noise.bias_time_s)

    def _cut_density(self, parameters: Parameters, cut: float) -> float:
        """Density that edges which cut samples add to one tip: the load's inside a sample is not known.

        ``S T / (3 h) (1 - cos(2 pi f h))`` for samples of ``T`` in cells of ``h``.
        """
        highest = (0.5 / self._step_s) ** 2
        load = sum(load_density(np.exp(p.logs()), highest, p.reference_hz) for p in parameters)
        return cut * load * self._noise.sample_s / (3.0 * self._step_s)


def _answer(static_m: Floats, bend: Bend, step_s: float) -> Floats:
    """Vertical reading that the load factor's known bend brings about."""
    ramp = np.linspace(static_m[0], static_m[-1], len(static_m))
    frequency_hz: Floats = np.asarray(np.fft.rfftfreq(len(static_m), step_s), dtype=np.float64)
    lifted = bend.reading(frequency_hz) * np.fft.rfft(static_m - ramp)
    return np.asarray(np.fft.irfft(lifted, len(static_m)), dtype=np.float64)
