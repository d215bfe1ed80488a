"""Nonlinear sensors, and forces of state or time, by statistical linearisation.

Both are split. The mean slope of a force's law acts as stiffness and damping. The geometric mean slope of a reading's
law acts as a scale, because ln det S then holds the Jacobian of the law. The rest is taken out of the data. A law with
memory has a slope by the deflection at every instant before: their mean acts as a linear filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.wing.effect import Effect, ModalMotion, sensed
from companion.core.wing.model import WingModel
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.linear_spectra import STATIONS
from companion.diagnosis.recent_results import RecentResults
from companion.diagnosis.spectral_matrices import apply
from companion.records import Complexes, Floats, Side, Station
from companion.units import GRAVITY_MPS2

_BUMP = 1e-3  # of the standard deviation, for a difference quotient (numerical)
_BUMP_OF_MOTION = 0.05  # of its standard deviation, for a difference quotient across a kink (choice)
_NODES, _WEIGHTS = (-2.334414, -0.741964, 0.741964, 2.334414), (0.045876, 0.454124, 0.454124, 0.045876)
"""Gauss and Hermite's rule of four places, over a standard normal (by definition: Abramowitz and Stegun 25.10)."""
_SHARP = 0.03  # unknown deflection over its rms, below which laws are not averaged over it (choice)
_INVERSIONS = 6  # Newton steps (numerical)
_FLATTEST = 0.3  # least slope of a sensor's law that is inverted (choice)
_INVERTED = 1e-9  # residual at which Newton's method ends (numerical)
_CACHE_SIZE = 4  # sets of effects whose result is kept: most parameters concern no nonlinear sensor (choice)
_RIGID_COLUMNS = {"x": 0, "y": 1, "p": 3, "q": 4, "r": 5}


@dataclass(frozen=True, slots=True)
class StatisticalLinearisation:
    """A force: ``per_q`` and ``per_qdot`` (n, n) of it linear in deflection and speed, and the rest (n, m), m/s^2.

    ``filtered`` (n, n, f) per deflection is what laws with memory are on average, (rad/s)^2; None without.
    """

    per_q: Floats
    per_qdot: Floats
    residual_mps2: Floats
    filtered: Complexes | None = None


