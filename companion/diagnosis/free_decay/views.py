"""Views of a free decay by short windows: frequency against channel, backbone, restoring force.

These look at the data without any model of what the frequency follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import hilbert

from companion.diagnosis.free_decay.model import FreeDecayModel
from companion.diagnosis.free_decay.record import FreeDecay, rise
from companion.records import Floats

_WINDOW_S, _PERIODS = 0.3, 1.5  # chosen: a period and a half at 5 Hz, and so many of a slower structure
_STEP_RATIO = 1.0 / 3.0  # chosen: of a window, by which the next one lies later: they overlap
_FINER = 8  # zero padding of a spectrum whose peak is interpolated (choice)
_QUIET = 0.02  # chosen: of the mean squared impulse, up to which a sample has no impulse
_LEAST_AMPLITUDE = 0.03  # of the envelope's 95th percentile, below which it is noise (choice)
_CELLS = 21  # of a map, odd so that one stands at zero (choice)
_SPREAD = 2.5  # chosen: of the map, in rms: nearly all of a decay lies within


@dataclass(frozen=True, slots=True)
class WindowedBackbone:
    """Quiet windows, (w,) each: middle, frequency, damping by the envelope's fall, amplitude, channels there.

    Each lasts ``length_s``.
    """

    t_s: Floats
    frequency_hz: Floats
    damping: Floats
    amplitude_mps2: Floats
    channels: dict[str, Floats]
    length_s: float


def backbone(record: FreeDecay) -> WindowedBackbone:
    """Frequency, damping and amplitude of every window without an impulse in it."""
    up = _without_drift(record)
    length_s = max(_WINDOW_S, _PERIODS / _peak_hz(up, record.rate_hz))
    length, step = round(length_s * record.rate_hz), max(round(_STEP_RATIO * length_s * record.rate_hz), 1)
    envelope = np.abs(hilbert(up))
    loud = record.impulse_mps2**2 > _QUIET * float(np.mean(record.impulse_mps2**2))
    least = _LEAST_AMPLITUDE * float(np.percentile(envelope, 95))
    rows, at = [], []
    for first in range(0, len(record.t_s) - length, step):
        window = slice(first, first + length)
        if loud[window].any() or float(envelope[window].mean()) < least:
            continue
        f_hz = _peak_hz(up[window], record.rate_hz)
        inner = slice(first + length // 8, first + length - length // 8)  # clear of the ends of the transform
        fall = -np.polyfit(record.t_s[inner], np.log(envelope[inner]), 1)[0]
        rows.append((record.t_s[window].mean(), f_hz, fall / (2.0 * np.pi * f_hz), envelope[window].mean()))
        at.append(window)
    table = np.array(rows).reshape(-1, 4)
    channels = {name: np.array([values[window].mean() for window in at]) for name, values in record.channels.items()}
    return WindowedBackbone(table[:, 0], table[:, 1], table[:, 2], table[:, 3], channels, length_s)


def _without_drift(record: FreeDecay) -> Floats:
    """Acceleration (m,) above the band's lower edge."""
    f_hz = np.fft.rfftfreq(len(record.t_s), 1.0 / record.rate_hz)
    return np.asarray(
        np.fft.irfft(rise(f_hz / max(record.lowest_hz, f_hz[1])) * np.fft.rfft(record.up_mps2), len(record.t_s))
    )


def _peak_hz(window: Floats, rate_hz: float) -> float:
    power = np.abs(np.fft.rfft(window * np.hanning(len(window)), _FINER * len(window)))
    k = min(max(int(np.argmax(power)), 1), len(power) - 2)
    a, b, c = np.log(power[k - 1 : k + 2])
    return float((k + 0.5 * (a - c) / (a - 2.0 * b + c)) * rate_hz / (_FINER * len(window)))


def restoring_force(model: FreeDecayModel, values: Floats, recording: int) -> tuple[Floats, Floats, Floats]:
    """Mean acceleration that spring and damper of a model do not explain, over deflection and speed.

    Returns
    -------
    edges_q, edges_v : (c + 1,)
        In rms.
    residual : (c, c)
        In rms of the acceleration; NaN where the motion never was.
    """
    record = model.recordings[recording]
    modes = model.modes(values[None, :], recording)
    omega, zeta = modes.omega_radps[0, :, 0], modes.zeta[0, :, 0]
    f_hz = np.fft.rfftfreq(len(record.t_s), 1.0 / record.rate_hz)
    up = _without_drift(record)
    spectrum = np.fft.rfft(up)
    spectrum[f_hz < 0.2 * float(omega.mean()) / (2.0 * np.pi)] = 0.0
    over = 2j * np.pi * np.maximum(f_hz, f_hz[1])
    v, q = np.fft.irfft(spectrum / over, len(record.t_s)), np.fft.irfft(spectrum / over**2, len(record.t_s))
    residual = up + omega**2 * q + 2.0 * zeta * omega * v
    quiet = record.impulse_mps2**2 <= _QUIET * float(np.mean(record.impulse_mps2**2))
    q, v, residual = q[quiet] / q[quiet].std(), v[quiet] / v[quiet].std(), residual[quiet] / up[quiet].std()
    edges = np.linspace(-_SPREAD, _SPREAD, _CELLS + 1)
    total, _, _ = np.histogram2d(q, v, bins=[edges, edges], weights=residual)
    count, _, _ = np.histogram2d(q, v, bins=[edges, edges])
    return edges, edges, np.where(count > 2, total / np.maximum(count, 1), np.nan)
