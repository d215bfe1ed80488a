"""Specific force of the rigid aircraft at a tip, from the root's IMU.

``rigid`` are the root's further axes by letter, each with its own stamps: x, y in m/s^2, p, q, r in rad/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from companion.core.wing.lowpass import Butterworth2
from companion.diagnosis.data.grid import half_cosine
from companion.params.airframe import Airframe
from companion.records import Complexes, Floats, Side

_Channels = Mapping[str, tuple[Floats, Floats]]

_HARDLY = 0.02  # power gain of a filter, below which it is not undone (choice)
# of the first mode's frequency: full share up to the first, none from the second on, where recoil begins (choice)
_BENT_WHOLE, _BENT_NOTHING = 0.3, 0.7
# least coherence of roll and tips; least share of the tips' power from which incoherent roll is left in (choice)
_COHERENT, _SLIGHT = 0.5, 0.25
_UPPER_END = 0.7  # of a gyro's band, from which it shows its noise (choice)
# body rates: full share up to the first, none from the second on: manoeuvres are slower, gyro noise is not (choice)
_WHOLE_HZ, _NOTHING_HZ = 6.0, 16.0


def undo_lowpass(values: Floats, rate_hz: float, corner_hz: float) -> Floats:
    """Values (m,) without a sensor's 2nd-order Butterworth, as far as it lets pass anything; a corner of 0 is none."""
    if not corner_hz:
        return values
    passed = Butterworth2(corner_hz).response(np.asarray(np.fft.rfftfreq(len(values), 1.0 / rate_hz)))
    return _filtered(values, passed.conj() * (1.0 + _HARDLY) / (np.abs(passed) ** 2 + _HARDLY))


def roll_share(rigid: _Channels, t_s: Floats, rate_hz: float, airframe: Airframe, tips: Floats) -> Floats:
    """Share of the gyro's roll that is taken out of the tips (m, c), at each frequency of a transform, (m // 2 + 1,).

    A light fuselage rolls against a wing that bends antisymmetrically, and that is part of every such mode. This roll
    is taken out like a manoeuvre's, as far as it stands above the gyro's noise (Wiener's gain, in bands of 1 Hz). Roll
    that is not coherent with the tips and exceeds a quarter of their power is vibration of the gyro's mount. It stays.
    """
    f_hz = np.asarray(np.fft.rfftfreq(len(t_s), 1.0 / rate_hz))
    manoeuvre = half_cosine(f_hz, _WHOLE_HZ, _NOTHING_HZ)
    width = int(len(t_s) / rate_hz)  # bins of 1 Hz
    bands = len(f_hz) // max(width, 1)
    if "p" not in rigid or bands < 1:
        return manoeuvre
    recorded = np.interp(t_s, *rigid["p"])
    places = [(airframe.left, airframe.right)[side].position_m[1] for side in Side]
    arm_m = places[1] - places[0] if tips.shape[1] > 1 else max(places)
    relative = tips[:, -1] - tips[:, 0] if tips.shape[1] > 1 else tips[:, 0]
    first, second = (_in_bands(values, bands, width) for values in (recorded, relative))
    power, power_relative = (np.mean(np.abs(entry) ** 2, axis=1) for entry in (first, second))
    centre_hz = f_hz[: bands * width].reshape(bands, width).mean(1)
    noise = _gyro_noise(rigid["p"], airframe) * 0.5 * rate_hz
    removed = np.clip(1.0 - noise / np.maximum(power, 1e-300), 0.0, 1.0)
    coherence = np.abs(np.mean(first * second.conj(), axis=1)) ** 2 / np.maximum(power * power_relative, 1e-300)
    passed = np.abs(_gyro_response(centre_hz, airframe)) ** 2
    felt = (2.0 * np.pi * centre_hz * arm_m) ** 2 * power / np.maximum(passed, _HARDLY)
    removed[(coherence < _COHERENT) & (felt > _SLIGHT * power_relative)] = 0.0
    return np.asarray(np.maximum(manoeuvre, np.interp(f_hz, centre_hz, removed)))


def _in_bands(values: Floats, bands: int, width: int) -> Complexes:
    """Windowed transform of unit mean square gain, (bands, width)."""
    window = np.hanning(len(values))
    spectrum = np.fft.rfft((values - values.mean()) * window) / np.sqrt(np.sum(window**2))
    return np.asarray(spectrum[: bands * width].reshape(bands, width))


