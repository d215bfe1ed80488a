"""The guide of ``spanwise setup wing``: asks for one handling after the other and judges each by a figure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.calibration.ambient import AmbientMode
from companion.calibration.flight_modes import wing_motion
from companion.calibration.handling import (
    TAP_MPS2,
    TILT_RAD,
    TIPS,
    Judgement,
    Tilt,
    is_still,
    judge_tap,
    judge_tilt,
    tap_peaks,
)
from companion.doctor.evidence import Finding, FindingLevel
from companion.doctor.examine import Examination
from companion.errors import DeviceError, RecordingError
from companion.params.airframe import Airframe
from companion.ports import Clock
from companion.records import Axis, ClockName, Floats, ImuBatch, Record, Station, TimesyncReply

LIMIT_S = 60.0
"""Longest wait for a handling (choice)."""
PLUCKING_S = 40.0
"""Listening to a plucked wing: 200 swings of 5 Hz (choice)."""
_WINDOW_NS = 1_000_000_000  # chosen: a second of stillness, which a hand can hold
_AFTER_TAP_NS = 700_000_000  # chosen: a tap's ringing has passed, and both tips' samples have arrived
_KEPT_NS = 30_000_000_000  # of samples, beyond any handling (choice)
_BAND_HZ = (2.0, 40.0)  # where wings have their first modes; as of identify flight (choice)
_SIGMAS = 3.0  # beyond, the file is of another wing (choice)
_LEAST_SIGMA_HZ = 0.01  # chosen: of any frequency: no test in the field knows one better
SAMPLES = "samples"
"""Name of the step that says whose samples are missing: without them no further step can pass."""
_SUBJECTS = ("link", "heartbeat", "wire", "routing", "wing", "clock")


@dataclass(frozen=True, slots=True)
class GuideStep:
    """One line of the guide's result."""

    name: str
    figure: str
    remedy: str = ""


class SampleWindow:
    """Newest samples of every station by their arrival."""

    def __init__(self) -> None:
        self._batches: dict[Station, deque[ImuBatch]] = {station: deque() for station in Station}
        self.axes: dict[Station, Axis] = dict.fromkeys(Station, Axis.NONE)

    def take(self, record: Record) -> None:
        """Keep the samples of a record."""
        if not isinstance(record, ImuBatch):
            return
        batches = self._batches[record.station]
        batches.append(record)
        self.axes[record.station] |= record.axes
        while batches[-1].received_host_ns - batches[0].received_host_ns > _KEPT_NS:
            batches.popleft()

    def values(self, from_ns: int) -> dict[Station, Floats]:
        """Samples (n, 6) of every station that arrived since."""
        return {station: self._joined(station, from_ns)[1] for station in Station}

    def turned_rad(self, from_ns: int, column: int, at_rest_radps: dict[Station, float]) -> dict[Station, float]:
        """Integral since then of a rate beyond that at rest, rad.

        The stamps of a sensor are of its own clock, whose steps are true. A gyro that shows 0.5 degrees a second at
        rest turns by itself through 8 in the time that a hand needs.
        """
        result = {}
        for station in Station:
            t_ns, values = self._joined(station, from_ns)
            rate_radps = values[:, column] - at_rest_radps[station]
            result[station] = float(np.trapezoid(rate_radps, t_ns * 1e-9)) if len(t_ns) > 1 else 0.0
        return result

    def _joined(self, station: Station, from_ns: int) -> tuple[Floats, Floats]:
        fresh = [batch for batch in self._batches[station] if batch.received_host_ns >= from_ns]
        if not fresh:
            return np.empty(0), np.empty((0, 6))
        return np.concatenate([batch.t_ns for batch in fresh]), np.concatenate([batch.values for batch in fresh])


