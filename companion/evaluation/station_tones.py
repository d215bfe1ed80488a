"""Steady tone of each station of a recording by itself: frequency, amplitude and phase.

This looks at the vertical axis before any rigid motion is taken out, so that it holds for a shaker, for injected sines
and for sensors that are not on one wing.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from companion.core.tracking.tone import ToneEstimate, ToneTracker
from companion.params.airframe import Airframe
from companion.records import ImuBatch, Reject, Station

_SEARCH_HZ = (1.0, 40.0)  # chosen: from a slow wing's first mode to what is sampled well
_WINDOW_S = 4.0  # chosen: twenty periods at 5 Hz, for amplitudes that last
_EVERY_NS = 1_000_000_000  # chosen: windows overlap by three quarters


class StationAnalysis:
    """Feed it every inertial batch; :meth:`result` sums up."""

    def __init__(self, airframe: Airframe) -> None:
        self._trackers = {
            station: ToneTracker(station, airframe.sensor(station), _SEARCH_HZ, _WINDOW_S) for station in Station
        }
        self._next_ns: dict[Station, int] = {}
        self.tones: dict[Station, list[ToneEstimate]] = {station: [] for station in Station}
        self._refused: dict[Station, Counter[str]] = {station: Counter() for station in Station}
        self._samples: Counter[Station] = Counter()

    @property
    def has_tone(self) -> bool:
        """Whether any station has a tone."""
        return any(self.tones.values())

    def add(self, batch: ImuBatch) -> None:
        """Take a batch; estimate once a second, in the middle of a full window."""
        if not len(batch.t_ns):
            return
        station, newest_ns = batch.station, int(batch.t_ns[-1])
        self._samples[station] += len(batch.t_ns)
        self._trackers[station].add(batch)
        if newest_ns < self._next_ns.setdefault(station, newest_ns + int(_WINDOW_S * 1e9)):
            return
        self._next_ns[station] = newest_ns + _EVERY_NS
        estimate = self._trackers[station].estimate(newest_ns - int(_WINDOW_S * 0.5e9))
        if isinstance(estimate, Reject):
            self._refused[station][str(estimate)] += 1
        else:
            self.tones[station].append(estimate)

    def result(self) -> dict[str, dict[str, Any]]:
        """Medians over the windows with a tone, by station name, or the reason for none."""
        return {station.name.lower(): self._describe(station) for station in Station if self._samples[station]}

    def sentences(self) -> list[str]:
        """The steady tones, a few words each: of the stations that show one in most windows."""
        words = []
        for station, tones in self.tones.items():
            if len(tones) > sum(self._refused[station].values()):
                frequency_hz, amplitude = _medians(tones)
                words.append(f"{station.name.lower()} {frequency_hz:.3f} Hz, {amplitude:.2f} m/s^2")
        return words

    def _describe(self, station: Station) -> dict[str, Any]:
        tones, refused = self.tones[station], self._refused[station]
        windows = len(tones) + sum(refused.values())
        if not tones:
            why = refused.most_common(1)[0][0] if refused else "recording too short"
            return {"tone": None, "windows": windows, "text": f"no steady tone ({why} in {windows} windows)"}
        frequency, amplitude = _medians(tones)
        spread = float(np.std([tone.frequency_hz for tone in tones]))
        text = (
            f"{frequency:.3f} Hz (spread {spread:.3f}), {amplitude:.3f} m/s^2, "
            f"phase ±{np.degrees(np.median([tone.phase_sigma_rad for tone in tones])):.2f}° "
            f"in {len(tones)} of {windows} windows of {_WINDOW_S:g} s"
        )
        tone = {
            "frequency_hz": frequency,
            "frequency_spread_hz": spread,
            "amplitude_mps2": amplitude,
            "amplitude_sigma_mps2": float(np.median([tone.amplitude_sigma_mps2 for tone in tones])),
            "phases": [[tone.t_ns, tone.phase_rad, tone.phase_sigma_rad] for tone in tones],
        }
        return {"tone": tone, "windows": windows, "text": text}


def _medians(tones: list[ToneEstimate]) -> tuple[float, float]:
    """Frequency, Hz, and amplitude, m/s^2."""
    frequency_hz = float(np.median([tone.frequency_hz for tone in tones]))
    return frequency_hz, float(np.median([tone.amplitude_mps2 for tone in tones]))
