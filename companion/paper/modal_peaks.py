"""From a ground vibration test to mode shapes: quadrature peaks of the transfer functions, edge by edge.

A point's modal peak is the imaginary part of acceleration over force at the resonance, in the run that measured it:
roving accelerometers load the wing, and every run has a resonance of its own.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.core.wing.shapes import EdgePoints
from companion.records import Floats

RATE_HZ = 200.0  # chosen: a tenth of the data set's rate, far above the first mode
INCH_M = 0.0254  # exact (by definition)
_SMOOTHING = 15  # chosen: bins of the spectrum that are averaged: narrow beside a mode, enough for H1
GVT_BAND_HZ = (8.5, 10.2)  # chosen: holds the first symmetric bending of every run and no other mode
_GVT_RUNS = 10  # roving runs in the published data set, five a side (convention)
_GVT_RATE_HZ = 2000  # convention: rate of the published data set
# convention: 0.4684 V/lbf and 1.028 V/g, stated with the data set
_LBF_PER_VOLT, _G_PER_VOLT = 1.0 / 0.4684, 1.0 / 1.028
# x in inches, positive to the left wing, of leading (even index) and trailing edge points, from the centre outward
# (convention: stated with the data set)
_GVT_X_IN = (17.87, 16.00, 27.14, 25.27, 36.42, 34.54, 45.69, 43.81, 54.96, 53.09)
# along the flow at the outermost trailing edge point, where the leading edge runs from (45.69, 30.27) to (54.96, 34.01)
# (derived)
_GVT_SWEEP = (34.01 - 30.27) / (54.96 - 45.69)
# derived: trailing edge less the leading edge beside it, by the sweep above
GVT_TIP_CHORD_M = INCH_M * (38.65 - (34.01 - _GVT_SWEEP * (54.96 - 53.09)))


@dataclass(frozen=True, slots=True, eq=False)
class ModalPoints:
    """Peaks along both edges: span stations (left negative) and peaks per unit force, and the resonances found."""

    leading: EdgePoints
    trailing: EdgePoints
    frequency_hz: Floats


def transfer(force: Floats, accel: Floats) -> tuple[Floats, Any]:
    """Smoothed H1 estimate at :data:`RATE_HZ`: frequencies (k,) and complex acceleration over force (k, channels)."""
    window = np.hanning(_SMOOTHING + 2)[1:-1]
    window /= window.sum()

    def smooth(values: Any) -> Any:
        return np.convolve(values, window, "same")

    f, a = np.fft.rfft(force), np.fft.rfft(accel, axis=0)
    power = smooth(np.abs(f) ** 2)
    gain = np.stack([smooth(column * np.conj(f)) / power for column in a.T], axis=1)
    return np.asarray(np.fft.rfftfreq(len(force), 1.0 / RATE_HZ), dtype=np.float64), gain


def quadrature_peak(force: Floats, accel: Floats, band_hz: tuple[float, float]) -> tuple[float, Floats]:
    """Resonance in a band, and the channels' quadrature there (channels,), positive where they move with the force."""
    frequency, gain = transfer(force, accel)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    at = int(np.flatnonzero(inside)[np.argmax((np.abs(gain[inside]) ** 2).sum(axis=1))])
    return float(frequency[at]), np.asarray(gain[at].imag)


def data_folder() -> Path:
    """Folder of the measured data: ``$SPANWISE_DATA``, or ``shared`` beside the repository."""
    return Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))


def gvt_folder() -> Path:
    """The measured ground vibration test of a flexible flying wing."""
    return data_folder() / "measured" / "maewing1-gvt"


def measured_points(folder: Path) -> ModalPoints:
    """First symmetric bending of the measured wing, 20 points of 10 runs (runs 1 to 5 right, 6 to 10 left wing)."""
    stations, peaks, resonances = [], [], []
    for run in range(1, _GVT_RUNS + 1):
        frequency, quadrature = quadrature_peak(*_gvt_run(folder / f"run_Run{run}.mat"), GVT_BAND_HZ)
        place = 2 * ((run - 1) % 5)
        side = 1.0 if run <= _GVT_RUNS // 2 else -1.0
        stations.append([side * INCH_M * x for x in _GVT_X_IN[place : place + 2]])
        peaks.append(-quadrature)
        resonances.append(frequency)
    return modal_points(np.array(stations), np.array(peaks), np.array(resonances))


def modal_points(stations_m: Floats, peaks: Floats, resonances_hz: Floats) -> ModalPoints:
    """Sort runs (n, 2) by span station; columns: leading, trailing edge."""
    edges = []
    for edge in (0, 1):
        order = np.argsort(stations_m[:, edge])
        edges.append(EdgePoints(stations_m[order, edge], peaks[order, edge]))
    return ModalPoints(edges[0], edges[1], np.sort(resonances_hz))


def _gvt_run(path: Path) -> tuple[Floats, Floats]:
    from scipy.signal import decimate

    volts = read_matlab(path)["signalIn"]
    slow = decimate(volts[:-1], round(_GVT_RATE_HZ / RATE_HZ), axis=0)
    return np.asarray(slow[:, 1] * _LBF_PER_VOLT), np.asarray(slow[:, 2:4] * _G_PER_VOLT)