class WingGuide:
    """Leads through the bench part of a set-up.

    ``examine`` makes the doctor's examination, which hands each record to the function that it is given, and
    ``diagnose`` judges its evidence. ``say`` shows a sentence at once; ``wait`` lets a little time pass between two
    looks at the link.

    Raises
    ------
    DeviceError
        Nothing that was asked for happened within :data:`LIMIT_S`, or a station sends no samples.
    """

    def __init__(
        self,
        examine: Callable[[Callable[[Record], None]], Examination],
        diagnose: Callable[[Examination], list[Finding]],
        airframe: Airframe,
        clock: Clock,
        say: Callable[[str], None],
        wait: Callable[[], None],
    ) -> None:
        self._window, self._records = SampleWindow(), list[Record]()
        self._examination = examine(self._hear)
        self._diagnose, self._airframe, self._clock = diagnose, airframe, clock
        self._say, self._wait = say, wait
        self._plucking = False

    def close(self) -> None:
        """Close the links."""
        self._examination.pilot.close()

    def nodes(self) -> list[GuideStep]:
        """Nodes, rates and clocks, as the doctor sees them."""
        self._say("listening: leave the aircraft alone")
        while not self._examination.over:
            self._once()
        findings = [each for each in self._diagnose(self._examination) if each.subject in _SUBJECTS]
        steps = [
            GuideStep(each.subject, each.text, "mend this first" if each.level is FindingLevel.FIX else "")
            for each in findings
        ]
        silent = self._silent(0)
        remedy = "look at link and nodes first: without samples no further step can pass"
        return [*steps, GuideStep(SAMPLES, f"none from {silent}", remedy)] if silent else steps

    def taps(self) -> list[GuideStep]:
        """Both tips, each tapped once: the node that is moved is the one that says so."""
        return [self._tapped(side) for side in TIPS]

    def tilts(self) -> list[GuideStep]:
        """Right wing down, then nose up: axes and signs of all three stations."""
        return [step for tilt in Tilt for step in self._tilted(tilt)]

    def modes(self, plucking_s: float = PLUCKING_S) -> list[GuideStep]:
        """Both families of modes of a wing that is plucked for a while."""
        self._say(f"pluck both tips together, then against each other, again and again for {plucking_s:g} s")
        ends_ns = self._clock.now_ns() + round(plucking_s * 1e9)
        self._plucking = True
        while self._clock.now_ns() < ends_ns:
            self._once()
        self._plucking = False
        try:
            families = wing_motion(self._records, self._airframe, ClockName.HOST).modes(_BAND_HZ)
        except RecordingError as error:
            return [GuideStep("modes", str(error), "mend nodes and clocks first")]
        return [self._mode(name, next((mode for mode in families[name] if mode.resolved), None)) for name in families]

    # ------------------------------------------------------------------------------------------------

    def _mode(self, family: str, mode: AmbientMode | None) -> GuideStep:
        if mode is None:
            return GuideStep("modes", f"{family}: none told", "pluck harder, and both tips at once")
        believed = getattr(self._airframe.wing, family).frequency_hz
        sigma_hz = max(float(np.hypot(mode.frequency_sigma_hz, believed.sigma)), _LEAST_SIGMA_HZ)
        figure = f"{family} {mode.frequency_hz:.3f} ±{mode.frequency_sigma_hz:.3f} Hz, the airframe says "
        figure += f"{believed.value:.2f} ±{believed.sigma:.2f}"
        is_near = abs(mode.frequency_hz - believed.value) <= _SIGMAS * sigma_hz
        return GuideStep("modes", figure, "" if is_near else "write it into the airframe file, or widen its sigma")

    def _tapped(self, side: Station) -> GuideStep:
        self._still()
        self._say(f"tap the {side.name.lower()} tip with a fingernail, once")
        began_ns = self._clock.now_ns()
        self._until(lambda: self._tap_since(began_ns), f"no tap reached {TAP_MPS2:g} m/s^2")
        self._listen(_AFTER_TAP_NS)
        return _step("tap", judge_tap(self._window.values(began_ns), side))

    def _tilted(self, tilt: Tilt) -> list[GuideStep]:
        self._still()
        before, rates = self._rest(), self._rest(slice(3, 6))
        at_rest_radps = {station: float(rate[tilt.value - 3]) for station, rate in rates.items()}
        began_ns = self._clock.now_ns()
        self._say(f"tilt the aircraft, {tilt.words}, by some 25 degrees, and hold it still")
        self._until(lambda: self._has_tilted(before[Station.ROOT]) and self._is_still(), "it was not tilted and held")
        self._listen(_WINDOW_NS)  # the hand comes to rest
        after, turned = self._rest(), self._window.turned_rad(began_ns, tilt.value, at_rest_radps)
        judged = judge_tilt(before, after, turned, self._window.axes, tilt)
        self._say("back to level")
        self._until(lambda: not self._has_tilted(before[Station.ROOT]) and self._is_still(), "it was not laid level")
        return [_step(f"{station.name.lower()}", judged[station], f"{tilt.words}: ") for station in judged]

    def _hear(self, record: Record) -> None:
        self._window.take(record)
        if isinstance(record, TimesyncReply) or (self._plucking and isinstance(record, ImuBatch)):
            self._records.append(record)

    def _once(self) -> None:
        self._wait()
        self._examination.run_once()

    def _listen(self, for_ns: int) -> None:
        ends_ns = self._clock.now_ns() + for_ns
        while self._clock.now_ns() < ends_ns:
            self._once()

    def _until(self, happened: Callable[[], bool], what: str) -> None:
        ends_ns = self._clock.now_ns() + round(LIMIT_S * 1e9)
        while not happened():
            if self._clock.now_ns() > ends_ns:
                if silent := self._silent(self._clock.now_ns() - _WINDOW_NS):
                    raise DeviceError(f"no samples come from {silent}: see `--step nodes`")
                raise DeviceError(f"{what} within {LIMIT_S:g} s; begin anew when you are ready")
            self._listen(_WINDOW_NS // 10)

    def _silent(self, from_ns: int) -> str:
        """Stations without samples since then, "" where there are none."""
        return ", ".join(each.name.lower() for each, rows in self._window.values(from_ns).items() if not len(rows))

    def _still(self) -> None:
        self._until(self._is_still, "the aircraft was never still for a second")

    def _is_still(self) -> bool:
        return is_still(self._window.values(self._clock.now_ns() - _WINDOW_NS))

    def _rest(self, columns: slice = slice(0, 3)) -> dict[Station, Floats]:
        """Mean of the last second (3,): specific force, m/s^2, or the rates, rad/s."""
        values = self._window.values(self._clock.now_ns() - _WINDOW_NS)
        return {station: np.asarray(each[:, columns].mean(axis=0)) for station, each in values.items()}

    def _tap_since(self, began_ns: int) -> bool:
        peaks = tap_peaks(self._window.values(began_ns))
        return max((peaks.get(side, 0.0) for side in TIPS), default=0.0) > TAP_MPS2

    def _has_tilted(self, before: Floats) -> bool:
        now = self._rest()[Station.ROOT]
        cosine = float(now @ before) / max(float(np.linalg.norm(now) * np.linalg.norm(before)), 1e-9)
        return bool(np.arccos(np.clip(cosine, -1.0, 1.0)) > TILT_RAD)


def _step(name: str, judged: Judgement, prefix: str = "") -> GuideStep:
    return GuideStep(name, f"{prefix}{judged.figure}", judged.remedy)
