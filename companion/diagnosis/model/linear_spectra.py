"""The linear part of the model in the frequency domain: receptance, load, sensing, noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.core.wing.lowpass import Butterworth2
from companion.core.wing.structure import Structure, slot_name, structure_of
from companion.diagnosis.model.generic_sensing import GenericLeak
from companion.diagnosis.recent_results import RecentResults
from companion.diagnosis.spectral_matrices import adjoint, full, inverse, product
from companion.params.airframe import Airframe
from companion.records import Complexes, Floats, Side, Station

ADDED = "added"
"""Stands for a mode that an effect has appended, in the names of nuisances."""
_CACHED = 4  # receptances kept: of a model, its two passes over forces, a neighbour by a difference step (choice)
_TOGETHER = 5.0  # tanh sinh of it is 1 to the last digit (numerical)
STATIONS = {Side.LEFT: Station.LEFT, Side.RIGHT: Station.RIGHT}


@dataclass(frozen=True, slots=True)
class Linear:
    """Everything that follows from the linear model at f frequencies.

    Attributes
    ----------
    receptance : (n, n, f), or (n, f) where no mode is coupled
        Modal deflection per load, s^2.
    load : (n, n, f) or (n, f)
        Two-sided load density, (m/s^2)^2/Hz.
    sensing : (c, n, f)
        Accelerometer channel per modal deflection, 1/s^2.
    noise : (c, c, f)
        Two-sided density, (m/s^2)^2/Hz; the noise of a root sensor is the same on both sides.
    """

    receptance: Complexes
    load: Complexes
    sensing: Complexes
    noise: Floats


class Spectra:
    """Writes a wing with effects as spectra on one frequency axis, in the units of a belief."""

    def __init__(self, airframe: Airframe, sides: Sequence[Side], f_hz: Floats, has_root: bool = False) -> None:
        self.airframe, self.sides, self.f_hz = airframe, tuple(sides), f_hz
        self._omega: Floats = 2.0 * np.pi * f_hz
        self._filters = [_butterworth(f_hz, airframe.sensor(STATIONS[side]).lowpass_accel_hz) for side in self.sides]
        self._root_noise = 0.5 * airframe.root.accel_noise_mps2_rthz**2 if has_root else 0.0
        self._receptances: RecentResults[bytes, Complexes] = RecentResults(_CACHED)
        self._filtered: list[tuple[Complexes, Complexes, Complexes]] = []
        self._responses: tuple[object, Complexes] | None = None
        self._level = self._reference_levels()

    def linear(
        self,
        structure: Structure,
        scale: Floats,
        effects: Sequence[Effect],
        deviation: Mapping[str, float],
        filtered: Complexes | None = None,
    ) -> Linear:
        """Spectra of a structure under effects and nuisances; ``scale`` (c,) is on the accelerometers beside them.

        ``filtered`` (n, n, >= f) are further forces per deflection, (rad/s)^2, of laws with memory.
        """
        inertia = -(self._omega**2) * structure.lift[list(self.sides)][..., None]
        gains = scale[:, None] * self.responses(effects, deviation)
        noise = self._root_noise + np.zeros((len(self.sides), len(self.sides), len(self.f_hz)))
        for i, side in enumerate(self.sides):
            noise[i, i] += self._noise(i, side, deviation)
        load = self._load(structure, effects, deviation)
        sensing: Complexes = gains[:, None] * inertia
        for effect in effects:
            if isinstance(effect, GenericLeak):
                sensing = self._leaked(effect, sensing)
        receptances = self._receptance(structure)
        if filtered is not None:
            receptances = self._with_memory(receptances, filtered)
        return Linear(receptances, load, sensing, noise)

    def _leaked(self, leak: GenericLeak, sensing: Complexes) -> Complexes:
        """Sensing (c, n, f) of channels of which one shows a share of the other."""
        leaked = sensing.copy()
        for i, side in enumerate(self.sides):
            if STATIONS[side] is leak.station:
                leaked[i] += leak.leaked_ratio * (np.sum(sensing, axis=0) - sensing[i])
        return leaked

    def responses(self, effects: Sequence[Effect], deviation: Mapping[str, float]) -> Complexes:
        """Complex gain of the accelerometers, (c, f); the last is kept."""
        names = [f"{side.name.lower()}.{what}" for side in self.sides for what in ("delay_s", "scale")]
        key = tuple(effects), tuple(deviation.get(name, 0.0) for name in names)
        if self._responses is None or self._responses[0] != key:
            gains = np.stack([self._response(i, effects, deviation) for i in range(len(self.sides))])
            self._responses = key, gains
        return self._responses[1]

    def delay_s(self, effects: Sequence[Effect], deviation: Mapping[str, float], at_hz: float, t_s: Floats) -> float:
        """Accelerometers' phase delay at one frequency beyond their believed filters, mean of all and of t_s (m,)."""
        omega, delays = 2.0 * np.pi * at_hz, []
        for side in self.sides:
            station, phase, late_s = STATIONS[side], 0.0, deviation.get(f"{side.name.lower()}.delay_s", 0.0)
            for effect in effects:
                response = effect.response(station, np.array([at_hz]))
                if response is not None:
                    phase += float(np.angle(response[0]))
                elif type(effect).sample_time is not Effect.sample_time:
                    late_s += float(np.mean(t_s - effect.sample_time(station, t_s)))
            delays.append(late_s - phase / omega)
        return float(np.mean(delays))

    def _with_memory(self, receptances: Complexes, filtered: Complexes) -> Complexes:
        """Receptance under further forces per deflection; the last few are kept, as those of structures are."""
        for plain, filters, coupled in self._filtered:
            if plain is receptances and filters is filtered:
                return coupled
        result = inverse(full(inverse(receptances)) - filtered[..., : len(self.f_hz)])
        self._filtered = [*self._filtered[1 - _CACHED :], (receptances, filtered, result)]
        return result

    def _receptance(self, structure: Structure) -> Complexes:
        """The receptance; the last few are kept, for most parameters do not change the structure."""
        key = structure.stiffness_radps2.tobytes() + structure.damping_radps.tobytes()
        return self._receptances.get(key, lambda: receptance(structure, self._omega))

    def _load(self, structure: Structure, effects: Sequence[Effect], deviation: Mapping[str, float]) -> Complexes:
        believed, level = len(self._level), np.empty(structure.count)
        for i, slot in enumerate(structure.slots):
            # a mode that an effect has added is loaded like the first of its symmetry
            k, name = (i, slot_name(slot)) if i < believed else (slot % 2 if believed > 1 else 0, slot_name(slot % 2))
            level[i] = self._level[k] * np.exp(2.0 * deviation.get(f"{name}.level", 0.0))
        load = (level[:, None] * self._load_shape(deviation)).astype(np.complex128)
        load = self._coherent(load, structure, deviation)
        for effect in effects:
            gain = effect.load_gain(self.f_hz, structure.count)
            if gain is not None:
                matrix = np.moveaxis(np.broadcast_to(gain, (len(self.f_hz), *gain.shape[1:])), 0, -1)
                load = product(product(matrix, full(load)), adjoint(matrix))
        return load

    def _coherent(self, load: Complexes, structure: Structure, deviation: Mapping[str, float]) -> Complexes:
        """Add the gust that modes of one symmetry share: rho_j rho_k between modes j and k, with rho 1 of the first.

        This is one gust for all of them, seen by each to its share: no three coherences contradict each other.
        """
        families = self._families(structure)
        coherences = [
            1.0 if i == first else self._coherence(i, structure, deviation) for i, first in enumerate(families)
        ]
        pairs = [
            (j, k, coherences[j] * coherences[k])
            for k in range(1, structure.count)
            for j in range(k)
            if families[j] == families[k] and coherences[j] * coherences[k]
        ]
        if not pairs:
            return load
        coherent, density = full(load).copy(), [load[i, i] if load.ndim == 3 else load[i] for i in range(len(load))]
        for j, k, shared in pairs:
            both = shared * np.sqrt(density[j] * density[k])
            coherent[j, k] += both
            coherent[k, j] += both
        return coherent

    def _families(self, structure: Structure) -> list[int]:
        """Index of the first mode of each mode's symmetry; a wing of one symmetry has one family."""
        both = len(self._level) > 1
        return [slot % 2 if both else 0 for slot in structure.slots]

    def _coherence(self, i: int, structure: Structure, deviation: Mapping[str, float]) -> float:
        """Coherence of a mode's gust with that of the first mode of its symmetry."""
        name = slot_name(structure.slots[i]) if i < len(self._level) else ADDED
        # full coherence is possible: it lies a few prior sigmas away, and not at infinity
        return float(np.tanh(np.sinh(np.clip(deviation.get(f"{name}.coherence", 0.0), -_TOGETHER, _TOGETHER))))

    def _response(self, channel: int, effects: Sequence[Effect], deviation: Mapping[str, float]) -> Complexes:
        side = self.sides[channel]
        name = side.name.lower()
        late = np.exp(-1j * self._omega * deviation.get(f"{name}.delay_s", 0.0))
        gain = (1.0 + deviation.get(f"{name}.scale", 0.0)) * late * self._filters[channel]
        for effect in effects:
            response = effect.response(STATIONS[side], self.f_hz)
            gain = gain if response is None else gain * response
        return np.asarray(gain)

    def _noise(self, channel: int, side: Side, deviation: Mapping[str, float]) -> Floats:
        """Noise behind a sensor's low-pass, and ahead of it where that is separate, (f,) or ()."""
        believed = 0.5 * self.airframe.sensor(STATIONS[side]).accel_noise_mps2_rthz ** 2
        name = side.name.lower()
        density = np.asarray(believed * np.exp(2.0 * deviation.get(f"{name}.noise", 0.0)))
        ahead = deviation.get(f"{name}.noise_ahead")
        if ahead is not None:
            density = density + believed * np.exp(2.0 * ahead) * np.abs(self._filters[channel]) ** 2
        return density

    def _load_shape(self, deviation: Mapping[str, float]) -> Floats:
        shape = np.ones_like(self.f_hz)
        for i, corner in enumerate(self.airframe.wing.gust.corners_hz):
            if corner:
                shape /= 1.0 + (self.f_hz / (corner * np.exp(deviation.get(f"corner{i}", 0.0)))) ** 2
        return shape

    def _reference_levels(self) -> Floats:
        """Load density that gives each believed mode the believed rms deflection, (n,)."""
        structure = structure_of(self.airframe.wing)
        gain = np.abs(receptance(structure, self._omega)) ** 2
        power = 2.0 * self.f_hz[1] * np.sum(gain * self._load_shape({}), axis=-1)
        level = self.airframe.wing.gust.deflection_rms_m.value**2 / power
        first = np.array([0 if slot % 2 == 0 else min(1, len(level) - 1) for slot in structure.slots])
        return np.asarray(level[first])  # second modes are thought to be loaded as densely as the first


