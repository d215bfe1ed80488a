"""A flight's recording as time series: mode, ranges, plans and shots, clocks, vibration, refusals; no truth needed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy import signal

from companion.evaluation.plan_outcomes import PlanOutcomes
from companion.evaluation.recording_info import RecordingInfo
from companion.records import (
    ClockState,
    CorrectedRange,
    Firing,
    Floats,
    ImuBatch,
    ModeState,
    Notice,
    Record,
    Rejected,
    ServiceStatus,
    Shot,
    Station,
    TriggerPlan,
    Validity,
)

SPECTRUM_SEGMENT_S = 8.0  # of Welch's average: bins of 1/8 Hz tell a mode from its neighbour
_LINE_RATIO = 12.0  # a vibration line stands so far above the median of its neighbours
_NEIGHBOURHOOD_HZ = 6.0  # wider than any line, narrower than the spectrum of a gust (choice)
_LOWEST_LINE_HZ = 3.0  # below are manoeuvres and slow gusts (choice)
_MODE_WIDTH = 0.1  # a peak so near a tracked frequency, as a share of it, is the mode's own (choice)
_NOISE_BAND = (0.5, 0.9)  # of half the rate: above the wing's motion, below the sensor's own low-pass edge
_LINES = 6  # that are worth naming


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One station's vertical acceleration: one-sided power density (m/s^2)^2/Hz at ``f_hz``, and its sharp lines.

    ``modes_hz`` are the tracked frequencies, whose peaks are the wing's.
    """

    f_hz: Floats
    density: Floats
    modes_hz: tuple[float, ...] = ()

    def lines_hz(self) -> list[float]:
        """Frequencies above the manoeuvres that stand out of their neighbourhood and are no mode's, strongest first."""
        if len(self.f_hz) < 3:
            return []
        width = 2 * int(0.5 * _NEIGHBOURHOOD_HZ / (self.f_hz[1] - self.f_hz[0])) + 1
        floor = signal.medfilt(self.density, min(width, 2 * ((len(self.f_hz) - 1) // 2) + 1))
        ratio = self.density / np.maximum(floor, np.finfo(float).tiny)
        peaks, _ = signal.find_peaks(ratio, height=_LINE_RATIO)
        lines = [i for i in peaks if self.f_hz[i] >= _LOWEST_LINE_HZ and not self._of_a_mode(float(self.f_hz[i]))]
        strongest = sorted(lines, key=lambda i: -float(self.density[i]))[:_LINES]
        return [float(self.f_hz[i]) for i in strongest]

    def _of_a_mode(self, f_hz: float) -> bool:
        return any(abs(f_hz - mode_hz) <= _MODE_WIDTH * mode_hz for mode_hz in self.modes_hz)


@dataclass(slots=True)
class FlightLog:
    """Everything that a report of one flight draws, gathered record by record.

    ``delays_s`` is the fired minus the planned instant of every shot that belongs to a plan.
    """

    info: RecordingInfo = field(default_factory=RecordingInfo)
    outcomes: PlanOutcomes = field(default_factory=PlanOutcomes)
    modes: list[ModeState] = field(default_factory=list)
    ranges: list[CorrectedRange] = field(default_factory=list)
    clocks: list[ClockState] = field(default_factory=list)
    status: list[ServiceStatus] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)
    refused: list[Rejected] = field(default_factory=list)
    _plans: dict[int, TriggerPlan] = field(default_factory=dict)
    _vertical: dict[Station, list[Floats]] = field(default_factory=dict)

    def add(self, record: Record) -> None:
        """Take the next record, of any kind."""
        self.info.add(record)
        self.outcomes.take(record)
        if isinstance(record, ImuBatch):
            self._vertical.setdefault(record.station, []).append(record.values[:, 2])
        elif isinstance(record, TriggerPlan) and record.firing is not Firing.SKIP:
            self._plans[record.plan_id] = record
        elif isinstance(record, Shot) and record.plan_id in self._plans:
            self.delays_s.append((record.fired_host_ns - record.planned_host_ns) * 1e-9)
        elif isinstance(record, Rejected):
            self.refused.append(record)
        elif isinstance(record, ModeState):
            self.modes.append(record)
        elif isinstance(record, CorrectedRange):
            self.ranges.append(record)
        elif isinstance(record, ClockState):
            self.clocks.append(record)
        elif isinstance(record, ServiceStatus):
            self.status.append(record)
        elif isinstance(record, Notice):
            self.notices.append(record)

    @property
    def start_host_ns(self) -> int:
        """Host time of the first mode, range or status; 0 where there is none."""
        stamps = [self.modes[0].t_host_ns] if self.modes else []
        stamps += [self.ranges[0].t_host_ns] if self.ranges else []
        stamps += [self.status[0].at_host_ns] if self.status else []
        return min(stamps, default=0)

    def spectrum(self, station: Station) -> Spectrum | None:
        """Welch's mean over the flight, None for fewer than two segments or an unknown rate."""
        stream = self.info.streams.get(station)
        if stream is None or stream.rate_hz is None:
            return None
        values = np.concatenate(self._vertical[station])
        length = int(SPECTRUM_SEGMENT_S * stream.rate_hz)
        if len(values) < 2 * length:
            return None
        f_hz, density = signal.welch(values - values.mean(), stream.rate_hz, nperseg=length)
        tracked = [mode for mode in self.modes if mode.validity is Validity.TRACKING][-1:]
        modes_hz = [family.frequency_hz for mode in tracked for family in (mode.symmetric, mode.antisymmetric)]
        return Spectrum(np.asarray(f_hz), np.asarray(density), tuple(modes_hz))

    def noise_density(self, station: Station) -> float | None:
        """Noise of the vertical accelerometer, (m/s^2)/sqrt(Hz): the median of its spectrum above the wing's motion.

        Lines of propulsion raise few bins and no median. None for less than two seconds or an unknown rate.
        """
        stream = self.info.streams.get(station)
        if stream is None or stream.rate_hz is None:
            return None
        values, length = np.concatenate(self._vertical[station]), int(stream.rate_hz)
        if length < 2 or len(values) < 2 * length:
            return None
        f_hz, density = signal.welch(values - values.mean(), stream.rate_hz, nperseg=length)
        low_hz, high_hz = (ratio * 0.5 * stream.rate_hz for ratio in _NOISE_BAND)
        return float(np.sqrt(np.median(density[(f_hz >= low_hz) & (f_hz <= high_hz)])))

    def blur_px(self) -> Floats:
        """Predicted blur of each plan to fire, px."""
        return np.array([plan.blur_px for plan in self._plans.values()])

    def trusted(self) -> list[CorrectedRange]:
        """Ranges that were published."""
        return [entry for entry in self.ranges if entry.trusted]

    def withheld(self) -> Counter[str]:
        """Ranges that were not published, by reason."""
        return Counter(str(entry.reject) for entry in self.ranges if not entry.trusted)

    def tracked_share(self) -> float:
        """Share of the mode states in which the wing was tracked."""
        return sum(mode.validity is Validity.TRACKING for mode in self.modes) / max(len(self.modes), 1)

    def longest_silence_s(self) -> float:
        """Longest time between two published ranges, s; 0 for fewer than two."""
        t_ns = np.array([entry.t_host_ns for entry in self.trusted()], dtype=np.int64)
        return float(np.diff(t_ns).max()) * 1e-9 if len(t_ns) > 1 else 0.0


def gather(records: Iterable[Record]) -> FlightLog:
    """Read all records of a flight."""
    log = FlightLog()
    for record in records:
        log.add(record)
    return log
