"""Schedules of TIMESYNC and parameter requests to the vehicle."""

from __future__ import annotations

from companion.records import ClockName

_MS_NS = 1_000_000  # by definition
_HURRY_PERIOD_NS = 50 * _MS_NS  # chosen: twice the usual rate while a clock is unknown
_PERIOD_NS = 100 * _MS_NS  # chosen: ten exchanges a second fill the window of the clock with bounds
_DITHER = 0.4  # of a period: lest requests keep step with the autopilot's loop (choice)
_GOLDEN = 0.6180339887498949  # golden ratio less 1: its multiples fill the period evenly (by definition)
_HURRY_NS = 5_000 * _MS_NS  # chosen: a hundred exchanges settle a clock
_AWAITED_NS = 15 * _MS_NS  # chosen: answers of a wired link come within it; a later one is read at the next poll
_MOST_UNANSWERED = 5  # requests, then the answer is not waited for (choice)
_ASK_PERIOD_NS = 50 * _MS_NS  # chosen: twenty parameters a second flood no radio link
_RETRY_NS = 1_000 * _MS_NS  # chosen: a slow link has answered by then, or the request is lost
_TRIES = 5  # chosen: for each parameter: what is lost five times is not there
_REFRESH_NS = 30_000 * _MS_NS  # chosen: a parameter that a pilot changes is known half a minute later

NEEDED_PARAMETERS = (
    "INS_ACCEL_FILTER",
    "INS_GYRO_FILTER",
    "SCHED_LOOP_RATE",
    "RNGFND1_TYPE",
    "RNGFND1_ORIENT",
    "RNGFND1_MIN",
    "RNGFND1_MAX",
    *(f"INS_{notch}_{what}" for notch in ("HNTCH", "HNTC2") for what in ("ENABLE", "FREQ", "BW", "ATT", "HMNCS")),
    "IMU_INTEG_RATE",
)
"""What the pipeline goes by; adapters do not import it, so a test holds the two lists together."""


class TimesyncTimer:
    """About every 50 ms in the first 5 s and after a restart, then about every 100 ms.

    An autopilot answers from its loop. A question that always came at the same phase of that loop, as one does that
    waits for its messages, would always wait as long for its answer, and that wait would look like the way there. So
    the pauses are spread evenly by up to a fifth either way, and none of them is tied to what arrives:
    :attr:`next_host_ns` is to be waited for.
    """

    def __init__(self) -> None:
        self.next_host_ns = 0
        self._asked = 0
        self._last_host_ns: int | None = None
        self._hurry_until_host_ns: int | None = None
        self._missed: dict[ClockName, int] = {}
        self._awaited: set[ClockName] = set()

    def hurry(self, now_host_ns: int) -> None:
        """Ask often for a while: a clock restarted."""
        self._hurry_until_host_ns = now_host_ns + _HURRY_NS
        self.next_host_ns = min(self.next_host_ns, now_host_ns + _HURRY_PERIOD_NS)

    def due(self, now_host_ns: int) -> bool:
        """Whether to ask now."""
        if self._hurry_until_host_ns is None:
            self.hurry(now_host_ns)
        if now_host_ns < self.next_host_ns:
            return False
        hurried = self._hurry_until_host_ns is not None and now_host_ns < self._hurry_until_host_ns
        self._asked += 1
        spread = 1.0 + _DITHER * (self._asked * _GOLDEN % 1.0 - 0.5)  # low discrepancy: no two phases alike
        self.next_host_ns = now_host_ns + round((_HURRY_PERIOD_NS if hurried else _PERIOD_NS) * spread)
        self._last_host_ns = now_host_ns
        for clock in self._awaited:
            self._missed[clock] += 1
        self._awaited = {clock for clock, missed in self._missed.items() if missed < _MOST_UNANSWERED}
        return True

    def answered(self, clock: ClockName) -> None:
        """Take note of who answers."""
        self._missed[clock] = 0
        self._awaited.discard(clock)

    def awaiting(self, now_host_ns: int) -> bool:
        """Whether an answer may arrive at any moment, from somebody who used to answer (at first: anybody)."""
        if self._last_host_ns is None or now_host_ns - self._last_host_ns >= _AWAITED_NS:
            return False
        return bool(self._awaited) or not self._missed


class ParameterReader:
    """Asks for the needed parameters one by one, a few times each, and all again every 30 s to see changes."""

    def __init__(self, names: tuple[str, ...] = NEEDED_PARAMETERS) -> None:
        self._names = names
        self._asked: dict[str, int] = {}
        self._missing: dict[str, int] = dict.fromkeys(names, 0)
        self._last_host_ns: int | None = None
        self._refreshed_host_ns: int | None = None

    def restart(self) -> None:
        """Read everything again."""
        self._missing = dict.fromkeys(self._names, 0)
        self._asked.clear()

    def arrived(self, name: str) -> None:
        """Take note of an answer."""
        self._missing.pop(name, None)

    def due(self, now_host_ns: int) -> str | None:
        """Give the name to ask for now, if any."""
        if self._refreshed_host_ns is None or now_host_ns - self._refreshed_host_ns >= _REFRESH_NS:
            self._refreshed_host_ns = now_host_ns
            self.restart()
        if self._last_host_ns is not None and now_host_ns - self._last_host_ns < _ASK_PERIOD_NS:
            return None
        ready = [
            name
            for name, tries in self._missing.items()
            if tries < _TRIES and (name not in self._asked or now_host_ns - self._asked[name] >= _RETRY_NS)
        ]
        if not ready:
            return None
        # what this autopilot may not have must not keep what it has waiting
        name = min(ready, key=self._missing.__getitem__)
        self._missing[name] += 1
        self._asked[name] = self._last_host_ns = now_host_ns
        return name