def spectrum_of(linear: Linear, low: int) -> Complexes:
    """Two-sided density of what is seen from frequency ``low`` on, (c, c, b)."""
    band = Linear(
        linear.receptance[..., low:], linear.load[..., low:], linear.sensing[..., low:], linear.noise[..., low:]
    )
    per_load = product(band.sensing, band.receptance)
    return np.asarray(product(product(per_load, band.load), adjoint(per_load)) + band.noise)


def receptance(structure: Structure, omega: Floats) -> Complexes:
    """Modal deflection per load, (n, n, f); (n, f) where stiffness and damping couple nothing."""
    stiffness, damping = structure.stiffness_radps2, structure.damping_radps
    dynamic: Complexes = stiffness[..., None] + 1j * omega * damping[..., None]
    diagonal = np.diag_indices(structure.count)
    coupled = np.count_nonzero(stiffness - np.diag(np.diag(stiffness))) or np.count_nonzero(
        damping - np.diag(np.diag(damping))
    )
    if not coupled:
        return np.asarray(1.0 / (dynamic[diagonal] - omega**2))
    dynamic[diagonal] -= omega**2
    return inverse(dynamic)


def _butterworth(f_hz: Floats, corner_hz: float) -> Complexes:
    if not corner_hz:
        return np.ones(len(f_hz), dtype=np.complex128)
    return Butterworth2(corner_hz).response(f_hz)
