"""Our side of the MAVLink parameter protocol: list, read, set, and make ourselves known to a new ground station.

The table is fixed after the start; an index is the row's place in it. Every value travels as REAL32, for which
byte-wise and C-cast encodings agree. A PARAM_SET is answered with the value in force (for one that needs a restart: the
one that will be), also when it was refused, and then a STATUSTEXT says why. Answers are paced, so that a slow radio
link is not flooded, and each index waits at most once, so that a flood of requests costs no memory.

QGroundControl on ArduPilot never asks other components for their parameters (QGC #13511), but fetches the rest as soon
as it sees one of them: unsolicited PARAM_VALUEs greet every ground station that appears.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import mavlink
from companion.params.persist import decimal32
from companion.params.settings import Settings, Tunable, tunables
from companion.rate_limiter import RateLimiter
from companion.records import Notice, ParameterChange
from companion.units import Severity

_SECOND_NS = 1_000_000_000  # by definition
_PACE_NS = 25_000_000  # 40 values a second: 1.5 kB/s of the link (choice)
_GREETINGS = 3  # convention: the table once, then two single values
_GONE_NS = 10 * _SECOND_NS  # chosen: heartbeats come every second: ten missed ones are a station that was closed
_ASKED_AGAIN_NS = 5 * _SECOND_NS  # chosen: longer than a ground station waits before it asks again
_MOST_STATIONS = 16  # bound of memory
_MOST_EVENTS = 64  # bound of memory
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_TYPE_MISMATCH = 7  # of MAV_PARAM_ERROR (MAVLink common.xml), which pymavlink 2.4.50 lacks


class Store(Protocol):
    """Where values are kept over a restart; must not block."""

    def keep(self, values: Mapping[str, float], /) -> None:
        """Have all these values stored soon."""
        ...

    def problems(self) -> list[str]:
        """Failures since the last call, a sentence each."""
        ...

    def close(self) -> None:
        """Store what waits, and end."""
        ...


@dataclass(slots=True)
class _Station:
    """A ground station: when it was heard last, and how often we have greeted it."""

    heard_host_ns: int = 0
    greeted: int = 0


class ParameterServer:
    """Serves the settings table; driven by heard messages and asked for what is due.

    ``settings`` are the values in force at the start. ``store`` is given all values that were set, by name, after each
    change; without it nothing is kept. ``stored`` are the values of earlier runs, which stay stored. ``reserved`` are
    component ids of others, which ours must not become. ``pending`` are values that were set since the service started
    and act from its next start on.
    """

    def __init__(
        self,
        settings: Settings,
        store: Store | None = None,
        stored: Mapping[str, float] | None = None,
        reserved: Collection[int] = (),
        pending: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.settings = settings
        self._next = settings  # with what acts from the next start on
        for name, value in pending.items():
            self._next = self._next.replace(name, value)
        self._reserved = reserved
        self.refused = 0
        self._component = settings.component_id
        self._rows: tuple[Tunable, ...] = tuple(tunables())
        self._index = {row.name: index for index, row in enumerate(self._rows)}
        self._values = self._next.values()
        self._store = store
        self._stored = dict(stored or {})
        self._waiting: deque[int] = deque()
        self._answered: dict[int, int] = {}
        self._twice: set[int] = set()
        self._errors: deque[Any] = deque(maxlen=_MOST_EVENTS)
        self._changes: list[ParameterChange] = []
        self._notices: deque[Notice] = deque(maxlen=_MOST_EVENTS)
        self._stations: dict[tuple[int, int], _Station] = {}
        self._pace = RateLimiter(_PACE_NS)

    # ------------------------------------------------------------------------------------------ hearing

    def hear(self, heard: Heard, system: int) -> None:
        """Take in a message; ``system`` is our own system id."""
        name = heard.name
        if name == "HEARTBEAT":
            self._greet(heard)
        elif name in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"):
            message = heard.message
            if message.target_system not in (0, system) or message.target_component not in (0, self._component):
                return
            self._greeted(heard)
            if name == "PARAM_REQUEST_LIST":
                self._append(range(len(self._rows)))
            elif name == "PARAM_REQUEST_READ":
                self._read(heard)
            else:
                self._set(heard)

    def _greet(self, heard: Heard) -> None:
        if heard.message.type != mavlink.MAV_TYPE_GCS:
            return
        sender = (heard.system, heard.component)
        if sender not in self._stations and len(self._stations) >= _MOST_STATIONS:
            del self._stations[min(self._stations, key=lambda key: self._stations[key].heard_host_ns)]
        station = self._stations.setdefault(sender, _Station())
        if heard.received_host_ns - station.heard_host_ns > _GONE_NS:
            station.greeted = 0
        station.heard_host_ns = heard.received_host_ns
        # the whole table once, as a station has few tries for what it lacks; then one value, in case all was lost
        if station.greeted < _GREETINGS:
            self._append(range(len(self._rows)) if station.greeted == 0 else (0,))
            station.greeted += 1

    def _greeted(self, heard: Heard) -> None:
        station = self._stations.get((heard.system, heard.component))
        if station is not None:
            station.greeted = _GREETINGS

    def _read(self, heard: Heard) -> None:
        message = heard.message
        index = message.param_index if message.param_index >= 0 else self._index.get(message.param_id, -1)
        if 0 <= index < len(self._rows):
            # whoever asks again has lost our answer, and most ground stations give up after a few tries
            if heard.received_host_ns - self._answered.get(index, -_ASKED_AGAIN_NS) < _ASKED_AGAIN_NS:
                self._twice.add(index)
            self._first(index)
        elif message.target_component == self._component:
            self._complain(heard, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)

    def _set(self, heard: Heard) -> None:
        message = heard.message
        index = self._index.get(message.param_id)
        if index is None:
            # a PARAM_SET to all components is most likely meant for the autopilot
            if message.target_component == self._component:
                self.refused += 1
                self._complain(heard, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)
                self._say(Severity.WARNING, f"no parameter '{message.param_id}'", heard.received_host_ns)
            return
        row = self._rows[index]
        value = decimal32(message.param_value)
        problem, error = self._problem(row, value), mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        if message.param_type != _REAL32:
            problem, error = f"{row.name} is REAL32, not type {message.param_type}", _TYPE_MISMATCH
        if problem is not None:
            self.refused += 1
            self._say(Severity.WARNING, problem, heard.received_host_ns)
            self._complain(heard, error)
        elif value != self._values[row.name]:
            self._accept(row, value, heard.received_host_ns)
        self._first(index)

    def _problem(self, row: Tunable, value: float) -> str | None:
        """Say why a value cannot be taken, None where it can."""
        problem = row.check(value)
        if problem is None:
            clash = self._next.replace(row.name, value).conflict(self._reserved)
            problem = None if clash is None else clash.text
        return problem

    def ask(self, name: str, value: float, now_host_ns: int) -> None:
        """Set a value for who is no ground station; these see it too, and the operator reads why it was refused."""
        index = self._index.get(name)
        problem = f"no parameter '{name}'" if index is None else self._problem(self._rows[index], value)
        if problem is not None or index is None:
            self.refused += 1
            self._say(Severity.WARNING, problem or "", now_host_ns)
            return
        if value != self._values[name]:
            self._accept(self._rows[index], value, now_host_ns)
        self._first(index)

    def _accept(self, row: Tunable, value: float, now_host_ns: int) -> None:
        self._values[row.name] = self._stored[row.name] = value
        self._next = self._next.replace(row.name, value)
        if row.live:
            self.settings = self.settings.replace(row.name, value)
            self._changes.append(ParameterChange(row.name, value, now_host_ns))
        else:
            self._say(Severity.INFO, f"{row.name} {value:g}: restart needed", now_host_ns)
        if self._store is not None:
            self._store.keep(dict(self._stored))

    def _complain(self, heard: Heard, error: int) -> None:
        message = heard.message
        index = getattr(message, "param_index", -1)
        self._errors.append(
            mavlink.MAVLink_param_error_message(heard.system, heard.component, message.param_id.encode(), index, error)
        )

    def _say(self, severity: int, text: str, now_host_ns: int) -> None:
        self._notices.append(Notice(severity, text, now_host_ns))

    # ------------------------------------------------------------------------------------------ telling

    def due(self, now_host_ns: int) -> Any | None:
        """The next message to send, if it is time for one."""
        for problem in () if self._store is None else self._store.problems():
            self._say(Severity.ERROR, problem, now_host_ns)
        if not (self._errors or self._waiting) or not self._pace.take(now_host_ns):
            return None
        if self._errors:
            return self._errors.popleft()
        index = self._waiting.popleft()
        self._answered[index] = now_host_ns
        if index in self._twice:
            self._twice.remove(index)
            self._append((index,))
        return self._value(index)

    def events(self) -> list[ParameterChange | Notice]:
        """Live changes, and then sentences for the operator, since the last call."""
        taken: list[ParameterChange | Notice] = [*self._changes, *self._notices]
        self._changes.clear()
        self._notices.clear()
        return taken

    def close(self) -> None:
        """Store what waits to be stored."""
        if self._store is not None:
            self._store.close()

    def _value(self, index: int) -> Any:
        row = self._rows[index]
        (value,) = struct.unpack("<f", struct.pack("<f", self._values[row.name]))
        return mavlink.MAVLink_param_value_message(row.name.encode(), value, _REAL32, len(self._rows), index)

    def _first(self, index: int) -> None:
        """Answer this one next: somebody waits for just it."""
        if index in self._waiting:
            self._waiting.remove(index)
        self._waiting.appendleft(index)

    def _append(self, indices: Iterable[int]) -> None:
        self._waiting.extend(index for index in indices if index not in self._waiting)