class SensorLineariser:
    """One recording's samples and what effects have done to them."""

    def __init__(self, observations: Observations, transforms: Transforms) -> None:
        self._observations, self._transforms = observations, transforms
        self._weight: Floats = transforms.taper**2  # the likelihood sees tapered data
        self._up: Floats = np.ascontiguousarray(observations.up_mps2.T)
        self._t_s: Any = observations.t_s
        self._nothing: Floats = np.zeros(len(self._weight))
        self._signs = _signs(len(self._weight))  # up and down alike, so that a law's curvature is no slope
        self._fine = _Fine(observations, self._weight)
        self._rigid = _rigid_mps2(observations)
        self._bendings: RecentResults[tuple[Effect, ...], tuple[Floats, Floats]] = RecentResults(_CACHE_SIZE)
        self._corrected: RecentResults[tuple[Effect, ...], tuple[Floats, Floats]] = RecentResults(_CACHE_SIZE)
        self._impulses: RecentResults[tuple[Effect, int], Floats] = RecentResults(_CACHE_SIZE)

    @property
    def recorded_mps2(self) -> Floats:
        """The accelerations as recorded, (c, m)."""
        return self._up

    @property
    def rigid_mps2(self) -> tuple[Floats, Floats] | None:
        """Vertical specific force of the rigid aircraft at the root (m,) and what its turning adds at tips (c, m)."""
        return self._rigid

    def corrected_mps2(self, effects: Sequence[Effect]) -> tuple[Floats, Floats]:
        """Undo what effects do to samples that no linear response describes: bends first, then delays in their order.

        Returns
        -------
        (c, m), (c,)
            Accelerations, and the scale on them that the effects' linear part amounts to.
        """
        sensor_effects = tuple(
            effect for effect in effects if type(effect).response is Effect.response and _acts_on_samples(effect)
        )
        return self._corrected.get(sensor_effects, lambda: self._undone(sensor_effects))

    def _undone(self, sensor_effects: tuple[Effect, ...]) -> tuple[Floats, Floats]:
        up, scale = self._up, np.ones(len(self._up))
        bending = tuple(effect for effect in sensor_effects if not _shifts_samples(effect))
        if bending:
            change, scale = self._bendings.get(bending, lambda: self._bent_by(bending))
            up = up - (change - (scale[:, None] - 1.0) * (up - change))
        for effect in sensor_effects:
            if _shifts_samples(effect):
                up = np.stack([self._on_time(effect, i, row) for i, row in enumerate(up)])
        return up, scale

    def nonlinear_part_mps2(self, effect: Effect) -> Floats:
        """Change of a recording by a slight effect on samples beyond its linear part, to first order, (c, m), m/s^2."""
        fine, added = self._fine, np.empty_like(self._up)
        for i, side in enumerate(self._observations.sides):
            station, reading = STATIONS[side], fine.reading(i)
            change = fine.sensed(effect, station, reading) - self._of_root(effect)
            gain = fine.geometric_mean_gain(effect, station, reading) - 1.0
            added[i] = fine.thinned(-change, len(self._up[i])) - gain * self._up[i]
        return added

    def measured_mps2(self, wing: WingModel, gains: Mapping[str, float]) -> Floats | None:
        """Modal loads (n, m) that were recorded: what the load factor bends, inputs times their gain; None for none."""
        observations, structure = self._observations, wing.structure
        load = np.zeros((wing.count, len(observations.up_mps2)))
        if observations.has_root:
            bend = structure.stiffness_radps2 @ structure.static_per_g_m
            factor = observations.wing_load_factor - np.mean(observations.wing_load_factor)
            load += np.outer(bend, self._transforms.periodic(factor[None]))
        for name, values in observations.inputs.items():
            load[0] += gains.get(name, 0.0) * values
        return load if np.any(load) else None

    def linearise_forces(
        self, wing: WingModel, terms: Sequence[EffectTerm], q_m: Floats, qdot_mps: Floats, sigma_m: float = 0.0
    ) -> StatisticalLinearisation:
        """Forces of state and time on a smoothed motion (n, m), split by their mean slopes.

        ``sigma_m`` is the smoother's posterior standard deviation of a half's deflection: a law's mean over it is
        what the data can show of the law.
        """
        forcing = [term for term in terms if term.effect.forces_modes()]
        lasting = [term for term in forcing if type(term.effect).remember is not Effect.remember]
        impulses = [term for term in forcing if term.effect.transient]
        steady = [term for term in forcing if type(term.effect).additive]
        instant = [term for term in forcing if term not in (*lasting, *impulses, *steady)]
        n = len(q_m)
        per_q, per_qdot = np.zeros((n, n)), np.zeros((n, n))
        rest = self._posterior_mean(wing, instant, q_m, qdot_mps, sigma_m)
        if np.any(rest):
            per_q, per_qdot = self._mean_slopes(wing, instant, (q_m, qdot_mps), sigma_m, rest)
            rest = rest - per_q @ q_m - per_qdot @ qdot_mps
        rest = rest + self._total(wing, steady, q_m, qdot_mps)
        filtered = self._mean_filter(wing, lasting, q_m, qdot_mps) if lasting else None
        if filtered is not None:
            linear = np.fft.irfft(apply(filtered, np.fft.rfft(q_m, axis=1)), q_m.shape[1], axis=1)
            rest = rest + self._total(wing, lasting, q_m, qdot_mps) - linear
        for term in impulses:
            rest = rest + self._short(wing, term.effect)
        return StatisticalLinearisation(per_q, per_qdot, rest, filtered)

    def _total(self, wing: WingModel, terms: Sequence[EffectTerm], q_m: Floats, qdot_mps: Floats) -> Floats:
        total = np.zeros_like(q_m)
        for term in terms:
            force = self._force(wing, term, q_m, qdot_mps)
            total = total if force is None else total + force
        return total

    def _posterior_mean(
        self, wing: WingModel, terms: Sequence[EffectTerm], q_m: Floats, qdot_mps: Floats, sigma_m: float
    ) -> Floats:
        """Forces (n, m) averaged over the unknown part of either half's deflection (Gauss and Hermite's rule)."""
        if sigma_m <= _SHARP * float(np.std(q_m[0])):
            return self._total(wing, terms, q_m, qdot_mps)
        averaged = np.zeros_like(q_m)
        for place, weight in zip(_NODES, _WEIGHTS, strict=True):
            shifted = q_m.copy()
            shifted[0] += place * sigma_m  # both halves alike: each has its own law
            averaged += weight * self._total(wing, terms, shifted, qdot_mps)
        return averaged

    def _mean_slopes(
        self,
        wing: WingModel,
        terms: Sequence[EffectTerm],
        motions: tuple[Floats, Floats],
        sigma_m: float,
        total: Floats,
    ) -> tuple[Floats, Floats]:
        """Mean derivatives by deflection and by speed, (n, n) each, of forces that sum to ``total`` (n, m)."""
        n, signed_weight = len(total), self._weight * self._signs / np.sum(self._weight)
        slopes = np.zeros((2, n, n))
        still = self._total(wing, terms, *motions)
        for which, motion in enumerate(motions):
            bumps = _BUMP_OF_MOTION * np.std(motion, axis=1)
            perturbed = list(motions)
            perturbed[which] = motion + np.outer(bumps, self._signs)
            if np.array_equal(self._total(wing, terms, *perturbed), still):
                continue  # most laws follow the deflection or the speed, and not both
            for j, bump in enumerate(bumps.tolist()):
                if bump > 0.0:
                    perturbed = list(motions)
                    perturbed[which] = motion.copy()
                    perturbed[which][j] += bump * self._signs
                    slopes[which, :, j] = (
                        (self._posterior_mean(wing, terms, perturbed[0], perturbed[1], sigma_m) - total)
                        @ signed_weight
                        / bump
                    )
        return slopes[0], slopes[1]

    def _mean_filter(self, wing: WingModel, terms: Sequence[EffectTerm], q_m: Floats, qdot_mps: Floats) -> Complexes:
        """Forces with memory as the filter (n, n, f) of the motion that they are on average, (rad/s)^2.

        It is the transform of the mean derivative by the deflection at each lag. It is causal, and so ln det S of it
        changes by what it damps at every instant: nothing, where no force follows the speed. A filter regressed band by
        band is not causal: its ln det S rewards slipping itself.
        """
        filtered = np.zeros((len(q_m), len(q_m), q_m.shape[1] // 2 + 1), dtype=np.complex128)
        for term in terms:
            motion = self._modal_motion(wing, term, q_m, qdot_mps)
            each = np.fft.rfft(term.effect.mean_derivative(motion, self._weight), axis=1)
            mean, against = 0.5 * (each[0] + each[-1]), 0.5 * (each[-1] - each[0])
            filtered[0, 0] += mean
            if len(each) > 1:
                filtered[1, 1] += mean
                filtered[0, 1] += against
                filtered[1, 0] += against
        return filtered

    def _force(self, wing: WingModel, term: EffectTerm, q: Floats, qdot: Floats) -> Floats | None:
        return term.effect.force(self._modal_motion(wing, term, q, qdot))

    def _modal_motion(self, wing: WingModel, term: EffectTerm, q: Floats, qdot: Floats) -> ModalMotion:
        follows = self._observations.covariates.get(term.channel, self._nothing)
        return ModalMotion(self._t_s, q, qdot, np.zeros((wing.count, 1)), 1.0, wing.structure, follows)

    def _short(self, wing: WingModel, effect: Effect) -> Floats:
        """Loads (n, m) that last for less than a sample and follow no motion, without what no sample can hold; kept."""
        return self._impulses.get((effect, wing.count), lambda: self._cut_to_band(wing, effect))

    def _cut_to_band(self, wing: WingModel, effect: Effect) -> Floats:
        rate_hz, start_s, count = self._observations.rate_hz, self._observations.start_s, len(self._t_s)
        omega_radps: Floats = np.asarray(2.0 * np.pi * np.fft.rfftfreq(count, 1.0 / rate_hz), dtype=np.float64)
        spectrum = effect.kick_spectrum(omega_radps, wing.count, start_s, start_s + count / rate_hz)
        return np.asarray(np.fft.irfft(rate_hz * spectrum, count, axis=1))

    def _on_time(self, effect: Effect, channel: int, up: Floats) -> Floats:
        """A station's reading (m,) at the instants at which it belongs: read at the mirrored ones."""
        station, t_s = STATIONS[self._observations.sides[channel]], self._t_s
        stamped = effect.sample_time(station, t_s)
        if stamped is t_s:
            return up
        # the sensor is late with all that it reads, the rigid aircraft's motion included
        rigid = np.zeros(len(up)) if self._rigid is None else self._rigid[0] + self._rigid[1][channel]
        return np.asarray(rigid + self._transforms.at(np.fft.rfft(up - rigid), 2.0 * t_s - stamped))

    def _bent_by(self, effects: tuple[Effect, ...]) -> tuple[Floats, Floats]:
        """Sum that effects have added to the channels (c, m), and the scales they amount to (c,)."""
        bent = [self._bent(effects, side, i) for i, side in enumerate(self._observations.sides)]
        return np.stack([entry[0] for entry in bent]), np.array([entry[1] for entry in bent])

    def _bent(self, effects: Sequence[Effect], side: Side, channel: int) -> tuple[Floats, float]:
        """Sum that effects, in their order, have added to a station's reading, (m,), and the scale they amount to."""
        fine, station = self._fine, STATIONS[side]
        reading = true = fine.reading(channel)
        scale, added_to_root = 1.0, np.zeros(len(reading))
        for effect in reversed(effects):
            if type(effect).additive:
                true = true - fine.sensed(effect, station, true)
            else:
                true = fine.inverted(effect, station, true)
                scale *= fine.geometric_mean_gain(effect, station, true)
            added_to_root += self._of_root(effect)
        return fine.thinned(true - reading + added_to_root, len(self._up[channel])), scale

    def _of_root(self, effect: Effect) -> Floats | float:
        """Error that an effect adds to a root sensor, which tells the load factor, m/s^2."""
        fine = self._fine
        return (
            fine.sensed(effect, Station.ROOT, -GRAVITY_MPS2 * fine.wing_load_factor)
            if self._observations.has_root
            else 0.0
        )


class _Fine:
    """The same recording at its sensors' own rate, where what is nonlinear bends the whole band."""

    def __init__(self, observations: Observations, weight: Floats) -> None:
        up = observations.up_mps2 if observations.fine_mps2 is None else observations.fine_mps2
        rate_hz = observations.rate_hz if observations.fine_mps2 is None else observations.fine_hz
        self.up_mps2: Floats = np.ascontiguousarray(up.T)
        self._t_s: Floats = observations.start_s + np.arange(len(up)) / rate_hz
        self.load_factor: Floats = np.interp(self._t_s, observations.t_s, observations.load_factor)
        self.wing_load_factor: Floats = np.interp(self._t_s, observations.t_s, observations.wing_load_factor)
        self._weight: Floats = np.interp(self._t_s, observations.t_s, weight)
        # a law may know the samples' own mean, which a bump of all alike would move
        self._signs = _signs(len(up))
        self._values = np.zeros((6, len(up))).T  # columns in a piece: effects change the vertical one
        for name, column in _RIGID_COLUMNS.items():
            if name in observations.rigid:
                self._values[:, column] = np.interp(self._t_s, observations.t_s, observations.rigid[name])

    def reading(self, channel: int) -> Floats:
        """The vertical specific force that a channel shows."""
        return np.asarray(-GRAVITY_MPS2 * self.load_factor - self.up_mps2[channel])

    def sensed(self, effect: Effect, station: Station, force_z: Floats) -> Floats:
        """Error that an effect adds to a station's vertical specific force, m/s^2."""
        self._values[:, 2] = force_z
        return np.asarray(sensed((effect,), station, self._t_s, self._values)[:, 2] - force_z)

    def inverted(self, effect: Effect, station: Station, reading: Floats) -> Floats:
        """The vertical specific force of which an effect makes what is shown; Newton's steps, sample by sample."""
        small = _BUMP * float(np.std(reading))
        force, bump = reading, small * self._signs
        gone = np.zeros(len(reading), dtype=bool)
        for _ in range(_INVERSIONS):
            added = self.sensed(effect, station, force)
            miss = force + added - reading
            if float(np.max(np.abs(miss), where=~gone, initial=0.0)) <= _INVERTED * small:
                break
            slope = 1.0 + (self.sensed(effect, station, force + bump) - added) / bump
            force = np.where(gone, force, force - miss / np.maximum(slope, _FLATTEST))
            # a characteristic that turns back is continued straight
            gone |= slope < _FLATTEST
        return np.asarray(force)

    def geometric_mean_gain(self, effect: Effect, station: Station, force: Floats) -> float:
        """Geometric mean of the characteristic's slope over a station's samples: what it is as a scale.

        The mean logarithm of the slopes is the log Jacobian per sample. As a scale it makes the likelihood of a bent
        Gaussian unbiased however much it is bent. With the arithmetic mean, which is equal to first order, strong bends
        come out a third too weak.
        """
        bump = _BUMP * float(np.std(force)) * self._signs
        changed = self.sensed(effect, station, force + bump) - self.sensed(effect, station, force - bump)
        logarithms = np.log(np.maximum(1.0 + changed / (2.0 * bump), _FLATTEST))
        return float(np.exp(np.sum(self._weight * logarithms) / np.sum(self._weight)))

    def thinned(self, values: Floats, count: int) -> Floats:
        """The lower part of the spectrum, on the coarse grid."""
        if len(values) == count:
            return values
        spectrum = np.fft.rfft(values)[: count // 2 + 1]
        return np.asarray(np.fft.irfft(spectrum, count) * (count / len(values)))


def _rigid_mps2(observations: Observations) -> tuple[Floats, Floats] | None:
    if observations.turning_mps2 is None:
        return None
    turning = observations.turning_mps2 - observations.turning_mps2.mean(0)
    factor = observations.wing_load_factor
    return GRAVITY_MPS2 * (np.mean(factor) - factor), np.ascontiguousarray(turning.T)


def _signs(count: int) -> Floats:
    return np.where(np.random.default_rng(count).uniform(size=count) < 0.5, -1.0, 1.0)


def _shifts_samples(effect: Effect) -> bool:
    return type(effect).sample_time is not Effect.sample_time


def _acts_on_samples(effect: Effect) -> bool:
    return type(effect).sense is not Effect.sense or _shifts_samples(effect)
