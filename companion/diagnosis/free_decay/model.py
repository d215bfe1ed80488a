"""The modes of a decaying structure under some laws: from a parameter vector to the input of the Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.diagnosis.free_decay.kalman import Modes
from companion.diagnosis.free_decay.laws import Extension, Follows, Law, NeighbourMode
from companion.diagnosis.free_decay.record import FreeDecay
from companion.diagnosis.selection.fisher_scoring import Parameter
from companion.params.airframe import Uncertain
from companion.records import Floats

_NUISANCES = 5  # of each recording: impulse to load, steady load, noise, impulse to noise, drift (by definition)
_SLOWEST = 0.2  # of the constant part of the frequency, a bound for the fit
_ZETA = (1e-5, 0.5)  # numerical: keeps a filter stable and a mode oscillating, far outside any wing's damping


class FreeDecayModel:
    """Recordings under a set of extensions; the null has one mode of constant frequency and damping."""

    def __init__(
        self,
        recordings: Sequence[FreeDecay],
        frequency_hz: Uncertain,
        damping: Uncertain,
        extensions: Sequence[Extension] = (),
        wider: float = 1.0,
    ) -> None:
        self.recordings = tuple(recordings)
        self.frequency_hz, self.damping = frequency_hz, damping
        self.extensions = tuple(extensions)
        self._wider = wider
        self.parameters = tuple(self._parameters())
        self.shared = len(self.parameters) - _NUISANCES * len(self.recordings)

    @property
    def centres(self) -> Floats:
        """Prior means, (p,)."""
        return np.array([entry.centre for entry in self.parameters])

    @property
    def sigmas(self) -> Floats:
        """Prior standard deviations, (p,)."""
        return np.array([entry.sigma for entry in self.parameters])

    def index(self, key: str) -> int:
        """Place of a parameter."""
        return [entry.key for entry in self.parameters].index(key)

    def blocks(self) -> list[list[int]]:
        """Places of the parameters of each extension."""
        keys = [[key_of(entry)] if isinstance(entry, Law) else SECOND for entry in self.extensions]
        return [[self.index(key) for key in names] for names in keys]

    def own_indices(self, recording: int) -> list[int]:
        """Places of a recording's nuisances."""
        first = self.shared + _NUISANCES * recording
        return list(range(first, first + _NUISANCES))

    def values_from(self, keys: Sequence[str], values: Floats) -> Floats:
        """A vector (p,) of this model with what another one, of parameters ``keys``, has in common with it."""
        known_values = dict(zip(keys, values.tolist(), strict=True))
        return np.array([known_values.get(entry.key, entry.centre) for entry in self.parameters])

    def modes(self, values: Floats, recording: int) -> Modes:
        """Modes of one recording under each row of ``values`` (b, p)."""
        record = self.recordings[recording]
        columns = {entry.key: values[:, i : i + 1] for i, entry in enumerate(self.parameters)}
        swing, log_zeta = self.swing(columns, record), columns["log damping"] + np.zeros_like(record.t_s)
        log_zeta = self._with_laws(Follows.DAMPING, log_zeta, columns, record)
        damping = self._with_laws(Follows.ADDED_DAMPING, np.exp(log_zeta), columns, record)
        first = 2.0 * np.pi * np.exp(columns["log frequency"]) * np.maximum(swing, _SLOWEST)
        loudness = np.exp(2.0 * columns[f"impulse to load #{recording}"]) * record.impulse_mps2**2
        loudness = loudness + np.exp(2.0 * columns[f"load #{recording}"])
        omega, zeta, load = [first], [damping], [loudness]
        if any(isinstance(entry, NeighbourMode) for entry in self.extensions):
            follow = 1.0 + columns["second follow"] * (swing - 1.0)
            omega.append(2.0 * np.pi * np.exp(columns["second log frequency"]) * np.maximum(follow, _SLOWEST))
            zeta.append(np.exp(columns["second log damping"]) + np.zeros_like(log_zeta))
            load.append(loudness * np.exp(columns["second log participation"]))
        noise = np.exp(2.0 * columns[f"noise #{recording}"])
        noise = noise + np.exp(2.0 * columns[f"impulse to noise #{recording}"]) * record.leakage_mps2**2
        highest = math.pi * record.rate_hz  # beyond it a mode looks like one below
        drift = np.exp(2.0 * columns[f"drift #{recording}"][:, 0])
        start = np.full(len(values), float(np.max(record.up_mps2**2)))
        return Modes(
            np.minimum(np.stack(omega, 2), highest),
            np.clip(np.stack(zeta, 2), *_ZETA),
            np.stack(load, 2),
            noise,
            start,
            drift,
        )

    def swing(self, columns: dict[str, Floats], record: FreeDecay) -> Floats:
        """The first mode's frequency over its constant part, (b, t)."""
        constant = np.ones((len(columns["log frequency"]), len(record.t_s)))
        return self._with_laws(Follows.FREQUENCY, constant, columns, record)

    def _with_laws(self, follows: Follows, value: Floats, columns: dict[str, Floats], record: FreeDecay) -> Floats:
        """A quantity (b, t) and what the laws that move it add."""
        for law in self.extensions:
            if isinstance(law, Law) and law.follows is follows:
                value = value + columns[key_of(law)] * law.basis(record)
        return value

    def _parameters(self) -> list[Parameter]:
        relative = self.frequency_hz.sigma / self.frequency_hz.value
        parameters = [
            Parameter("log frequency", math.log(self.frequency_hz.value), relative),
            Parameter("log damping", math.log(self.damping.value), self.damping.sigma / self.damping.value),
        ]
        for entry in self.extensions:
            if isinstance(entry, Law):
                parameters.append(Parameter(key_of(entry), 0.0, self._wider * entry.sigma))
            else:
                parameters += _of_second(parameters[0], parameters[1])
        for k, record in enumerate(self.recordings):
            quiet = math.log(float(np.percentile(np.abs(record.up_mps2), 5)) + 1e-9)
            parameters += [
                Parameter(f"impulse to load #{k}", -1.0, 3.0),
                Parameter(f"noise #{k}", quiet, 3.0),
                Parameter(f"impulse to noise #{k}", -1.0, 2.0),
                Parameter(f"load #{k}", quiet, 3.0),
                Parameter(f"drift #{k}", quiet, 3.0),
            ]
        return parameters


def key_of(law: Law) -> str:
    """Name of a law's parameter in the vector."""
    return f"{law.key}: {law.parameter}"


SECOND = ["second log frequency", "second log damping", "second log participation", "second follow"]


def _of_second(frequency: Parameter, damping: Parameter) -> list[Parameter]:
    return [
        Parameter("second log frequency", frequency.centre, math.hypot(frequency.sigma, 0.1)),
        Parameter("second log damping", damping.centre, damping.sigma),
        Parameter("second log participation", 0.0, 3.0),
        Parameter("second follow", 0.5, 0.5),
    ]
