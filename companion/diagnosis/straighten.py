"""What no linear, steady model makes: crooked sensors, and forces of state or time.

Both are split. The mean slope of a law acts as stiffness and damping (of the reading: as a scale): it is what the law
does to the volume of motions, which the spectrum's determinant stands for. What is left is taken out of the data. A law
with memory has no slope of an instant; of it goes, band by band, what is correlated with the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.wing.effect import Effect, ModalMotion
from companion.core.wing.model import WingModel
from companion.diagnosis.linear import STATIONS
from companion.diagnosis.observations import Observations
from companion.diagnosis.part import Part
from companion.diagnosis.transforms import Transforms
from companion.records import Floats, Side, Station

GRAVITY_MPS2 = 9.80665
_BANDS = 60
_BUMP = 1e-3
_BUMP_OF_MOTION = 0.05  # of its standard deviation: a kink is seen with its surroundings
_INVERSIONS = 6
_FLATTEST = 0.3
_INVERTED = 1e-9
_TURNED = 0.5  # of what is shown is missing where a cubic one turns back
_RIGID_COLUMNS = {"x": 0, "y": 1, "p": 3, "q": 4, "r": 5}


@dataclass(frozen=True, slots=True)
class Push:
    """A force: ``per_q`` and ``per_qdot`` (n, n) of it linear in deflection and speed, and the rest (n, m), m/s^2."""

    per_q: Floats
    per_qdot: Floats
    rest_mps2: Floats


class Straightener:
    """One recording's samples and what effects have done to them."""

    def __init__(self, seen: Observations, transforms: Transforms) -> None:
        self._seen, self._transforms = seen, transforms
        self._weight: Floats = transforms.taper**2  # the likelihood sees tapered data
        self._up: Floats = np.ascontiguousarray(seen.up_mps2.T)
        self._signs = _signs(len(self._weight))  # up and down alike, so that a law's curvature is no slope
        self._fine = _Fine(seen, self._weight)

    @property
    def recorded_mps2(self) -> Floats:
        """The accelerations as recorded, (c, m)."""
        return self._up

    def straight_mps2(self, effects: Sequence[Effect]) -> tuple[Floats, Floats]:
        """Undo, to first order, what effects do to samples that no linear response describes.

        Returns
        -------
        (c, m), (c,)
            Accelerations, and the scale on them that the effects' linear part amounts to.
        """
        up, scale = self._up, np.ones(len(self._up))
        for effect in effects:
            if type(effect).response is not Effect.response or not _acts_on_samples(effect):
                continue
            if type(effect).sample_time is not Effect.sample_time:
                up = up - np.stack([self._shifted(effect, side, i) for i, side in enumerate(self._seen.sides)])
                continue
            bent = [self._bent(effect, side, i) for i, side in enumerate(self._seen.sides)]
            change, share = np.stack([entry[0] for entry in bent]), np.array([entry[1] for entry in bent])
            up = up - (change - share[:, None] * (self._up - change))
            scale = scale * (1.0 + share)
        return up, scale

    def bending_mps2(self, effect: Effect) -> Floats:
        """What a slight effect on samples adds to a recording beyond its linear part, to first order, (c, m)."""
        bent = [self._bent(effect, side, i, slight=True) for i, side in enumerate(self._seen.sides)]
        return np.stack([change - share * up for (change, share), up in zip(bent, self._up, strict=True)])

    def measured_mps2(self, wing: WingModel, gains: Mapping[str, float]) -> Floats | None:
        """Modal loads (n, m) that were recorded: what the load factor bends, inputs times their gain; None for none."""
        seen, structure = self._seen, wing.structure
        load = np.zeros((wing.count, len(seen.up_mps2)))
        if seen.has_root:
            bend = structure.stiffness_radps2 @ structure.static_per_g_m
            load += np.outer(bend, seen.load_factor - np.mean(seen.load_factor))
        for name, values in seen.inputs.items():
            load[0] += gains.get(name, 0.0) * values
        return load if np.any(load) else None

    def push(self, wing: WingModel, parts: Sequence[Part], q_m: Floats, qdot_mps: Floats) -> Push:
        """Forces of state and time on a smoothed motion (n, m), split by their mean slopes."""
        forcing = [part for part in parts if part.effect.forces_modes()]
        lasting = [part for part in forcing if type(part.effect).remember is not Effect.remember]
        instant = [part for part in forcing if part not in lasting]
        n = len(q_m)
        per_q, per_qdot = np.zeros((n, n)), np.zeros((n, n))
        rest = self._total(wing, instant, q_m, qdot_mps)
        if np.any(rest):
            per_q, per_qdot = self._mean_slopes(wing, instant, q_m, qdot_mps)
            rest = rest - per_q @ q_m - per_qdot @ qdot_mps
        slipped = self._total(wing, lasting, q_m, qdot_mps)
        if np.any(slipped):
            weights = self._regressed(slipped, np.vstack([q_m, qdot_mps]))
            per_q, per_qdot = per_q + weights[:, :n], per_qdot + weights[:, n:]
            rest = rest + self._uncorrelated(slipped - weights @ np.vstack([q_m, qdot_mps]), q_m)
        return Push(per_q, per_qdot, rest)

    def _total(self, wing: WingModel, parts: Sequence[Part], q_m: Floats, qdot_mps: Floats) -> Floats:
        total = np.zeros_like(q_m)
        for part in parts:
            force = self._force(wing, part, q_m, qdot_mps)
            total = total if force is None else total + force
        return total

    def _mean_slopes(
        self, wing: WingModel, parts: Sequence[Part], q_m: Floats, qdot_mps: Floats
    ) -> tuple[Floats, Floats]:
        """Mean derivatives of forces by deflection and by speed, (n, n) each."""
        n, share = len(q_m), self._weight * self._signs / np.sum(self._weight)
        slopes, total = np.zeros((2, n, n)), self._total(wing, parts, q_m, qdot_mps)
        for which, motion in enumerate((q_m, qdot_mps)):
            for j in range(n):
                bump = _BUMP_OF_MOTION * float(np.std(motion[j]))
                if bump > 0.0:
                    there = [q_m, qdot_mps]
                    there[which] = motion.copy()
                    there[which][j] += bump * self._signs
                    slopes[which, :, j] = (self._total(wing, parts, *there) - total) @ share / bump
        return slopes[0], slopes[1]

    def _regressed(self, force: Floats, basis: Floats) -> Floats:
        """Weights (n, k) of a basis (k, m) that come nearest to a force (n, m)."""
        weighed = self._weight * basis
        scale = np.sqrt(np.maximum(np.sum(weighed * basis, axis=1), 1e-300))
        gram = (weighed @ basis.T) / np.outer(scale, scale)
        found = np.linalg.lstsq(gram, (weighed / scale[:, None]) @ force.T, rcond=1e-9)[0] / scale[:, None]
        return np.asarray(found.T)

    def _uncorrelated(self, rest: Floats, q_m: Floats) -> Floats:
        """What is left of a force once, band by band, all is out that a linear filter of the motion makes."""
        taper = self._transforms.taper
        spectrum, wanted, motion = (np.fft.rfft(x, axis=1) for x in (rest, rest * taper, q_m * taper))
        whole = np.fft.rfft(q_m, axis=1)
        for band in np.array_split(np.arange(spectrum.shape[1]), _BANDS):
            known = motion[:, band]
            power = known @ known.conj().T
            power += (1e-9 * np.trace(power).real + 1e-300) * np.eye(len(known))
            filters = np.linalg.solve(power.T, (wanted[:, band] @ known.conj().T).T).T
            spectrum[:, band] -= filters @ whole[:, band]
        return np.asarray(np.fft.irfft(spectrum, rest.shape[1], axis=1))

    def _force(self, wing: WingModel, part: Part, q: Floats, qdot: Floats) -> Floats | None:
        t_s: Any = self._seen.t_s
        static = np.zeros((wing.count, 1))
        channel = self._seen.covariates.get(part.channel)
        follows = np.zeros(len(self._seen.up_mps2)) if channel is None else channel
        return part.effect.force(ModalMotion(t_s, q, qdot, static, 1.0, wing.structure, follows))

    def _shifted(self, effect: Effect, side: Side, channel: int) -> Floats:
        """What an effect on sample times has added to what a station shows, (m,)."""
        station, t_s, up = STATIONS[side], self._seen.t_s, self._up[channel]
        # what is shown at t is taken back to where it belongs: up - (shown - up) is up at the mirrored instant
        mirrored = 2.0 * t_s - effect.sample_time(station, t_s)
        return np.asarray(up - self._transforms.at(np.fft.rfft(up), mirrored))

    def _bent(self, effect: Effect, side: Side, channel: int, slight: bool = False) -> tuple[Floats, float]:
        """What an effect has added to what a station shows, (m,), and its mean slope; ``slight``: to first order."""
        fine, station = self._fine, STATIONS[side]
        shown = -GRAVITY_MPS2 * fine.load_factor - fine.up_mps2[channel]
        true = shown if slight else fine.inverted(effect, station, shown)
        added = fine.sensed(effect, station, shown) if slight else shown - true
        if self._seen.has_root:
            added = added - fine.sensed(effect, Station.ROOT, -GRAVITY_MPS2 * fine.load_factor)
        return fine.thinned(-added, len(self._up[channel])), fine.slope(effect, station, true)


