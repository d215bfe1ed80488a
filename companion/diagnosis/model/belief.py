"""Nuisance parameters: deviations of the airframe from its file within the file's sigmas.

Each is a deviation from the belief with prior mean 0 and the prior sigma of the airframe file. Positive quantities
deviate in their logarithm. Named effects are judged with all nuisances free.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from companion.core.wing.effects import make_effect
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.linear_spectra import ADDED
from companion.params.airframe import FAMILIES, Airframe, Mode, Sensor, Uncertain, Wing
from companion.records import Floats, Side

_INPUT_MPS2 = 10.0  # prior sigma of the modal load by a measured input at its rms (choice)
_UNKNOWN_LEVEL = 1.5  # prior sigma of a load's logarithm, of which no airframe file knows (choice)
_UNKNOWN_NOISE = 3.0  # of the logarithm of a sensor's noise, which depends on its mounting (choice)
_LOW_CORNER = 0.125  # of a sensor's rate: below it a low-pass shapes the noise ahead of it (choice)
_CORNER_SIGMA = 1.0  # of the logarithm of a gust's corner, which differs from day to day (choice)
_COHERENCE = 1.2  # prior sigma of x in coherence = tanh(sinh x), which covers -1 to 1 (choice)
_MATCH_SIGMA_PX = 0.3  # chosen: noise of one match in hard texture; the median of a pair has less
_RECORDING_MARK = "#"
_GAIN = "gain:"
_CHANGING = (".level", ".noise", ".noise_ahead", ".bias_mps2", "match")
_RANGE_ONLY = frozenset({"toe_rad", "focal", "match", "trim_bend_m", "bend_per_g_m"})


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One deviation: its key, prior sigma, and whether it is a logarithm."""

    key: str
    sigma: float
    logarithmic: bool = False

    @property
    def name(self) -> str:
        """The key without the number of its recording."""
        return self.key.partition(_RECORDING_MARK)[0]

    def concerns(self, recording: int) -> bool:
        """Whether it belongs to a recording, or to all."""
        _, _, owner = self.key.partition(_RECORDING_MARK)
        return not owner or int(owner) == recording


@dataclass(frozen=True, slots=True)
class Belief:
    """The airframe and the deviations from it that are free, in the order of every parameter vector."""

    airframe: Airframe
    nuisances: tuple[Nuisance, ...]
    terms: tuple[EffectTerm, ...] = ()
    """Effects that are in force in the airframe file already."""

    @property
    def sigmas(self) -> Floats:
        """Prior sigmas, (p,)."""
        return np.array([entry.sigma for entry in self.nuisances])

    def named(self, deviations: Sequence[float] | Floats, recording: int = 0) -> dict[str, float]:
        """Deviations (p,) by key as one recording has them: its own, and those that all share."""
        each = zip(self.nuisances, deviations, strict=True)
        return {entry.name: float(value) for entry, value in each if entry.concerns(recording)}

    def wing(self, deviation: dict[str, float]) -> Wing:
        """The airframe's wing with these deviations."""
        wing = self.airframe.wing.with_modes(lambda name, mode: _moved(mode, name, deviation))
        trim = Uncertain(wing.trim_bend_m.value + deviation.get("trim_bend_m", 0.0), wing.trim_bend_m.sigma)
        per_g = Uncertain(wing.bend_per_g_m.value + deviation.get("bend_per_g_m", 0.0), wing.bend_per_g_m.sigma)
        return dataclasses.replace(wing, trim_bend_m=trim, bend_per_g_m=per_g)

    def match_sigma_rad(self) -> float:
        """Believed noise of one measured toe."""
        camera = self.airframe.left_camera
        return _MATCH_SIGMA_PX / camera.focal_px.value if camera else 0.0


