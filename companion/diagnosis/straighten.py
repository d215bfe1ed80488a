"""What no linear, steady model makes: crooked sensors, and forces of state or time.

Both are split by statistical linearisation. Of a Gaussian motion the part of a law that is linear in the state acts as
stiffness and damping (of the reading: as a scale), and what is left is uncorrelated with the motion at every lag
(Bussgang), so that it can be taken out of the data without pretending that the wing moves less. A law with memory is
made so band by band.
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
            change = np.stack([self._change(effect, side, i) for i, side in enumerate(self._seen.sides)])
            if type(effect).sample_time is Effect.sample_time:
                share = np.array([self._fine.slope(effect, STATIONS[side]) for side in self._seen.sides])
                change = change - share[:, None] * up
                scale = scale * (1.0 + share)
            up = up - change
        return up, scale

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
        """Forces of state and time on a smoothed motion (n, m), split by statistical linearisation."""
        total, lasting = np.zeros_like(q_m), False
        for part in parts:
            if not part.effect.forces_modes():
                continue
            force = self._force(wing, part, q_m, qdot_mps)
            if force is not None:
                total = total + force
                lasting = lasting or type(part.effect).remember is not Effect.remember
        if not np.any(total):
            return Push(np.zeros((len(q_m),) * 2), np.zeros((len(q_m),) * 2), total)
        basis = np.vstack([q_m, qdot_mps])
        weighed = self._weight * basis
        scale = np.sqrt(np.maximum(np.sum(weighed * basis, axis=1), 1e-300))
        gram = (weighed @ basis.T) / np.outer(scale, scale)
        weights = np.linalg.lstsq(gram, (weighed / scale[:, None]) @ total.T, rcond=1e-9)[0] / scale[:, None]
        rest = total - weights.T @ basis
        n = len(q_m)
        return Push(weights[:n].T, weights[n:].T, self._uncorrelated(rest, q_m) if lasting else rest)

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

    def _change(self, effect: Effect, side: Side, channel: int) -> Floats:
        """What an effect has added to what a station shows, (m,)."""
        station, t_s, up = STATIONS[side], self._seen.t_s, self._up[channel]
        if type(effect).sample_time is not Effect.sample_time:
            # what is shown at t is taken back to where it belongs: up - (shown - up) is up at the mirrored instant
            mirrored = 2.0 * t_s - effect.sample_time(station, t_s)
            return np.asarray(up - self._transforms.at(np.fft.rfft(up), mirrored))
        fine = self._fine
        added = fine.sensed(effect, station, -GRAVITY_MPS2 * fine.load_factor - fine.up_mps2[channel])
        if self._seen.has_root:
            added = added - fine.sensed(effect, Station.ROOT, -GRAVITY_MPS2 * fine.load_factor)
        return fine.thinned(-added, len(up))


class _Fine:
    """The same recording at its sensors' own rate, where what is crooked bends the whole band."""

    def __init__(self, seen: Observations, weight: Floats) -> None:
        up = seen.up_mps2 if seen.fine_mps2 is None else seen.fine_mps2
        rate_hz = seen.rate_hz if seen.fine_mps2 is None else seen.fine_hz
        self.up_mps2: Floats = np.ascontiguousarray(up.T)
        self._t_s: Floats = seen.start_s + np.arange(len(up)) / rate_hz
        self.load_factor: Floats = np.interp(self._t_s, seen.t_s, seen.load_factor)
        self._weight: Floats = np.interp(self._t_s, seen.t_s, weight)
        self._signs = np.where(np.random.default_rng(len(up)).uniform(size=len(up)) < 0.5, -1.0, 1.0)
        self._channels = {STATIONS[side]: i for i, side in enumerate(seen.sides)}
        self._rigid = np.zeros((len(up), 6))
        for name, column in _RIGID_COLUMNS.items():
            if name in seen.rigid:
                self._rigid[:, column] = np.interp(self._t_s, seen.t_s, seen.rigid[name])

    def sensed(self, effect: Effect, station: Station, force_z: Floats) -> Floats:
        """What an effect adds to a station's vertical specific force."""
        values = self._rigid.copy()
        values[:, 2] = force_z
        return np.asarray(effect.sense(station, self._t_s, values)[:, 2] - force_z)

    def slope(self, effect: Effect, station: Station) -> float:
        """Mean slope of what an effect makes of a station's samples: its linear part, which leaves no change of volume.

        (The same as the regression on the samples in the mean, by Stein, but that one wanders as their power does.)
        """
        channel = self._channels[station]
        force = -GRAVITY_MPS2 * self.load_factor - self.up_mps2[channel]
        bump = _BUMP * float(np.std(force)) * self._signs
        changed = self.sensed(effect, station, force + bump) - self.sensed(effect, station, force)
        return float(np.sum(self._weight * changed * bump) / np.sum(self._weight * bump**2))

    def thinned(self, values: Floats, count: int) -> Floats:
        """The lower part of the spectrum, on the coarse grid."""
        if len(values) == count:
            return values
        spectrum = np.fft.rfft(values)[: count // 2 + 1]
        return np.asarray(np.fft.irfft(spectrum, count) * (count / len(values)))


def _acts_on_samples(effect: Effect) -> bool:
    return type(effect).sense is not Effect.sense or type(effect).sample_time is not Effect.sample_time