class _Fine:
    """The same recording at its sensors' own rate, where what is crooked bends the whole band."""

    def __init__(self, seen: Observations, weight: Floats) -> None:
        up = seen.up_mps2 if seen.fine_mps2 is None else seen.fine_mps2
        rate_hz = seen.rate_hz if seen.fine_mps2 is None else seen.fine_hz
        self.up_mps2: Floats = np.ascontiguousarray(up.T)
        self._t_s: Floats = seen.start_s + np.arange(len(up)) / rate_hz
        self.load_factor: Floats = np.interp(self._t_s, seen.t_s, seen.load_factor)
        self._weight: Floats = np.interp(self._t_s, seen.t_s, weight)
        # a law may know the samples' own mean, which a bump of all alike would move
        self._signs = _signs(len(up))
        self._rigid = np.zeros((len(up), 6))
        for name, column in _RIGID_COLUMNS.items():
            if name in seen.rigid:
                self._rigid[:, column] = np.interp(self._t_s, seen.t_s, seen.rigid[name])

    def sensed(self, effect: Effect, station: Station, force_z: Floats) -> Floats:
        """What an effect adds to a station's vertical specific force."""
        values = self._rigid.copy()
        values[:, 2] = force_z
        return np.asarray(effect.sense(station, self._t_s, values)[:, 2] - force_z)

    def inverted(self, effect: Effect, station: Station, shown: Floats) -> Floats:
        """The vertical specific force of which an effect makes what is shown; Newton's steps, sample by sample."""
        small = _BUMP * float(np.std(shown))
        force, bump = shown, small * self._signs
        reach = _TURNED * np.abs(shown - np.mean(shown))
        for _ in range(_INVERSIONS):
            added = self.sensed(effect, station, force)
            miss = force + added - shown
            if float(np.max(np.abs(miss))) <= _INVERTED * small:
                break
            slope = 1.0 + (self.sensed(effect, station, force + bump) - added) / bump
            # a characteristic that turns back has no inverse beyond
            force = np.clip(force - miss / np.maximum(slope, _FLATTEST), shown - reach, shown + reach)
        return np.asarray(force)

    def slope(self, effect: Effect, station: Station, force: Floats) -> float:
        """Mean slope of what an effect makes of a station's samples: its linear part, which leaves no change of volume.

        (The same as the regression on the samples in the mean, by Stein, but that one wanders as their power does.)
        """
        bump = _BUMP * float(np.std(force)) * self._signs
        changed = self.sensed(effect, station, force + bump) - self.sensed(effect, station, force - bump)
        return float(np.sum(self._weight * changed / (2.0 * bump)) / np.sum(self._weight))

    def thinned(self, values: Floats, count: int) -> Floats:
        """The lower part of the spectrum, on the coarse grid."""
        if len(values) == count:
            return values
        spectrum = np.fft.rfft(values)[: count // 2 + 1]
        return np.asarray(np.fft.irfft(spectrum, count) * (count / len(values)))


def _signs(count: int) -> Floats:
    return np.where(np.random.default_rng(count).uniform(size=count) < 0.5, -1.0, 1.0)


def _acts_on_samples(effect: Effect) -> bool:
    return type(effect).sense is not Effect.sense or type(effect).sample_time is not Effect.sample_time