def _gyro_noise(channel: tuple[Floats, Floats], airframe: Airframe) -> float:
    """One-sided density of a gyro's noise: of the data sheet, or of the recording's upper end where that has more."""
    t_s, values = channel
    power = np.abs(_in_bands(values, 1, len(values) // 2 + 1)[0]) ** 2
    upper = power[int(_UPPER_END * len(power)) :]
    floor = float(np.median(upper)) / np.log(2.0) * 2.0 * float(np.median(np.diff(t_s)))
    return float(max(floor, airframe.root.gyro_noise_radps_rthz**2))


def _gyro_response(f_hz: Floats, airframe: Airframe) -> Complexes:
    corner_hz = airframe.root.lowpass_gyro_hz
    return Butterworth2(corner_hz).response(f_hz) if corner_hz else np.ones(len(f_hz), dtype=np.complex128)


def bending_load(load_factor: Floats, rate_hz: float, first_hz: float) -> Floats:
    """Slow part of a load factor, or of any motion of the rigid aircraft, which bends the wing from outside, (m, ...).

    Near the first mode and above, the root shows the recoil of the fuselage from the wing. That is no cause of the
    wing's motion; modes are those of the aircraft as it flies, recoil included.
    """
    return _faded(load_factor, rate_hz, _BENT_WHOLE * first_hz, _BENT_NOTHING * first_hz)


def rotation_forces(
    rigid: _Channels,
    t_s: Floats,
    rate_hz: float,
    airframe: Airframe,
    sides: Sequence[Side],
    rolled: Floats | None = None,
) -> Floats:
    """Specific force that the aircraft's turning adds at tips, (c, 3, m), m/s^2; ``rolled`` by :func:`roll_share`."""
    rates = np.zeros((3, len(t_s)))
    manoeuvre = half_cosine(np.asarray(np.fft.rfftfreq(len(t_s), 1.0 / rate_hz)), _WHOLE_HZ, _NOTHING_HZ)
    for row, letter in enumerate("pqr"):
        if letter in rigid:
            gain = manoeuvre if rolled is None or letter != "p" else rolled
            rates[row] = _filtered(_rate(rigid[letter], t_s, rate_hz, airframe), gain)
    tips = [(airframe.left, airframe.right)[side].position_m for side in sides]
    arms = [np.subtract(tip, airframe.root.position_m) for tip in tips]
    return np.stack([rotation_force(rates, rate_hz, arm) for arm in arms])


def lateral_force(rigid: _Channels, t_s: Floats, rate_hz: float, airframe: Airframe) -> Floats | None:
    """The root's lateral specific force, (m,)."""
    if "y" not in rigid:
        return None
    recorded = undo_lowpass(np.interp(t_s, *rigid["y"]), rate_hz, airframe.root.lowpass_accel_hz)
    return _faded(recorded, rate_hz, _WHOLE_HZ, _NOTHING_HZ)


def roll_rate(rigid: _Channels, t_s: Floats, rate_hz: float, airframe: Airframe) -> Floats:
    """The root's roll rate in manoeuvres, (m,); zeros where it was not recorded."""
    if "p" not in rigid:
        return np.zeros(len(t_s))
    return _faded(_rate(rigid["p"], t_s, rate_hz, airframe), rate_hz, _WHOLE_HZ, _NOTHING_HZ)


def _rate(channel: tuple[Floats, Floats], t_s: Floats, rate_hz: float, airframe: Airframe) -> Floats:
    return undo_lowpass(np.interp(t_s, *channel), rate_hz, airframe.root.lowpass_gyro_hz)


def rotation_force(rates_radps: Floats, rate_hz: float, arm_m: Floats) -> Floats:
    """Add to the root's specific force what is felt at ``arm_m`` (3,) from it, body FRD, (3, m).

    ``domega/dt x r + omega x (omega x r)`` of body rates p, q, r (3, m).
    """
    angular_accel_radps2 = np.gradient(rates_radps, 1.0 / rate_hz, axis=1)
    arm = arm_m[:, None]
    around = np.cross(rates_radps, arm, axis=0)
    return np.asarray(np.cross(angular_accel_radps2, arm, axis=0) + np.cross(rates_radps, around, axis=0))


def _faded(values: Floats, rate_hz: float, whole_hz: float, nothing_hz: float) -> Floats:
    return _filtered(values, half_cosine(np.asarray(np.fft.rfftfreq(len(values), 1.0 / rate_hz)), whole_hz, nothing_hz))


def _filtered(values: Floats, gain: Floats | Complexes) -> Floats:
    # about the line between the ends, which keeps the transform from seeing a step there
    line = np.linspace(values[0], values[-1], len(values))
    weights = gain if values.ndim == 1 else gain[:, None]
    return np.asarray(line + np.fft.irfft(weights * np.fft.rfft(values - line, axis=0), len(values), axis=0))
