"""Between time and frequency for one grid: tapering, and interpolation at any instant."""

from __future__ import annotations

import numpy as np

from companion.diagnosis.data.grid import TAPER, faded_share, half_cosine
from companion.diagnosis.recent_results import RecentResults
from companion.records import Complexes, Floats, Ints

_FINER = 4  # chosen: zero padding, after which nine points interpolate
_CACHED = 4  # sets of instants whose weights are kept (choice)
_POINTS = np.arange(-4.0, 5.0)


class Transforms:
    """The grid of one recording: m samples ``dt_s`` apart from ``start_s``."""

    def __init__(self, count: int, dt_s: float, start_s: float) -> None:
        self.count, self.dt_s, self.start_s = count, dt_s, start_s
        self.f_hz: Floats = np.asarray(np.fft.rfftfreq(count, dt_s), dtype=np.float64)
        self.taper = _tukey(count, TAPER)
        faded = faded_share(count * dt_s)
        self._fade_s, self.fading = faded * count * dt_s, _tukey(count, faded)
        self._recent_places: RecentResults[bytes, tuple[Ints, Floats]] = RecentResults(_CACHED)
        self._norm = float(np.sqrt(dt_s / np.sum(self.taper**2)))
        # neighbouring bins of a tapered periodogram share information: count them once
        self.weight = float(np.sum(self.taper**2) ** 2 / (count * np.sum(self.taper**4)))

    def spectrum(self, values: Floats) -> Complexes:
        """Transform (c, f) of channels (c, m), all frequencies."""
        return np.asarray(np.fft.rfft(values, axis=-1))

    def periodic(self, values: Floats) -> Floats:
        """Channels (c, m) whose two ends fade into one another.

        A transform takes its data for one period. Where the ends do not meet, the step leaks to low frequencies, and
        twice integrated it exceeds the true deflection: on a wing with 0.9 % of damping the smoothed deflection was
        wrong by three sigmas 6 s from either end. A fade of one second is too short: it makes the bend of a manoeuvre
        a motion in the band.
        """
        ends = 0.5 * (values[:, :1] + values[:, -1:])
        return np.asarray(ends + (values - ends) * self.fading)

    def onset(self, low: int, top: int) -> Floats:
        """Share of a smoother's gain at each frequency below index ``top``, (top,): 0 below ``low``, then a soft rise.

        A gain that begins abruptly answers as 1/t, and where omega^-2 is large the samples that fade at the ends are
        missed far inside. A rise as wide as 1 over the fade has forgotten them there; it at most doubles its frequency.
        """
        width_hz = max(min(1.0 / self._fade_s, self.f_hz[low]), self.f_hz[1])
        return half_cosine(self.f_hz[:top], self.f_hz[low] + width_hz, self.f_hz[low])

    def in_time(self, spectrum: Complexes) -> Floats:
        """Back to (c, m); frequencies that are not given are 0."""
        return np.asarray(np.fft.irfft(spectrum, self.count, axis=-1))

    def tapered(self, values: Floats) -> Complexes:
        """Spectrum (c, f) of tapered channels; its squared size estimates the two-sided density."""
        return np.asarray(np.fft.rfft(values * self.taper, axis=-1) * self._norm)

    def at(self, spectrum: Complexes, at_s: Floats) -> Floats:
        """A band-limited signal (f,) at any instants: four times finer by zero padding, then nine-point Lagrange.

        The points lie evenly about the instant, so that a small shift changes the signal by its slope alone. A warp
        moves some instants from one nearest point to the next; on a grid twice finer only, that exceeded the slope.
        """
        fine = np.fft.irfft(spectrum, _FINER * self.count) * _FINER
        rows, weights = self._recent_places.get(at_s.tobytes(), lambda: self._places(at_s))
        return np.asarray(np.sum(fine[rows] * weights, axis=1))

    def _places(self, at_s: Floats) -> tuple[Ints, Floats]:
        """Points of the finer grid about each instant and their weights, (k, 9) each."""
        place = (at_s - self.start_s) * (_FINER / self.dt_s)
        nearest = np.rint(place).astype(np.int64)
        rows = (nearest[:, None] + _POINTS.astype(np.int64)) % (_FINER * self.count)
        return rows, _lagrange(place - nearest)


def _lagrange(u: Floats) -> Floats:
    """Weights (k, 9) of the points at -4..4 for a place ``u`` between -0.5 and 0.5."""
    weights = np.ones((len(u), len(_POINTS)))
    for j, point in enumerate(_POINTS):
        for other in _POINTS:
            if other != point:
                weights[:, j] *= (u - other) / (point - other)
    return weights


def _tukey(count: int, taper: float) -> Floats:
    window = np.ones(count)
    width = max(int(taper * count), 1)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(width) + 0.5) / width)
    window[:width], window[-width:] = ramp, ramp[::-1]
    return window
