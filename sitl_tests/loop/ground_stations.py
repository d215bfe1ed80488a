"""Ground stations written with pymavlink after the habits of QGroundControl and MAVProxy, and the air between us.

The air carries frames in simulated time and loses a share of them, in both directions. QGroundControl beside an
ArduPilot asks no other component for its parameters; the first PARAM_VALUE that it sees of one makes it fetch the rest
by index, ten at a time, three seconds after the last arrival, five tries each. MAVProxy asks for the list, then once a
second for what is missing, and sets with three tries that wait for the value to come back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.parameter_server import ParameterServer, Store
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Record

S, MS = 1_000_000_000, 1_000_000
SYSTEM, COMPANION = 3, 191
STEP = 5 * MS


class TurnedClock:
    """A monotonic clock that moves only when it is told, or slept on."""

    def __init__(self) -> None:
        self.now = 100 * S

    def now_ns(self) -> int:
        return self.now

    def sleep_until(self, target_host_ns: int) -> None:
        self.now = max(self.now, target_host_ns)


class Wire:
    """A transport in memory: what goes out is a list of frames, what comes in a buffer."""

    def __init__(self) -> None:
        self.inbox = b""
        self.sent: list[bytes] = []

    def fileno(self) -> int:
        return -1

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        data, self.inbox = self.inbox[:limit], self.inbox[limit:]
        return data

    def send(self, data: bytes) -> bool:
        self.sent.append(data)
        return True

    def close(self) -> None:
        self.inbox = b""


class Station:
    """A ground station that hears PARAM_VALUE and STATUSTEXT and says hello once a second."""

    def __init__(self, system: int = 255, component: int = 190) -> None:
        self.packer = mavlink.MAVLink(None, system, component)
        self.outbox: list[bytes] = []
        self.values: dict[str, float] = {}
        self.indices: dict[int, str] = {}
        self.count: int | None = None
        self.arrived = 0
        self.types: set[int] = set()
        self.texts: list[str] = []
        self.errors: list[Any] = []
        self.heard: list[Any] = []
        self.greets = True
        self._hello_ns = 0

    def say(self, message: Any) -> None:
        self.outbox.append(bytes(message.pack(self.packer)))

    def hear(self, message: Any, now_ns: int) -> None:
        self.heard.append(message)
        kind = message.get_type()
        if message.get_srcComponent() != COMPANION:
            return
        if kind == "PARAM_VALUE":
            self.arrived += 1
            self.values[message.param_id] = message.param_value
            self.indices[message.param_index] = message.param_id
            self.count = message.param_count
            self.types.add(message.param_type)
            self.on_value(message, now_ns)
        elif kind == "STATUSTEXT":
            self.texts.append(message.text)
        elif kind == "PARAM_ERROR":
            self.errors.append(message)

    def on_value(self, message: Any, now_ns: int) -> None:
        pass

    def turn(self, now_ns: int) -> None:
        if self.greets and now_ns - self._hello_ns >= S:
            self._hello_ns = now_ns
            self.say(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    def missing(self) -> list[int]:
        return [index for index in range(self.count or 0) if index not in self.indices]

    def complete(self) -> bool:
        return self.count is not None and not self.missing()

    def ask_index(self, index: int) -> None:
        self.say(mavlink.MAVLink_param_request_read_message(SYSTEM, COMPANION, b"", index))

    def ask_name(self, name: str, component: int = COMPANION) -> None:
        self.say(mavlink.MAVLink_param_request_read_message(SYSTEM, component, name.encode(), -1))

    def ask_list(self, component: int = COMPANION) -> None:
        self.say(mavlink.MAVLink_param_request_list_message(SYSTEM, component))

    def set(
        self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32, component: int = COMPANION
    ) -> None:
        self.say(mavlink.MAVLink_param_set_message(SYSTEM, component, name.encode(), value, kind))


class QGroundControl(Station):
    """Fetches what it has seen one value of; a write waits a second for its value, three times."""

    def __init__(self) -> None:
        super().__init__()
        self.last_ns: int | None = None
        self.tries: dict[int, int] = {}
        self.writing: list[Any] = []

    def on_value(self, message: Any, now_ns: int) -> None:
        self.last_ns = now_ns
        self.writing = [entry for entry in self.writing if entry[0] != message.param_id]

    def write(self, name: str, value: float) -> None:
        self.writing.append([name, value, 0, 0])

    def turn(self, now_ns: int) -> None:
        super().turn(now_ns)
        if self.last_ns is not None and self.missing() and now_ns - self.last_ns >= 3 * S:
            self.last_ns = now_ns
            for index in [index for index in self.missing() if self.tries.get(index, 0) < 5][:10]:
                self.tries[index] = self.tries.get(index, 0) + 1
                self.ask_index(index)
        for entry in self.writing:
            name, value, tries, sent_ns = entry
            if tries < 3 and now_ns - sent_ns >= S:
                entry[2:] = [tries + 1, now_ns]
                self.set(name, value)


class MavProxy(Station):
    """``param fetch`` and ``param set`` as MAVProxy does them."""

    def __init__(self) -> None:
        super().__init__(component=230)
        self.fetched_ns: int | None = None
        self.setting: list[Any] = []
        self.failed: list[str] = []

    def fetch(self, now_ns: int) -> None:
        self.fetched_ns = now_ns
        self.ask_list()

    def put(self, name: str, value: float) -> None:
        self.setting.append([name, value, 0, 0])

    def on_value(self, message: Any, now_ns: int) -> None:
        self.setting = [
            entry
            for entry in self.setting
            if entry[0] != message.param_id or np.float32(entry[1]) != np.float32(message.param_value)
        ]

    def turn(self, now_ns: int) -> None:
        super().turn(now_ns)
        if self.fetched_ns is not None and now_ns - self.fetched_ns >= S:
            self.fetched_ns = now_ns
            if self.count is None:
                self.ask_list()
            for index in self.missing()[:10]:
                self.ask_index(index)
        for entry in list(self.setting):
            name, value, tries, sent_ns = entry
            if now_ns - sent_ns < S:
                continue
            if tries == 3:
                self.setting.remove(entry)
                self.failed.append(name)
            else:
                entry[2:] = [tries + 1, now_ns]
                self.set(name, value)


class Air:
    """Companion, an autopilot that only beats, and stations; frames between us and the stations are lost by chance."""

    def __init__(
        self,
        *stations: Station,
        loss: float = 0.0,
        seed: int = 1,
        settings: Settings | None = None,
        store: Store | None = None,
        stored_values: dict[str, float] | None = None,
    ) -> None:
        self.clock, self.wire = TurnedClock(), Wire()
        self.stations = list(stations)
        self.loss = loss
        self.rng = np.random.default_rng(seed)
        chosen = settings or Settings()
        self.pilot = MavlinkAutopilot(
            [Link(0, "memory", self.wire, self.clock)],
            load_airframe("nadir-2m"),
            chosen,
            self.clock,
            component=OnboardComponent(ParameterServer(chosen, store, stored_values)),
        )
        self.beats = mavlink.MAVLink(None, SYSTEM, 1)
        self.parser = mavlink.MAVLink(None)
        self.records: list[Record] = []
        self.carried = self.lost = 0
        self._beat_ns = 0

    def run(self, seconds: float) -> list[Record]:
        """Pass time; give the companion's records of it."""
        start, end = len(self.records), self.clock.now + round(seconds * S)
        while self.clock.now < end:
            self._downward()
            self._upward()
            self.clock.now += STEP
            self.records += self.pilot.poll(0.0)
        return self.records[start:]

    def until(self, met: Any, at_most_s: float) -> float:
        """Run until a condition holds; give the seconds it took."""
        began = self.clock.now
        while not met() and self.clock.now - began < at_most_s * S:
            self.run(0.1)
        assert met(), f"not within {at_most_s} s"
        return (self.clock.now - began) / S

    def _upward(self) -> None:
        if self.clock.now - self._beat_ns >= S:
            self._beat_ns = self.clock.now
            beat = mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
            self.wire.inbox += bytes(beat.pack(self.beats))
        for station in self.stations:
            station.turn(self.clock.now)
            frames, station.outbox = station.outbox, []
            self.wire.inbox += b"".join(frame for frame in frames if self._through())

    def _downward(self) -> None:
        frames, self.wire.sent = self.wire.sent, []
        for station in self.stations:
            for frame in frames:
                if self._through():
                    (message,) = self.parser.parse_buffer(frame) or [None]
                    station.hear(message, self.clock.now)

    def _through(self) -> bool:
        self.carried += 1
        gone = bool(self.rng.random() < self.loss)
        self.lost += gone
        return not gone
