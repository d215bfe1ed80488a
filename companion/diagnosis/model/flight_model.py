"""Likelihood of one recording of a flight in the frequency domain.

The tips' accelerations are a stationary process with spectral matrix S(f) (Whittle). Forces that depend on state or
time, and the nonlinearity of sensors, are taken out of the data first. The toe at each exposure is judged given the
accelerations: its mean by the Wiener smoother of the same model, its covariance by the spectrum of the posterior.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import cho_solve

from companion.core.wing.effect import Effect, Group
from companion.core.wing.model import WingModel
from companion.core.wing.structure import Structure
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.belief import Belief, Nuisance, input_gains, is_range_only
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation, Motion, ToeErrors
from companion.diagnosis.model.linear_spectra import STATIONS, Spectra, spectrum_of
from companion.diagnosis.model.motion import RecordedSpectra, SmoothedMotion
from companion.diagnosis.model.nonlinear_correction import SensorLineariser
from companion.diagnosis.model.toe import ToeModel
from companion.diagnosis.spectral_matrices import adjoint, apply, inverse, log_determinant, quadratic_form
from companion.records import Complexes, Floats
from companion.units import GRAVITY_MPS2

_LOW = 0.15  # of the first symmetric frequency: lower edge of the band (choice)
# the same where no gyro recorded the aircraft's roll, which no tip can tell from the wing (choice)
_LOW_UNDER_ROLL = 0.4
_UNIT = 1e-3  # prior sigmas, for a difference quotient (numerical)
_NYQUIST_SHARE = 0.45  # of the rate, below the anti-alias filter's roll-off (choice)


class FlightModel:
    """Likelihood of one recording under a belief, for any parameters and any effects.

    ``recording`` is its number in the keys of the belief's nuisances, where several are fitted jointly. With
    ``toe_alone`` its accelerations serve to smooth the motion, and only the toe is judged.
    """

    def __init__(
        self, belief: Belief, observations: Observations, top_hz: float, recording: int = 0, toe_alone: bool = False
    ) -> None:
        self.belief, self.observations, self.top_hz, self.recording = belief, observations, top_hz, recording
        self.transforms = Transforms(len(observations.up_mps2), 1.0 / observations.rate_hz, observations.start_s)
        all_hz = self.transforms.f_hz
        first_hz = belief.airframe.wing.symmetric.frequency_hz.value
        low_hz = (_LOW_UNDER_ROLL if observations.roll_is_missing else _LOW) * first_hz
        self._low = int(np.searchsorted(all_hz, low_hz))
        top = int(np.searchsorted(all_hz, min(top_hz, _NYQUIST_SHARE * observations.rate_hz), side="right"))
        self.band_hz: Floats = all_hz[self._low : top]
        self._toe_alone = toe_alone
        self.weight = 0.0 if toe_alone else self.transforms.weight * observations.recorded_ratio
        self._spectra = Spectra(belief.airframe, observations.sides, all_hz[:top], observations.has_root)
        lineariser = SensorLineariser(observations, self.transforms)
        up = lineariser.recorded_mps2
        plain = self.transforms.spectrum(self.transforms.periodic(up))[:, :top]
        recorded = plain, self.transforms.tapered(up)[:, self._low : top]
        onset = self.transforms.onset(self._low, top)
        self._grid = RecordedSpectra(lineariser, self.transforms, self._low, recorded, onset)
        self._rigid: tuple[Complexes, Complexes] | None = None
        if lineariser.rigid_mps2 is not None:
            heave, turning = (self.transforms.spectrum(values)[..., :top] for values in lineariser.rigid_mps2)
            self._rigid = heave, turning
        self._toe: ToeModel | None = None
        if observations.toe is not None:
            self._toe = ToeModel(belief, observations, observations.toe, self.transforms, all_hz[:top])

    def expect(
        self,
        deviations: Floats,
        terms: Sequence[EffectTerm] = (),
        near: Expectation | None = None,
        small_step: bool = False,
    ) -> Expectation:
        """Hold a model against the recording.

        Parameters
        ----------
        deviations : (p,)
            Nuisances, in the belief's order.
        terms : sequence of EffectTerm
            Named effects in force.
        near : Expectation, optional
            Of a neighbouring model. The posterior of its toe, which is slow to compute, and all that is equal are
            reused.
        small_step : bool
            Whether ``near`` is one step of a difference quotient away: forces then act on its motion.
        """
        deviation = self.belief.named(deviations, self.recording)
        terms = (*self.belief.terms, *terms)
        effects = tuple(term.effect for term in terms)
        wing = WingModel(self.belief.wing(deviation), effects)
        motion = self._motion(wing, terms, deviation, near, small_step)
        toe, errors = np.zeros(0), ToeErrors(np.zeros((0, 0)), np.zeros(0))
        if self._toe is not None:
            toe, variance = self._toe.residual(wing, effects, deviation, motion)
            if near is not None:
                errors = near.toe_errors.with_variance(variance)
            else:
                errors = ToeErrors(self._toe.posterior(wing, effects, motion), variance)
        return Expectation(motion, toe, errors, *self._rest(effects, deviation))

    def acceleration_spectrum(self, deviations: Floats) -> Complexes:
        """Two-sided density of the accelerations in the band without any effect beyond the belief's, (c, c, b)."""
        deviation = self.belief.named(deviations, self.recording)
        effects = tuple(term.effect for term in self.belief.terms if term.effect.group is not Group.CAMERA)
        structure = self.structure(deviations, effects)
        scale = np.ones(len(self.observations.sides))
        return spectrum_of(self._spectra.linear(structure, scale, effects, deviation), self._low)

    def structure(self, deviations: Floats, effects: Sequence[Effect]) -> Structure:
        """The wing's linear model at deviations (p,) from the belief, with some effects."""
        deviation = self.belief.named(deviations, self.recording)
        return WingModel(self.belief.wing(deviation), tuple(effects)).structure

    def log_likelihood(self, expectation: Expectation) -> float:
        """Log likelihood of the recording under an expectation, up to a constant."""
        return float(sum(self.log_scores(expectation).values()))

    def log_scores(self, expectation: Expectation) -> dict[str, float]:
        """Log likelihood by channel: accelerations, toe given them, and the sensors' mean; or of the toe alone."""
        scores = {}
        if not self._toe_alone:
            spread = float(np.sum(log_determinant(expectation.spectrum)))
            mahalanobis = quadratic_form(expectation.inverse, expectation.residual)
            scores["acceleration"] = -self.weight * (spread + mahalanobis)
        if len(expectation.toe_residual_rad):
            factor, residual = expectation.toe_errors.factor, expectation.toe_residual_rad
            whitened = residual @ cho_solve((factor, True), residual, check_finite=False)
            scores["range"] = float(-np.sum(np.log(np.diag(factor))) - 0.5 * whitened)
        if self._toe_alone:
            return scores
        rest = expectation.rest_residual**2 / expectation.rest_variance
        scores["rest"] = float(-0.5 * np.sum(rest + np.log(expectation.rest_variance)))
        return scores

    def data_in_band(self) -> Complexes:
        """The recorded accelerations' tapered spectrum, (c, b); its squared size estimates the two-sided density."""
        return self._grid.recorded[1]

    def in_band(self, values: Floats) -> Complexes:
        """Accelerations (c, m) as tapered spectrum in the band, (c, b)."""
        return self.transforms.tapered(values)[:, self._low : self._low + len(self.band_hz)]

    def draw(self, expectation: Expectation, rng: np.random.Generator) -> Floats:
        """Accelerations drawn from a fitted model, (c, m), m/s^2."""
        shape = expectation.residual.shape
        white = np.sqrt(0.5) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        spectrum = np.zeros((shape[0], len(self.transforms.f_hz)), dtype=np.complex128)
        coloured = apply(inverse(adjoint(expectation.motion.whitener)), white)
        spectrum[:, self._low : self._low + shape[1]] = coloured * np.sqrt(self.transforms.count / self.transforms.dt_s)
        return self.transforms.in_time(spectrum)

    def force_score(self, expectation: Expectation) -> Floats:
        """Score of the likelihood with respect to a force on each believed mode at each instant, (n, m)."""
        believed = WingModel(self.belief.airframe.wing).count
        return self.transforms.in_time(expectation.motion.force_score[:believed])

    def spring_force(self, expectation: Expectation) -> Floats:
        """Spring force of the believed modes' smoothed motion, (n, m)."""
        stiffness = WingModel(self.belief.airframe.wing).structure.stiffness_radps2
        return np.asarray(stiffness @ expectation.q_m[: len(stiffness)])

    @property
    def baseline_m(self) -> float:
        """Believed distance of the cameras; there must be ranges."""
        assert self._toe is not None
        return self._toe.baseline_m

    def time_shift(self, effect: Effect, which: int) -> Floats | None:
        """Shift of the channels' time by a unit of one of the effect's parameters, (c, m) seconds; None for none."""
        if type(effect).sample_time is Effect.sample_time:
            return None
        declared, t_s = effect.parameters()[which], self.observations.t_s
        step = _UNIT * declared.sigma
        beside = dataclasses.replace(effect, **{declared.name: getattr(effect, declared.name) + step})
        shifted = [
            beside.sample_time(STATIONS[side], t_s) - effect.sample_time(STATIONS[side], t_s)
            for side in self.observations.sides
        ]
        return np.stack(shifted) / step

    def delay_shift(self, nuisance: Nuisance) -> Floats | None:
        """The same for a nuisance: (c, m) if it is a delay."""
        delays = [f"{side.name.lower()}.delay_s" for side in self.observations.sides]
        late = [-1.0 if nuisance.name == delay else 0.0 for delay in delays]
        return np.outer(late, np.ones(len(self.observations.t_s))) if any(late) else None

    def certain_shifted(self, expectation: Expectation, shift_s: Floats) -> Complexes | None:
        """Change of the rigid aircraft's and the forced motion by shifts in time (c, m), in the band, (c, b)."""
        forced = expectation.motion.forced_mps2
        if self._rigid is None and forced is None:
            return None
        # a sensor that is late shows the tip as it was, and so the wing against a root that is not late
        late = np.zeros_like(expectation.motion.linear.sensing[:, 0]) if forced is None else -forced
        if self._rigid is not None:
            late = late + self._rigid[0] + self._rigid[1]
        rate = 2j * np.pi * self.transforms.f_hz[: late.shape[-1]] * late
        return self.in_band(self.transforms.in_time(rate) * shift_s)

    def _motion(
        self,
        wing: WingModel,
        terms: Sequence[EffectTerm],
        deviation: Mapping[str, float],
        near: Expectation | None,
        small_step: bool,
    ) -> Motion:
        """Motion under a model; the neighbour's where parameters differ that concern the cameras alone."""
        inner = tuple(term for term in terms if term.effect.group is not Group.CAMERA)
        bends = self.observations.has_root  # then the bend per g moves the wing, and not the ranges alone
        key = (inner, tuple(value for name, value in deviation.items() if not is_range_only(name, bends)))
        if near is not None and near.motion.key == key:
            return near.motion
        effects = tuple(term.effect for term in inner)
        measured = self._grid.lineariser.measured_mps2(wing, input_gains(deviation))
        leaked = self._leaked_mps2(effects, deviation)
        return SmoothedMotion(
            key,
            wing,
            inner,
            self._grid,
            lambda shape, scale, filtered=None: self._spectra.linear(shape, scale, effects, deviation, filtered),
            measured,
            leaked,
            near.motion if near is not None and small_step and isinstance(near.motion, SmoothedMotion) else None,
        )

    def _leaked_mps2(self, effects: Sequence[Effect], deviation: Mapping[str, float]) -> Floats | None:
        """Motion of the rigid aircraft that stays in the accelerations by the sensors' errors, (c, m), m/s^2."""
        if self._rigid is None:
            return None
        heave, turning = self._rigid
        leaked = (1.0 - self._spectra.responses(effects, deviation)) * (heave + turning)
        leaked += deviation.get("root.scale", 0.0) * heave + deviation.get("root.rate_scale", 0.0) * turning
        return self.transforms.in_time(leaked)

    def _rest(self, effects: Sequence[Effect], deviation: Mapping[str, float]) -> tuple[Floats, Floats]:
        if self._toe_alone:
            return np.zeros(0), np.zeros(0)
        mean_residual = self.observations.mean_force_mps2.copy()
        for i, side in enumerate(self.observations.sides):
            name = side.name.lower()
            mean_residual[i] -= deviation.get(f"{name}.bias_mps2", 0.0) - GRAVITY_MPS2 * deviation.get(
                f"{name}.scale", 0.0
            )
            mean_residual[i] -= sum(effect.bias(STATIONS[side]) for effect in effects)
            mean_residual[i] += deviation.get("root.bias_mps2", 0.0) - GRAVITY_MPS2 * deviation.get("root.scale", 0.0)
        # without a root sensor the mean load factor itself is in doubt, on both sides alike
        mean_sigma_mps2 = 1e-3 if self.observations.has_root else 3e-3 * GRAVITY_MPS2
        variance = np.full(len(mean_residual), mean_sigma_mps2**2 / self.observations.used_ratio)
        recoil = self.observations.recoil
        if recoil is None:
            return mean_residual, variance
        delay_s = self._spectra.delay_s(effects, deviation, recoil.frequency_hz, self.observations.t_s)
        return np.append(mean_residual, recoil.delay_s - delay_s), np.append(variance, recoil.sigma_s**2)
