"""Asks the autopilot for message rates, one SET_MESSAGE_INTERVAL at a time, and keeps checking what is delivered.

ArduPilot cuts intervals to whole milliseconds, denies what is faster than 0.8 of SCHED_LOOP_RATE, and may fall back to
its own rates later without a word (ArduPilot #28550). PX4 grants every interval and delivers inertial messages at
IMU_INTEG_RATE at most.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Mapping
from dataclasses import dataclass

from companion.adapters.mavlink.link.dialect import NAME_OF, mavlink
from companion.rate_limiter import RateLimiter
from companion.records import Notice
from companion.units import Severity

_SECOND_NS = 1_000_000_000  # by definition
_ACK_TIMEOUT_NS = 300_000_000  # chosen: an acknowledgement over a radio link comes within it
_LATE_NS = _SECOND_NS  # chosen: for so long acknowledgements of repeated requests are awaited, before another message
_SILENT_PAUSE_NS = 5 * _SECOND_NS  # chosen: an autopilot that starts up answers some seconds later
_REFUSED_PAUSE_NS = 30 * _SECOND_NS  # chosen: a refusal rarely changes within a flight
_LONGEST_PAUSE_NS = 10 * _SECOND_NS  # chosen: the longest that a lost rate may go unnoticed
_TRIES = 5  # chosen: requests in 1.5 s, before a pause leaves the link to others
_ENOUGH = 0.75  # of the granted rate: ArduPilot truncates intervals to ms, 400 Hz become 333
_SLOWER = 1.25  # chosen: factor of the interval after a denial: a few steps find what is granted
_SLOWEST_US = 200_000  # chosen: 5 Hz, below which no mode is seen: less is not asked for
_SLOW_VERDICTS = 3  # chosen: seconds in a row: a burst of other traffic is no slow stream
_SLOW_REPEAT_NS = 60 * _SECOND_NS  # chosen: the loop rate is not changed in flight; once a minute is a reminder
SAMPLES_PER_PERIOD = 10.0
"""Samples that the tracker wants of every period of the fastest mode (choice)."""


@dataclass(slots=True)
class _RequestedRate:
    message: int
    wanted_us: int
    granted_us: int
    settled: bool = False
    ask_at_host_ns: int = 0
    check_at_host_ns: int = 0
    pause_ns: int = _SECOND_NS
    tries: int = 0
    fallen: int = 0
    counted: int = 0
    counted_host_ns: int = 0
    slow: int = 0


@dataclass(frozen=True, slots=True)
class IntervalRequest:
    """SET_MESSAGE_INTERVAL to be sent: message id and interval."""

    message: int
    interval_us: int


_INTEGRATION_RATES_HZ = (100, 200, 250, 400, 1000)  # values of IMU_INTEG_RATE (PX4 parameter reference)


def needed_integration_rate_hz(rate_hz: float) -> int:
    """IMU_INTEG_RATE at which PX4 can deliver ``rate_hz``: of its own list, or the largest that it takes."""
    return next((rate for rate in _INTEGRATION_RATES_HZ if rate >= rate_hz), _INTEGRATION_RATES_HZ[-1])


def needed_loop_rate_hz(rate_hz: float) -> int:
    """SCHED_LOOP_RATE at which ArduPilot can deliver ``rate_hz``: a fifth more, in steps of 50 Hz."""
    return math.ceil(1.2 * rate_hz / 50.0) * 50


class RateKeeper:
    """The rates of one component.

    ``wanted_hz`` gives the rate by message id; ``inertial`` are the messages of it that the wing's modes are tracked
    with.
    """

    def __init__(self, wanted_hz: Mapping[int, float], inertial: Container[int] = ()) -> None:
        self._inertial = inertial
        self._mode_hz = 0.0
        wanted_us = {message: round(1e6 / rate_hz) for message, rate_hz in wanted_hz.items()}
        self._wanted = {message: _RequestedRate(message, us, us) for message, us in wanted_us.items()}
        self._asked: _RequestedRate | None = None
        self._asked_host_ns = 0
        self._unanswered = 0  # requests for the message asked last; an acknowledgement does not say of which it is
        self._next_host_ns = 0
        self._loop_rate_hz: float | None = None
        self._integration_rate_hz: float | None = None
        self._notices: deque[Notice] = deque(maxlen=32)
        self._slow_warnings = RateLimiter(_SLOW_REPEAT_NS)
        self.delivered_hz: dict[int, float] = {}

    def restart(self, now_host_ns: int) -> None:
        """Ask for everything again: the component rebooted."""
        self._asked, self._unanswered = None, 0
        for entry in self._wanted.values():
            entry.granted_us, entry.settled, entry.tries, entry.fallen = entry.wanted_us, False, 0, 0
            entry.ask_at_host_ns, entry.pause_ns = now_host_ns, _SECOND_NS

    def loop_rate(self, rate_hz: float) -> None:
        """Take note of SCHED_LOOP_RATE: the autopilot is ArduPilot."""
        self._loop_rate_hz, self._integration_rate_hz = rate_hz, None

    def integration_rate(self, rate_hz: float) -> None:
        """Take note of IMU_INTEG_RATE: the autopilot is PX4, and asking for more inertial messages brings none."""
        self._loop_rate_hz, self._integration_rate_hz = None, rate_hz

    def mode(self, frequency_hz: float) -> None:
        """Take note of the fastest mode that is tracked: inertial messages must be fast enough for it."""
        self._mode_hz = frequency_hz

    def due(self, now_host_ns: int) -> IntervalRequest | None:
        """Give the request that is to be sent now, if any."""
        asked = self._asked
        if asked is not None:
            if now_host_ns - self._asked_host_ns < _ACK_TIMEOUT_NS:
                return None
            asked.tries += 1
            if asked.tries >= _TRIES:
                asked.tries, asked.ask_at_host_ns = 0, now_host_ns + _SILENT_PAUSE_NS
                self._asked, self._next_host_ns = None, now_host_ns + _LATE_NS
        if self._asked is None and self._unanswered and now_host_ns < self._next_host_ns:
            return None
        ready = [entry for entry in self._wanted.values() if not entry.settled and entry.ask_at_host_ns <= now_host_ns]
        self._unanswered = 0 if self._asked is None else self._unanswered
        if self._asked not in ready:
            self._asked = ready[0] if ready else None
        if self._asked is None:
            return None
        self._asked_host_ns, self._unanswered = now_host_ns, self._unanswered + 1
        return IntervalRequest(self._asked.message, self._asked.granted_us)

    def acknowledged(self, result: int, now_host_ns: int) -> None:
        """Take the COMMAND_ACK of the request that is out; those of its repeats come later, and say nothing new."""
        if result == mavlink.MAV_RESULT_IN_PROGRESS:
            return
        entry, self._asked = self._asked, None
        self._unanswered = max(self._unanswered - 1, 0)
        if entry is None:
            return
        self._next_host_ns = now_host_ns + _LATE_NS
        if result == mavlink.MAV_RESULT_ACCEPTED:
            entry.settled, entry.tries = True, 0
            entry.counted_host_ns, entry.check_at_host_ns = 0, now_host_ns + entry.pause_ns
        elif result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED:
            entry.ask_at_host_ns = now_host_ns + _SECOND_NS
        elif result == mavlink.MAV_RESULT_DENIED and entry.granted_us < _SLOWEST_US:
            self._reduce(entry, now_host_ns)
        else:
            entry.ask_at_host_ns = now_host_ns + _REFUSED_PAUSE_NS
            self._warn(f"{NAME_OF[entry.message]}: autopilot cannot send it (result {result})", now_host_ns)

    def verify(self, delivered: Mapping[int, int], now_host_ns: int) -> None:
        """Compare what has come (running counts by message id) with what was granted; call about once a second."""
        for entry in self._wanted.values():
            count, since = delivered.get(entry.message, 0), entry.counted_host_ns
            if since and now_host_ns - since < _SECOND_NS:
                continue
            rate_hz = (count - entry.counted) * _SECOND_NS / (now_host_ns - since) if since else None
            entry.counted, entry.counted_host_ns = count, now_host_ns
            if rate_hz is not None:
                self.delivered_hz[entry.message] = rate_hz
                self._judge(entry, rate_hz, now_host_ns)
                if entry.message in self._inertial:
                    self._judge_mode(entry, rate_hz, now_host_ns)

    def notices(self) -> list[Notice]:
        """Take the sentences for the operator that have gathered."""
        taken = list(self._notices)
        self._notices.clear()
        return taken

    def _judge(self, entry: _RequestedRate, rate_hz: float, now_host_ns: int) -> None:
        granted_hz = 1e6 / entry.granted_us
        if self._integration_rate_hz and entry.message in self._inertial:
            granted_hz = min(granted_hz, self._integration_rate_hz)
        if rate_hz >= _ENOUGH * granted_hz:
            entry.fallen, entry.pause_ns = 0, _SECOND_NS
            return
        if not entry.settled or now_host_ns < entry.check_at_host_ns:
            return
        entry.fallen += 1
        entry.settled, entry.ask_at_host_ns = False, now_host_ns
        entry.pause_ns = min(2 * entry.pause_ns, _LONGEST_PAUSE_NS)
        if entry.fallen in (1, 3):
            remedy = self._remedy(granted_hz) if entry.fallen > 1 else "asking again"
            text = f"{NAME_OF[entry.message]} comes at {rate_hz:.0f}, not {granted_hz:.0f} Hz: {remedy}"
            self._warn(text, now_host_ns)

    def _judge_mode(self, entry: _RequestedRate, rate_hz: float, now_host_ns: int) -> None:
        """Say, and once a minute again, that what comes is too little for the mode, and what to change to what."""
        needed_hz = SAMPLES_PER_PERIOD * self._mode_hz
        entry.slow = entry.slow + 1 if 0 < rate_hz < needed_hz else 0  # silence is told elsewhere
        if entry.slow < _SLOW_VERDICTS or not self._slow_warnings.take(now_host_ns, entry.message):
            return
        wanted_hz = 1e6 / entry.wanted_us
        remedy = self._remedy(needed_hz) if wanted_hz >= needed_hz else f"set IMU_RATE {math.ceil(needed_hz)}, restart"
        text = f"{NAME_OF[entry.message]} {rate_hz:.0f} Hz, {self._mode_hz:.1f} Hz mode needs {needed_hz:.0f}: {remedy}"
        self._warn(text, now_host_ns)

    def _reduce(self, entry: _RequestedRate, now_host_ns: int) -> None:
        slower_us = math.ceil(entry.granted_us * _SLOWER / 1000.0) * 1000
        if self._loop_rate_hz:
            slower_us = max(slower_us, int(1250.0 / self._loop_rate_hz) * 1000)
        if entry.granted_us == entry.wanted_us:
            wanted_hz = 1e6 / entry.wanted_us
            text = f"{NAME_OF[entry.message]} at {wanted_hz:.0f} Hz denied: {self._remedy(wanted_hz)}"
            self._warn(text, now_host_ns)
        entry.granted_us, entry.ask_at_host_ns, entry.tries = min(slower_us, _SLOWEST_US), now_host_ns, 0

    def _remedy(self, rate_hz: float) -> str:
        if self._integration_rate_hz is not None and self._integration_rate_hz < rate_hz:
            return f"set IMU_INTEG_RATE {needed_integration_rate_hz(rate_hz)}, reboot"
        if self._integration_rate_hz is not None:
            return "link too slow? raise its baud rate and MAV_n_RATE"
        needed = needed_loop_rate_hz(rate_hz)
        if self._loop_rate_hz is not None and self._loop_rate_hz >= needed:
            return "link too slow? raise its baud rate"
        return f"set SCHED_LOOP_RATE {needed}, reboot"

    def _warn(self, text: str, now_host_ns: int) -> None:
        self._notices.append(Notice(Severity.WARNING, text, now_host_ns))
