"""A ground station on the autopilot's first link: pymavlink over UDP, in a thread; it keeps whatever it hears."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

AUTOPILOT, COMPANION = 1, 191
_BEAT_S = 1.0


@dataclass(frozen=True, slots=True)
class Heard:
    """One message and the host's monotonic time of its arrival."""

    at_ns: int
    message: Any

    @property
    def kind(self) -> str:
        """Name of the message."""
        return str(self.message.get_type())

    @property
    def component(self) -> int:
        """Who sent it."""
        return int(self.message.get_srcComponent())


class Station:
    """Listens until closed; commands wait for what they ask for."""

    def __init__(self, port: int) -> None:
        self._link = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{port}", source_system=255, source_component=190, dialect="ardupilotmega"
        )
        self._lock = threading.Lock()
        self._heard: list[Heard] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="station", daemon=True)
        self._thread.start()

    # ---------------------------------------------------------------------------------------- listening

    def _listen(self) -> None:
        beat_s = 0.0
        while not self._stop.is_set():
            message = self._link.recv_match(blocking=True, timeout=0.1)
            at_ns = time.monotonic_ns()
            if message is not None and message.get_type() != "BAD_DATA":
                with self._lock:
                    self._heard.append(Heard(at_ns, message))
            if time.monotonic() - beat_s > _BEAT_S and self._link.target_system:
                beat_s = time.monotonic()
                kind, none = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
                self.say(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, 4, 3))

    def heard(
        self, kind: str, component: int | None = None, since_ns: int = 0, until_ns: int | None = None
    ) -> list[Heard]:
        """Everything of one kind that has come, in order."""
        with self._lock:
            messages = list(self._heard)
        return [
            entry
            for entry in messages
            if entry.kind == kind
            and entry.at_ns >= since_ns
            and (until_ns is None or entry.at_ns < until_ns)
            and (component is None or entry.component == component)
        ]

    def counts(self, since_ns: int = 0) -> Counter[tuple[int, str]]:
        """How many of each kind came from each component."""
        with self._lock:
            return Counter((entry.component, entry.kind) for entry in self._heard if entry.at_ns >= since_ns)

    def texts(self, since_ns: int = 0) -> list[str]:
        """Status texts."""
        return [entry.message.text for entry in self.heard("STATUSTEXT", since_ns=since_ns)]

    def wait(
        self,
        kind: str,
        fits: Callable[[Any], bool] = lambda message: True,
        *,
        component: int | None = None,
        since_ns: int = 0,
        seconds: float = 5.0,
    ) -> Any | None:
        """The first message that fits, waiting for it as long as is stated."""
        ends = time.monotonic() + seconds
        while True:
            for entry in self.heard(kind, component, since_ns):
                if fits(entry.message):
                    return entry.message
            if time.monotonic() > ends:
                return None
            time.sleep(0.02)

    # ---------------------------------------------------------------------------------------- saying

    def say(self, message: Any) -> None:
        """Send a message."""
        with self._lock:
            self._link.mav.send(message)

    def command(
        self, command: int, *parameters: float, component: int = AUTOPILOT, tries: int = 3, seconds: float = 2.0
    ) -> int | None:
        """Send a COMMAND_LONG until it is acknowledged; its MAV_RESULT, or None."""
        filled = [float(value) for value in parameters] + [0.0] * (7 - len(parameters))
        for attempt in range(tries):
            began = time.monotonic_ns()
            self.say(mavlink.MAVLink_command_long_message(1, component, command, attempt, *filled))
            answer = self.wait("COMMAND_ACK", lambda ack: ack.command == command, since_ns=began, seconds=seconds)
            if answer is not None:
                return int(answer.result)
        return None

    def stream(self, kind: Any, rate_hz: float) -> None:
        """Ask the autopilot for a message on this link."""
        self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind.id, 1e6 / rate_hz)

    def read(self, name: str, component: int = AUTOPILOT, seconds: float = 2.0, tries: int = 3) -> float | None:
        """Read one parameter."""
        request = mavlink.MAVLink_param_request_read_message(1, component, name.encode(), -1)
        return self._value(request, name, component, seconds, tries)

    def set(self, name: str, value: float, component: int = AUTOPILOT, seconds: float = 2.0) -> float | None:
        """Set one parameter; what the component says is in force now."""
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        request = mavlink.MAVLink_param_set_message(1, component, name.encode(), value, kind)
        return self._value(request, name, component, seconds, 3)

    def _value(self, request: Any, name: str, component: int, seconds: float, tries: int) -> float | None:
        for _ in range(tries):
            began = time.monotonic_ns()
            self.say(request)
            answer = self.wait(
                "PARAM_VALUE",
                lambda entry: entry.param_id == name,
                component=component,
                since_ns=began,
                seconds=seconds,
            )
            if answer is not None:
                return float(answer.param_value)
        return None

    def close(self) -> None:
        """Stop listening."""
        self._stop.set()
        self._thread.join()
        self._link.close()
