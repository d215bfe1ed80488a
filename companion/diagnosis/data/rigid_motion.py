"""Specific force of the rigid aircraft at a tip, from the root's IMU, and the reading of a tip that is turned.

``rigid`` are the root's further axes by letter, each with its own stamps: x, y in m/s^2, p, q, r in rad/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from companion.core.wing.lowpass import Butterworth2, Complexes
from companion.params.airframe import Airframe
from companion.records import Floats, Side

_Channels = Mapping[str, tuple[Floats, Floats]]

_HARDLY = 0.02  # power share that a filter lets through, below which it is not undone
_LEAST_FORCE_MPS2 = 3.0  # near weightlessness a lateral force tells no turn
_BENT_WHOLE, _BENT_NOTHING = 0.3, 0.7  # of the first mode: above, the fuselage recoils from the wing that bends
_COHERENT = 0.5  # with more than half of the power in common, taking the roll out leaves less
_WHOLE_HZ, _NOTHING_HZ = 6.0, 16.0  # manoeuvres are slower, and the noise of a gyro's derivative grows with frequency


def undo_lowpass(values: Floats, rate_hz: float, corner_hz: float) -> Floats:
    """Undo a sensor's low-pass (2nd-order Butterworth) where something came through it; a corner of 0 is none."""
    if not corner_hz:
        return values
    passed = Butterworth2(corner_hz).response(np.asarray(np.fft.rfftfreq(len(values), 1.0 / rate_hz)))
    return _filtered(values, passed.conj() * (1.0 + _HARDLY) / (np.abs(passed) ** 2 + _HARDLY))


def manoeuvre_band(values: Floats, rate_hz: float, top_hz: float = _NOTHING_HZ) -> Floats:
    """Keep of a rate what manoeuvres can be, or more: it fades out up to ``top_hz``."""
    return _faded(values, rate_hz, _WHOLE_HZ / _NOTHING_HZ * top_hz, top_hz)


def rolled_together_hz(rigid: _Channels, t_s: Floats, rate_hz: float, airframe: Airframe, tips: Floats) -> float:
    """The frequency up to which the tips (m, c) show the roll that the gyro shows, Hz.

    A fuselage that is not heavy rolls against a wing that bends antisymmetrically, and that is part of the mode: it is
    taken out like a manoeuvre's, as far as it stands above the gyro's noise. By coherence in bands of 1 Hz.
    """
    if "p" not in rigid:
        return _NOTHING_HZ
    rate = undo_lowpass(np.interp(t_s, *rigid["p"]), rate_hz, airframe.root.lowpass_gyro_hz)
    shown = tips[:, -1] - tips[:, 0] if tips.shape[1] > 1 else tips[:, 0]
    width = int(len(t_s) / rate_hz)  # bins of 1 Hz
    spectra = [np.fft.rfft(values * np.hanning(len(values))) for values in (rate - rate.mean(), shown - shown.mean())]
    bands = min(len(spectra[0]) // max(width, 1), int(0.25 * rate_hz))
    first, second = (entry[: bands * width].reshape(bands, width) for entry in spectra)
    shared = np.abs(np.sum(first * second.conj(), axis=1)) ** 2
    coherence = shared / np.maximum(np.sum(np.abs(first) ** 2, axis=1) * np.sum(np.abs(second) ** 2, axis=1), 1e-300)
    apart = np.flatnonzero(coherence < _COHERENT)
    return max(_NOTHING_HZ, float(apart[apart >= int(_NOTHING_HZ)][0] if np.any(apart >= int(_NOTHING_HZ)) else bands))


def bending_load(load_factor: Floats, rate_hz: float, first_hz: float) -> Floats:
    """Keep of a load factor, or of any motion of the rigid aircraft, what bends the wing from outside, (m, ...).

    Near the wing's first mode and above, the root shows how the fuselage recoils: that is the wing's doing, and its
    frequencies are those of the aircraft as it flies, recoil included.
    """
    return _faded(load_factor, rate_hz, _BENT_WHOLE * first_hz, _BENT_NOTHING * first_hz)


def rotation_forces(
    rigid: _Channels,
    t_s: Floats,
    rate_hz: float,
    airframe: Airframe,
    sides: Sequence[Side],
    top_hz: float = _NOTHING_HZ,
) -> Floats:
    """Specific force that the aircraft's turning adds at tips, (c, 3, m), m/s^2, up to ``top_hz``."""
    rates = np.zeros((3, len(t_s)))
    for row, letter in enumerate("pqr"):
        if letter in rigid:
            recorded = np.interp(t_s, *rigid[letter])
            rates[row] = manoeuvre_band(undo_lowpass(recorded, rate_hz, airframe.root.lowpass_gyro_hz), rate_hz, top_hz)
    tips = [(airframe.left, airframe.right)[side].position_m for side in sides]
    arms = [np.subtract(tip, airframe.root.position_m) for tip in tips]
    return np.stack([rotation_force(rates, rate_hz, arm) for arm in arms])


def lateral_force(rigid: _Channels, t_s: Floats, rate_hz: float, airframe: Airframe) -> Floats | None:
    """The root's lateral specific force, (m,)."""
    if "y" not in rigid:
        return None
    return manoeuvre_band(undo_lowpass(np.interp(t_s, *rigid["y"]), rate_hz, airframe.root.lowpass_accel_hz), rate_hz)


def rotation_force(rates_radps: Floats, rate_hz: float, arm_m: Floats) -> Floats:
    """Add to the root's specific force what is felt at ``arm_m`` (3,) from it, body FRD, (3, m).

    ``domega/dt x r + omega x (omega x r)`` of body rates p, q, r (3, m).
    """
    turn = np.gradient(rates_radps, 1.0 / rate_hz, axis=1)
    arm = arm_m[:, None]
    around = np.cross(rates_radps, arm, axis=0)
    return np.asarray(np.cross(turn, arm, axis=0) + np.cross(rates_radps, around, axis=0))


def tip_axes_corrected(force_y: Floats, force_z: Floats, rigid_y: Floats) -> Floats:
    """Vertical specific force, in the aircraft's axes, of a tip that the wing has turned about x, (m,).

    Bending makes no lateral force: what the tip reads of ``y`` beside the rigid aircraft's tells its turn,
    ``tan A = (y - y_rigid) / z``; in between where it is weightless.
    """
    tells = np.abs(force_z) > _LEAST_FORCE_MPS2
    if not tells.any():
        return force_z
    at = np.arange(len(force_z))
    turn = np.interp(at, at[tells], np.arctan((force_y - rigid_y)[tells] / force_z[tells]))
    return np.asarray((force_z + np.sin(turn) * rigid_y) / np.cos(turn))


def _faded(values: Floats, rate_hz: float, whole_hz: float, nothing_hz: float) -> Floats:
    f_hz = np.fft.rfftfreq(len(values), 1.0 / rate_hz)
    fade = np.clip((nothing_hz - f_hz) / (nothing_hz - whole_hz), 0.0, 1.0)
    return _filtered(values, 0.5 - 0.5 * np.cos(np.pi * fade))


def _filtered(values: Floats, gain: Floats | Complexes) -> Floats:
    # about the line between the ends, which keeps the transform from seeing a step there
    line = np.linspace(values[0], values[-1], len(values))
    weights = gain if values.ndim == 1 else gain[:, None]
    return np.asarray(line + np.fft.irfft(weights * np.fft.rfft(values - line, axis=0), len(values), axis=0))