def believe(
    airframe: Airframe,
    sides: Sequence[Side],
    with_range: bool,
    load_varies: bool,
    recordings: int = 1,
    inputs: Mapping[str, float] = MappingProxyType({}),
    has_root: bool = False,
) -> Belief:
    """List the nuisances of an airframe that these recordings inform about.

    What differs from flight to flight (gust, noise, bias, matching) is a nuisance of each recording. ``inputs`` are the
    measured ones with their rms: the modal load per unit of each is free.
    """
    modes = airframe.wing.modes
    nuisances = [entry for name, mode in modes.items() for entry in _of_mode(mode, name, with_range)]
    above_first = [name for name in modes if name not in FAMILIES]
    nuisances += [Nuisance(f"{name}.coherence", _COHERENCE) for name in (*above_first, ADDED)]
    nuisances += [Nuisance(f"corner{i}", _CORNER_SIGMA, True) for i, c in enumerate(airframe.wing.gust.corners_hz) if c]
    for side in sides:
        nuisances += _of_tip((airframe.left, airframe.right)[side], side.name.lower())
    if has_root:
        root = airframe.root
        nuisances.append(Nuisance("root.scale", root.accel_scale_sigma))
        nuisances.append(Nuisance("root.rate_scale", root.gyro_scale_sigma))
        nuisances.append(Nuisance("root.bias_mps2", root.accel_bias_sigma_mps2))
    if with_range:
        nuisances += _of_cameras(airframe, load_varies)
    nuisances += [Nuisance(f"{_GAIN}{name}", _INPUT_MPS2 / rms) for name, rms in inputs.items() if rms > 0.0]
    uncertain = [entry for entry in nuisances if entry.sigma > 0.0]
    if recordings > 1:
        uncertain = [entry_of for entry in uncertain for entry_of in _for_each(entry, recordings)]
    listed = [EffectTerm(make_effect(entry), entry.channel) for entry in airframe.effects]
    # a kick or a tone's phase in the file is that of another recording
    in_force = tuple(term for term in listed if not term.effect.belongs_to_recording())
    return Belief(airframe, tuple(uncertain), in_force)


def is_range_only(key: str, load_moves: bool = False) -> bool:
    """Whether a nuisance concerns the ranges or the sensors at rest alone, and not the motion of the wing."""
    if key == "bend_per_g_m" and load_moves:
        return False
    return key in _RANGE_ONLY or key.endswith((".slope", ".bias_mps2"))


def input_gains(deviation: Mapping[str, float]) -> dict[str, float]:
    """Modal acceleration per unit of each measured input."""
    return {key.removeprefix(_GAIN): value for key, value in deviation.items() if key.startswith(_GAIN)}


def _for_each(entry: Nuisance, recordings: int) -> list[Nuisance]:
    if not (entry.key.startswith("corner") or entry.key.endswith(_CHANGING)):
        return [entry]
    return [dataclasses.replace(entry, key=f"{entry.key}{_RECORDING_MARK}{k}") for k in range(recordings)]


def _of_mode(mode: Mode, name: str, with_range: bool) -> list[Nuisance]:
    nuisances = [
        Nuisance(f"{name}.frequency", mode.frequency_hz.sigma / mode.frequency_hz.value, True),
        Nuisance(f"{name}.damping", mode.damping.sigma / max(mode.damping.value, 1e-6), True),
        Nuisance(f"{name}.level", _UNKNOWN_LEVEL, True),
    ]
    if with_range and "antisymmetric" not in name:
        slope = mode.slope_factor_radpm
        nuisances.append(Nuisance(f"{name}.slope", slope.sigma / max(slope.value, 1e-6), True))
    return nuisances


def _of_tip(sensor: Sensor, name: str) -> list[Nuisance]:
    nuisances = [Nuisance(f"{name}.noise", _UNKNOWN_NOISE, True)]
    if 0.0 < sensor.lowpass_accel_hz < _LOW_CORNER * sensor.rate_hz:
        nuisances.append(Nuisance(f"{name}.noise_ahead", _UNKNOWN_NOISE, True))
    return [
        *nuisances,
        Nuisance(f"{name}.scale", sensor.accel_scale_sigma),
        Nuisance(f"{name}.delay_s", sensor.time_offset_sigma_s),
        Nuisance(f"{name}.bias_mps2", math.hypot(sensor.accel_bias_sigma_mps2, 1e-4)),
    ]


def _of_cameras(airframe: Airframe, load_varies: bool) -> list[Nuisance]:
    camera = airframe.left_camera
    assert camera is not None
    wing = airframe.wing
    nuisances = [
        Nuisance("toe_rad", math.sqrt(2.0) * camera.rotation_sigma_rad),
        Nuisance("focal", camera.focal_px.sigma / camera.focal_px.value / math.sqrt(2.0)),
        Nuisance("match", 0.7, True),
        Nuisance("trim_bend_m", wing.trim_bend_m.sigma),
    ]
    return nuisances + ([Nuisance("bend_per_g_m", wing.bend_per_g_m.sigma)] if load_varies else [])


def _moved(mode: Mode, name: str, deviation: dict[str, float]) -> Mode:
    def scaled(value: Uncertain, key: str) -> Uncertain:
        return Uncertain(value.value * math.exp(deviation.get(f"{name}.{key}", 0.0)), value.sigma)

    return dataclasses.replace(
        mode,
        frequency_hz=scaled(mode.frequency_hz, "frequency"),
        damping=scaled(mode.damping, "damping"),
        slope_factor_radpm=scaled(mode.slope_factor_radpm, "slope"),
    )
