"""Takes out of the accelerations what no linear, steady model makes: crooked sensors, and forces of state or time."""

from __future__ import annotations

from collections.abc import Sequence
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
_RIGID_COLUMNS = {"x": 0, "y": 1, "p": 3, "q": 4, "r": 5}


class Straightener:
    """One recording's samples and what effects have done to them."""

    def __init__(self, seen: Observations, transforms: Transforms) -> None:
        self._seen, self._transforms = seen, transforms
        self._up: Floats = np.ascontiguousarray(seen.up_mps2.T)
        self._rigid = np.zeros((len(seen.up_mps2), 6))
        for name, column in _RIGID_COLUMNS.items():
            if name in seen.rigid:
                self._rigid[:, column] = seen.rigid[name]
        self._kinds: dict[tuple[type[Effect], str], str] = {}

    @property
    def recorded_mps2(self) -> Floats:
        """The accelerations as recorded, (c, m)."""
        return self._up

    def straight_mps2(self, effects: Sequence[Effect]) -> Floats:
        """Undo, to first order, what effects do to samples that no linear response describes: (c, m)."""
        up = self._up
        for effect in effects:
            if type(effect).response is not Effect.response or not _acts_on_samples(effect):
                continue
            change = np.stack([self._change(effect, side, up[i]) for i, side in enumerate(self._seen.sides)])
            if type(effect).sample_time is Effect.sample_time:
                # its linear part is a scale, which is free
                change -= np.linalg.lstsq(up.T, change.T, rcond=None)[0].T @ up
            up = up - change
        return up

    def push_mps2(self, wing: WingModel, parts: Sequence[Part], q_m: Floats, qdot_mps: Floats) -> Floats | None:
        """Modal forces (n, m) that depend on state or time, without what is linear in the state; None for none."""
        total: Floats | None = None
        for part in parts:
            if type(part.effect).force is Effect.force:
                continue
            force = self._force(wing, part, q_m, qdot_mps)
            if force is None or not np.any(force):
                continue
            kind = self._kind(wing, part, force, q_m, qdot_mps)
            force = _without_linear(force, q_m, qdot_mps) if kind == "law" else force
            total = force if total is None else total + force
        return total

    def _kind(self, wing: WingModel, part: Part, force: Floats, q: Floats, qdot: Floats) -> str:
        """Whether a force ignores the state ("alone"), swings a linear one in time, or is a law of the state."""
        key = (type(part.effect), part.channel)
        if key not in self._kinds:
            other = self._force(wing, part, q[:, ::-1], qdot[:, ::-1])
            both = self._force(wing, part, q + q[:, ::-1], qdot + qdot[:, ::-1])
            assert other is not None
            assert both is not None
            small = 1e-9 * float(np.abs(both).max())
            # what is linear and only swings in time about the middle of the recording has no steady part to take out
            swings = np.allclose(both, force + other, rtol=1e-7, atol=small)
            alone = np.allclose(both, force, rtol=1e-9, atol=small)
            self._kinds[key] = "alone" if alone else "swings" if swings else "law"
        return self._kinds[key]

    def _force(self, wing: WingModel, part: Part, q: Floats, qdot: Floats) -> Floats | None:
        t_s: Any = self._seen.t_s - self._seen.centre_s
        static = np.zeros((wing.count, 1))
        channel = self._seen.covariates.get(part.channel)
        follows = np.zeros(len(self._seen.up_mps2)) if channel is None else channel
        return part.effect.force(ModalMotion(t_s, q, qdot, static, 1.0, wing.structure, follows))

    def _change(self, effect: Effect, side: Side, up: Floats) -> Floats:
        """What an effect has added to what a station shows of ``up``."""
        station, t_s = STATIONS[side], self._seen.t_s
        shown = up
        if type(effect).sample_time is not Effect.sample_time:
            # what is shown at t is taken back to where it belongs: up - (shown - up) is up at the mirrored instant
            mirrored = 2.0 * t_s - effect.sample_time(station, t_s)
            shown = 2.0 * up - self._transforms.at(np.fft.rfft(up), mirrored)
        added = self._sensed(effect, station, -GRAVITY_MPS2 - shown)
        if self._seen.has_root:
            heave = -GRAVITY_MPS2 * self._seen.load_factor
            added = added - self._sensed(effect, Station.ROOT, heave)
        return np.asarray(shown - added - up)

    def _sensed(self, effect: Effect, station: Station, force_z: Floats) -> Floats:
        """What an effect adds to a station's vertical specific force."""
        values = self._rigid.copy()
        values[:, 2] = force_z
        return np.asarray(effect.sense(station, self._seen.t_s, values)[:, 2] - force_z)


def _acts_on_samples(effect: Effect) -> bool:
    return type(effect).sense is not Effect.sense or type(effect).sample_time is not Effect.sample_time


def _without_linear(force: Floats, q: Floats, qdot: Floats) -> Floats:
    """A force without what is linear in the state: that is stiffness or damping, which are free."""
    basis = np.vstack([q, qdot])
    gram = basis @ basis.T
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    weights = np.linalg.lstsq(gram / np.outer(scale, scale), (basis / scale[:, None]) @ force.T, rcond=1e-9)[0]
    return np.asarray(force - (weights / scale[:, None]).T @ basis)
