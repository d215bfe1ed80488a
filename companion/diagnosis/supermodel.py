"""The one super-model in the frequency domain: what it expects of a recording, and how far the recording is from that.

The tips' accelerations are a stationary process with spectral matrix S(f) (Whittle); forces that depend on state or
time and sensors that are not straight are taken back out of the data first. The toe at each exposure is judged given
the accelerations: its mean through the Wiener smoother of the same model, its covariance through the posterior's
spectrum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from companion.core.wing.effect import Effect, Group
from companion.core.wing.model import WingModel
from companion.diagnosis.belief import Belief, input_gains, of_range
from companion.diagnosis.expectation import Expectation
from companion.diagnosis.linear import STATIONS, Spectra
from companion.diagnosis.matrices import Complexes, log_determinant, weighed_square
from companion.diagnosis.motion import Grid, Motion
from companion.diagnosis.observations import Observations
from companion.diagnosis.part import Part
from companion.diagnosis.straighten import GRAVITY_MPS2, Straightener
from companion.diagnosis.toe import ToeModel
from companion.diagnosis.transforms import Transforms
from companion.records import Floats

_LOW = 0.15
_NYQUIST_SHARE = 0.45


class SuperModel:
    """A belief and a recording, ready to be asked about any parameters and any effects.

    ``recording`` is the number by which the belief's nuisances know it, where several are fitted jointly.
    """

    def __init__(self, belief: Belief, seen: Observations, top_hz: float, recording: int = 0) -> None:
        self.belief, self.seen, self.top_hz, self.recording = belief, seen, top_hz, recording
        self._transforms = Transforms(len(seen.up_mps2), 1.0 / seen.rate_hz, seen.start_s)
        all_hz = self._transforms.f_hz
        low_hz = _LOW * belief.airframe.wing.symmetric.frequency_hz.value
        self._low = int(np.searchsorted(all_hz, low_hz))
        top = int(np.searchsorted(all_hz, min(top_hz, _NYQUIST_SHARE * seen.rate_hz), side="right"))
        self.band_hz: Floats = all_hz[self._low : top]
        self.weight = self._transforms.weight
        self._spectra = Spectra(belief.airframe, seen.sides, all_hz[:top], seen.has_root)
        straightener = Straightener(seen, self._transforms)
        up = straightener.recorded_mps2
        recorded = self._transforms.spectrum(up)[:, :top], self._transforms.tapered(up)[:, self._low : top]
        self._grid = Grid(straightener, self._transforms, self._low, recorded)
        self._toe: ToeModel | None = None
        if seen.toe is not None:
            self._toe = ToeModel(belief, seen, seen.toe, self._transforms, all_hz[:top])

    def expect(self, deviations: Floats, parts: Sequence[Part] = (), near: Expectation | None = None) -> Expectation:
        """Hold a model against the recording.

        Parameters
        ----------
        deviations : (p,)
            Nuisances, in the belief's order.
        parts : sequence of Part
            Named effects in force.
        near : Expectation, optional
            Of a neighbouring model, which lends its ``toe_posterior``, the dear part, and all that is the same.
        """
        deviation = self.belief.named(deviations, self.recording)
        parts = (*self.belief.parts, *parts)
        effects = tuple(part.effect for part in parts)
        wing = WingModel(self.belief.wing(deviation), effects)
        motion = self._motion(wing, parts, deviation, near)
        posterior = near.toe_posterior if near is not None else np.zeros((0, 0))
        toe, variance = np.zeros(0), np.zeros(0)
        if self._toe is not None:
            toe, variance = self._toe.residual(wing, effects, deviation, motion)
            posterior = self._toe.posterior(wing, effects, motion) if near is None else posterior
        return Expectation(motion, toe, posterior, variance, *self._rest(effects, deviation))

    def log_likelihood(self, found: Expectation) -> float:
        """Log likelihood of the recording under an expectation, up to a constant."""
        return float(sum(self.log_scores(found).values()))

    def log_scores(self, found: Expectation) -> dict[str, float]:
        """Log likelihood by channel: accelerations, toe given them, and the sensors' mean."""
        spread = float(np.sum(log_determinant(found.spectrum)))
        misfit = weighed_square(found.inverse, found.residual)
        scores = {"acceleration": -self.weight * (spread + misfit)}
        if len(found.toe_residual_rad):
            factor = cho_factor(found.toe_covariance, lower=True, check_finite=False)
            whitened = found.toe_residual_rad @ cho_solve(factor, found.toe_residual_rad, check_finite=False)
            scores["range"] = float(-np.sum(np.log(np.diag(factor[0]))) - 0.5 * whitened)
        rest = found.rest_residual**2 / found.rest_variance
        scores["rest"] = float(-0.5 * np.sum(rest + np.log(found.rest_variance)))
        return scores

    def data_in_band(self) -> Complexes:
        """The recorded accelerations' tapered spectrum, (c, b); its squared size estimates the two-sided density."""
        return self._grid.recorded[1]

    def residual_force(self, found: Expectation) -> Floats:
        """Score of the likelihood with respect to a force on each believed mode at each instant, (n, m)."""
        believed = WingModel(self.belief.airframe.wing).count
        return self._transforms.in_time(found.motion.force_score[:believed])

    def spring_force(self, found: Expectation) -> Floats:
        """Spring force of the believed modes' smoothed motion, (n, m)."""
        stiffness = WingModel(self.belief.airframe.wing).structure.stiffness_radps2
        return np.asarray(stiffness @ found.q_m[: len(stiffness)])

    @property
    def baseline_m(self) -> float:
        """Believed distance of the cameras; there must be ranges."""
        assert self._toe is not None
        return self._toe.baseline_m

    def time_shift(self, effect: Effect) -> Floats | None:
        """How a unit of the effect's first parameter shifts the channels' time, (c, m) seconds; None if not at all."""
        kind = type(effect)
        if kind.sample_time is Effect.sample_time or kind.response is not Effect.response:
            return None
        declared = effect.parameters()[0]
        unit = kind.from_values({declared.name: declared.sigma})
        t_s = self.seen.t_s
        return np.stack([unit.sample_time(STATIONS[side], t_s) - t_s for side in self.seen.sides]) / declared.sigma

    def _motion(
        self, wing: WingModel, parts: Sequence[Part], deviation: Mapping[str, float], near: Expectation | None
    ) -> Motion:
        """What the accelerations have a say in; half of all parameters are of the cameras alone and leave it."""
        inner = tuple(part for part in parts if part.effect.group is not Group.CAMERA)
        bends = self.seen.has_root  # then the bend per g moves the wing, and not the ranges alone
        key = (inner, tuple(value for name, value in deviation.items() if not of_range(name, bends)))
        if near is not None and near.motion.key == key:
            return near.motion
        effects = tuple(part.effect for part in inner)
        measured = self._grid.straightener.measured_mps2(wing, input_gains(deviation))
        return Motion(
            key,
            wing,
            inner,
            self._grid,
            lambda shape, scale: self._spectra.linear(shape, scale, effects, deviation),
            measured,
        )

    def _rest(self, effects: Sequence[Effect], deviation: Mapping[str, float]) -> tuple[Floats, Floats]:
        shown = self.seen.mean_force_mps2.copy()
        for i, side in enumerate(self.seen.sides):
            name = side.name.lower()
            shown[i] -= deviation.get(f"{name}.bias_mps2", 0.0) - GRAVITY_MPS2 * deviation.get(f"{name}.scale", 0.0)
            shown[i] -= sum(effect.bias(STATIONS[side]) for effect in effects)
        # without a root sensor the mean load factor itself is in doubt, on both sides alike
        doubt = 1e-3 if self.seen.has_root else 3e-3 * GRAVITY_MPS2
        return shown, np.full(len(shown), doubt**2 / self.seen.share)
