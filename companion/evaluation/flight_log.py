"""A flight's recording as time series: mode, ranges, plans and shots, clocks, vibration, refusals; no truth needed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy import signal

from companion.core.autopilot_filters import VehicleFilters
from companion.core.wing.lowpass import Butterworth2
from companion.evaluation.plan_outcomes import SKIPPED, PlanOutcomes
from companion.evaluation.published_ranges import PublishedRanges
from companion.evaluation.recording_info import AT_THE_END, RecordingInfo
from companion.params.airframe import FAMILIES
from companion.records import (
    AutopilotParameter,
    ClockState,
    CorrectedRange,
    Firing,
    Floats,
    ImuBatch,
    ModeEstimate,
    ModeState,
    Notice,
    Record,
    Reject,
    Rejected,
    Shot,
    Station,
    TriggerPlan,
    Validity,
)

SPECTRUM_SEGMENT_S = 8.0  # of Welch's average: bins of 1/8 Hz tell a mode from its neighbour (choice)
_LINE_RATIO = 12.0  # a vibration line stands so far above the median of its neighbours (choice)
_NEIGHBOURHOOD_HZ = 6.0  # wider than any line, narrower than the spectrum of a gust (choice)
_LOWEST_LINE_HZ = 3.0  # below are manoeuvres and slow gusts (choice)
_MODE_WIDTH = 0.1  # a peak so near a tracked frequency, as a share of it, is the mode's own (choice)
_NOISE_BAND = (0.5, 0.9)  # of half the rate: above the wing's motion, below the sensor's own low-pass edge (choice)
_PASSED = 0.3  # gain of a low-pass below which rounding and aliases pass for the sensor's noise (choice)
_LINES = 6  # that are worth naming (choice)


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


@dataclass(frozen=True, slots=True)
class ModeSummary:
    """First mode of a family over a flight: medians while it was tracked; ``rms_m`` is the vibration at the tip.

    The rms is that of the mode's rate over its frequency: the slow bend by gusts and load is not in it.
    """

    frequency_hz: float
    frequency_sigma_hz: float
    rms_m: float


@dataclass(slots=True)
class FlightLog:
    """Everything that a report of one flight draws, gathered record by record.

    ``delays_s`` is the fired minus the planned instant of every shot that belongs to a plan, ``filters`` what the
    vehicle told of its low-passes.
    """

    info: RecordingInfo = field(default_factory=RecordingInfo)
    outcomes: PlanOutcomes = field(default_factory=PlanOutcomes)
    published: PublishedRanges = field(default_factory=PublishedRanges)
    modes: list[ModeState] = field(default_factory=list)
    ranges: list[CorrectedRange] = field(default_factory=list)
    clocks: list[ClockState] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)
    refused: list[Rejected] = field(default_factory=list)
    filters: VehicleFilters = field(default_factory=VehicleFilters)
    _plans: dict[int, tuple[TriggerPlan, float]] = field(default_factory=dict)
    _stopped: dict[int, int] = field(default_factory=dict)
    _newest_plan: int = -1
    _range_m: float = float("nan")
    _vertical: dict[Station, list[Floats]] = field(default_factory=dict)

    @property
    def estimated(self) -> bool:
        """Whether the recording holds estimates: an autopilot's log and tables hold what was measured alone."""
        return bool(self.modes or self.ranges or self.clocks)

    def add(self, record: Record) -> None:
        """Take the next record, of any kind."""
        self.info.add(record)
        self.outcomes.take(record)
        self.published.take(record)
        if isinstance(record, ImuBatch):
            self._vertical.setdefault(record.station, []).append(record.values[:, 2])
        elif isinstance(record, TriggerPlan):
            self._plan(record)
        elif isinstance(record, Shot) and record.plan_id in self._plans:
            self.delays_s.append((record.fired_host_ns - record.planned_host_ns) * 1e-9)
        elif isinstance(record, Rejected):
            self.refused.append(record)
        elif isinstance(record, ModeState):
            self.modes.append(record)
        elif isinstance(record, CorrectedRange):
            self.ranges.append(record)
            self._range_m = record.range_m if record.trusted else self._range_m
        elif isinstance(record, ClockState):
            self.clocks.append(record)
        elif isinstance(record, Notice):
            self.notices.append(record)
        elif isinstance(record, AutopilotParameter):
            self.filters.take(record.name, record.value)

    def _plan(self, plan: TriggerPlan) -> None:
        self._newest_plan = plan.plan_id
        self._stopped.pop(plan.plan_id, None)
        if plan.firing is not Firing.SKIP:
            self._plans[plan.plan_id] = plan, self._range_m
        elif plan.reject is Reject.STALE:
            self._stopped[plan.plan_id] = plan.planned_host_ns

    @property
    def start_host_ns(self) -> int:
        """Host time of the first mode, range or status; 0 where there is none."""
        stamps = [self.modes[0].t_host_ns] if self.modes else []
        stamps += [self.ranges[0].t_host_ns] if self.ranges else []
        stamps += [status.at_host_ns for status in self.info.service.statuses[:1]]
        return min(stamps, default=0)

    def spectrum(self, station: Station) -> Spectrum | None:
        """Welch's mean over the flight, None for fewer than two segments or an unknown rate."""
        power = self._power(station, SPECTRUM_SEGMENT_S)
        if power is None:
            return None
        summaries = [self.mode(name) for name in FAMILIES]
        return Spectrum(*power, tuple(summary.frequency_hz for summary in summaries if summary is not None))

    def noise_density(self, station: Station, lowpass_hz: float = 0.0) -> float | None:
        """Noise of the vertical accelerometer, (m/s^2)/sqrt(Hz): the median of its spectrum above the wing's motion.

        Lines of propulsion raise few bins and no median. What a low-pass at ``lowpass_hz`` (0: none) takes is given
        back. None for less than two seconds or an unknown rate, and where that filter leaves too little of the band.
        """
        power, rate_hz = self._power(station, 1.0), self._rate_hz(station)
        if power is None or rate_hz is None:
            return None
        f_hz, density = power
        low_hz, high_hz = (ratio * 0.5 * rate_hz for ratio in _NOISE_BAND)
        band = (f_hz >= low_hz) & (f_hz <= high_hz)
        gain = np.abs(Butterworth2(lowpass_hz).response(f_hz)) if lowpass_hz > 0.0 else np.ones(len(f_hz))
        passed = band & (gain >= _PASSED)
        if 2 * np.count_nonzero(passed) < np.count_nonzero(band):
            return None
        return float(np.sqrt(np.median(density[passed] / gain[passed] ** 2)))

    def _rate_hz(self, station: Station) -> float | None:
        stream = self.info.streams.get(station)
        return None if stream is None else stream.rate_hz

    def _power(self, station: Station, segment_s: float) -> tuple[Floats, Floats] | None:
        """Welch's frequencies and power density of the vertical acceleration; None for fewer than two segments."""
        rate_hz = self._rate_hz(station)
        if rate_hz is None:
            return None
        values, length = np.concatenate(self._vertical[station]), int(segment_s * rate_hz)
        if length < 2 or len(values) < 2 * length:
            return None
        f_hz, density = signal.welch(values - values.mean(), rate_hz, nperseg=length)
        return np.asarray(f_hz), np.asarray(density)

    def blur_px(self) -> tuple[Floats, Floats]:
        """Predicted blur (n,) of each plan to fire, px, and the last range (n,) when made, m (NaN before any)."""
        plans = self._plans.values()
        return np.array([plan.blur_px for plan, _ in plans]), np.array([range_m for _, range_m in plans])

    def plan_outcomes(self) -> dict[str, int]:
        """How many plans came to each end; those made after the last sample have an end of their own."""
        counts, stopped = self.outcomes.counts(), f"{SKIPPED}{Reject.STALE}"
        # the newest plan still waits, and is not among the counts
        settled = [planned_ns for number, planned_ns in self._stopped.items() if number != self._newest_plan]
        ended = sum(self.info.service.is_end(planned_ns) for planned_ns in settled)
        if not ended:
            return counts
        counts[stopped] -= ended
        return {name: count for name, count in counts.items() if count} | {f"{SKIPPED}{AT_THE_END}": ended}

    def trusted(self) -> list[CorrectedRange]:
        """Ranges that were published."""
        return [entry for entry in self.ranges if entry.trusted]

    def withheld(self) -> Counter[str]:
        """Ranges that were not published, by reason."""
        return Counter(str(entry.reject) for entry in self.ranges if not entry.trusted)

    def tracked(self) -> list[ModeState]:
        """Mode states in which the wing was tracked."""
        return [mode for mode in self.modes if mode.validity is Validity.TRACKING]

    def tracked_ratio(self) -> float:
        """Share of the mode states in which the wing was tracked, those after the last sample left out."""
        flown = [mode for mode in self.modes if not self.info.service.is_end(mode.t_host_ns)]
        return sum(mode.validity is Validity.TRACKING for mode in flown) / max(len(flown), 1)

    def mode(self, name: str) -> ModeSummary | None:
        """Summary of the ``symmetric`` or ``antisymmetric`` first mode; None where it was never tracked."""
        modes: list[ModeEstimate] = [getattr(mode, name) for mode in self.tracked()]
        if not modes:
            return None
        figures = ("frequency_hz", "frequency_sigma_hz", "rms_m")
        return ModeSummary(*(float(np.median([getattr(mode, figure) for mode in modes])) for figure in figures))


def gather(records: Iterable[Record]) -> FlightLog:
    """Read all records of a flight."""
    log = FlightLog()
    for record in records:
        log.add(record)
    return log
