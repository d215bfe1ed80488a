"""What an engineer looks at: frequency against channel, backbone, and the restoring force, told by short windows.

These look at the data without any model of what the frequency follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import hilbert

from companion.diagnosis.free_decay.model import FreeDecayModel
from companion.diagnosis.free_decay.record import FreeDecay
from companion.records import Floats

_WINDOW_S, _STEP_S = 0.3, 0.1
_FINER = 8
_QUIET = 0.02
_LEAST_AMPLITUDE = 0.03
_CELLS = 21
_SPREAD = 2.5  # of the map, in rms


@dataclass(frozen=True, slots=True)
class Backbone:
    """Quiet windows, (w,) each: middle, frequency, damping by the envelope's fall, amplitude, channels there."""

    t_s: Floats
    frequency_hz: Floats
    damping: Floats
    amplitude_mps2: Floats
    channels: dict[str, Floats]


def backbone(one: FreeDecay) -> Backbone:
    """Frequency, damping and amplitude of every window without a knock in it."""
    length, step = round(_WINDOW_S * one.rate_hz), max(round(_STEP_S * one.rate_hz), 1)
    envelope = np.abs(hilbert(one.up_mps2))
    loud = one.impulse_mps2**2 > _QUIET * float(np.mean(one.impulse_mps2**2))
    least = _LEAST_AMPLITUDE * float(np.percentile(envelope, 95))
    rows, at = [], []
    for first in range(0, len(one.t_s) - length, step):
        part = slice(first, first + length)
        if loud[part].any() or float(envelope[part].mean()) < least:
            continue
        f_hz = _peak_hz(one.up_mps2[part], one.rate_hz)
        inner = slice(first + length // 8, first + length - length // 8)  # clear of the ends of the transform
        fall = -np.polyfit(one.t_s[inner], np.log(envelope[inner]), 1)[0]
        rows.append((one.t_s[part].mean(), f_hz, fall / (2.0 * np.pi * f_hz), envelope[part].mean()))
        at.append(part)
    table = np.array(rows).reshape(-1, 4)
    channels = {name: np.array([values[part].mean() for part in at]) for name, values in one.channels.items()}
    return Backbone(table[:, 0], table[:, 1], table[:, 2], table[:, 3], channels)


def _peak_hz(part: Floats, rate_hz: float) -> float:
    power = np.abs(np.fft.rfft(part * np.hanning(len(part)), _FINER * len(part)))
    k = min(max(int(np.argmax(power)), 1), len(power) - 2)
    a, b, c = np.log(power[k - 1 : k + 2])
    return float((k + 0.5 * (a - c) / (a - 2.0 * b + c)) * rate_hz / (_FINER * len(part)))


def restoring_force(model: FreeDecayModel, values: Floats, recording: int) -> tuple[Floats, Floats, Floats]:
    """Mean of what the spring and damper of a model leave of the acceleration, over deflection and speed.

    Returns
    -------
    edges_q, edges_v : (c + 1,)
        In rms.
    left : (c, c)
        In rms of the acceleration; NaN where the motion never was.
    """
    one = model.recordings[recording]
    modes = model.modes(values[None, :], recording)
    omega, zeta = modes.omega_radps[0, :, 0], modes.zeta[0, :, 0]
    f_hz = np.fft.rfftfreq(len(one.t_s), 1.0 / one.rate_hz)
    spectrum = np.fft.rfft(one.up_mps2)
    spectrum[f_hz < 0.2 * float(omega.mean()) / (2.0 * np.pi)] = 0.0
    over = 2j * np.pi * np.maximum(f_hz, f_hz[1])
    v, q = np.fft.irfft(spectrum / over, len(one.t_s)), np.fft.irfft(spectrum / over**2, len(one.t_s))
    left = one.up_mps2 + omega**2 * q + 2.0 * zeta * omega * v
    quiet = one.impulse_mps2**2 < _QUIET * float(np.mean(one.impulse_mps2**2))
    q, v, left = q[quiet] / q[quiet].std(), v[quiet] / v[quiet].std(), left[quiet] / one.up_mps2[quiet].std()
    edges = np.linspace(-_SPREAD, _SPREAD, _CELLS + 1)
    total, _, _ = np.histogram2d(q, v, bins=[edges, edges], weights=left)
    count, _, _ = np.histogram2d(q, v, bins=[edges, edges])
    return edges, edges, np.where(count > 2, total / np.maximum(count, 1), np.nan)
