"""A trigger board on a serial port: the plan travels ahead, the board raises the line at an instant of its own clock.

The line protocol is in ``tools/trigger_board/README.md``, the reference firmware beside it.
"""

from __future__ import annotations

import contextlib
import termios
import time
from collections import deque
from dataclasses import dataclass

import serial

from companion.errors import DeviceError
from companion.records import Shot, TriggerPlan

BAUD = 115200  # of a board on a real serial line that is told no other (choice)
_LINK_NS = 4_000_000  # chosen: a slow USB link's time for a line
_PLAN_BITS = 400  # on the wire: a plan's line of at most 40 bytes, each with start and stop bit (derived)
_ANSWER_S = 0.05  # chosen: many times what a slow USB link needs for a line
_WAKE_S = 3.0  # chosen: boards whose boot loader waits start within two seconds
_FIRST_EXCHANGES = 24  # before the first shot: the quickest of them bounds the offset (choice)
_EXCHANGES_ANEW = 4  # chosen: after a failure, which a next shot should not wait for
_EXCHANGES = 32  # chosen: newest exchanges that the clock rests on: quick ones enough, and young
_OLDEST_NS = 1_000_000_000  # chosen: an offset that is older may be off by 30 us; the board is asked before a shot
_DRIFT = 30e-6  # a crystal's skew: what an old exchange loses per second of age (choice)
_ANSWER_TIMES = 2  # convention: those of an exchange, received and sent
_LONGEST_LINE = 256  # bytes: several times the longest of the protocol; what never ends a line is no board (choice)
_WIDTH_US = 1000  # chosen: long enough for any camera's trigger input


def lead_ns(baud: int) -> int:
    """Time from the call of ``fire`` to the edge, in which the plan's line arrives; a constant latency, learned."""
    return _LINK_NS + _PLAN_BITS * 1_000_000_000 // baud


@dataclass(frozen=True, slots=True)
class BoardExchange:
    """One exchange of times with the board: offset (board minus host), and half the round-trip time, ns."""

    at_host_ns: int
    offset_ns: int
    half_way_ns: int


class BoardClock:
    """Offset of the board's clock by its best recent exchange: the one of least round trip plus drift since then."""

    def __init__(self) -> None:
        self._exchanges: deque[BoardExchange] = deque(maxlen=_EXCHANGES)

    def is_stale(self, now_host_ns: int) -> bool:
        """Whether no exchange is recent."""
        return not self._exchanges or now_host_ns - self._exchanges[-1].at_host_ns > _OLDEST_NS

    def add(self, asked_ns: int, received_us: int, sent_us: int, answered_ns: int) -> None:
        """Take the four stamps of one exchange."""
        way_ns = (answered_ns - asked_ns) - 1000 * (sent_us - received_us)
        offset_ns = 1000 * received_us - asked_ns + 1000 * sent_us - answered_ns
        self._exchanges.append(BoardExchange((asked_ns + answered_ns) // 2, offset_ns // 2, max(way_ns, 0) // 2))

    def offset(self, now_host_ns: int) -> tuple[int, int]:
        """Board minus host time, and its bound, ns.

        Raises
        ------
        DeviceError
            The board has never told its time.
        """
        if not self._exchanges:
            raise DeviceError("the trigger board has not told its time")
        bounds = [(e.half_way_ns + int(_DRIFT * abs(now_host_ns - e.at_host_ns)), e.offset_ns) for e in self._exchanges]
        bound_ns, offset_ns = min(bounds)
        return offset_ns, bound_ns


class SerialBoardTrigger:
    """Implements :class:`companion.ports.Trigger` over a serial port.

    ``port`` is the device's name; ``baud`` is of a real serial line, USB CDC does not care.

    Raises
    ------
    DeviceError
        The port cannot be opened, or no trigger board answers on it.
    """

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self._port, self._baud, self._asked = port, baud, 0
        self._open()

    def _open(self) -> None:
        """Open the port, find the board and read its clock."""
        try:
            self._serial = serial.Serial(self._port, self._baud, timeout=_ANSWER_S, write_timeout=_ANSWER_S)
        except (OSError, ValueError, termios.error) as error:
            raise DeviceError(f"cannot open trigger board on {self._port}: {error}") from error
        with contextlib.suppress(NotImplementedError, OSError, ValueError):
            self._serial.set_low_latency_mode(True)
        self.lead_ns = lead_ns(self._baud)
        self.clock = BoardClock()
        self._answer_length = 0
        self._greet()
        for _ in range(_FIRST_EXCHANGES):
            self.exchange()

    def fire(self, plan: TriggerPlan) -> Shot:
        """Have the line raised ``lead_ns`` after the planned command, and say when the board did it, in host time.

        Raises
        ------
        DeviceError
            The board refused the plan (too late, its queue is full), or did not answer. Its clock is read anew then,
            for it may have started again; a port that is gone is opened again.
        """
        try:
            return self._fired(plan)
        except DeviceError:
            with contextlib.suppress(DeviceError):
                self._recover()
            raise

    def _fired(self, plan: TriggerPlan) -> Shot:
        if self.clock.is_stale(time.monotonic_ns()):
            self.exchange()
        target_ns = plan.command_host_ns + self.lead_ns
        offset_ns, _ = self.clock.offset(time.monotonic_ns())
        wanted = plan.plan_id % (1 << 32)
        board_us = (target_ns + offset_ns + 500) // 1000
        if board_us < 0:  # the protocol has no negative times
            raise DeviceError(f"trigger board refused plan {plan.plan_id}: late (before the board was started)")
        self._send(f"F {wanted} {board_us} {_WIDTH_US}")
        verdict = self._await("f", wanted)
        if verdict[0] != "ok":
            raise DeviceError(f"trigger board refused plan {plan.plan_id}: {verdict[0]}")
        edge_us = _number(self._await("E", wanted)[0])
        shot = Shot(plan.plan_id, plan.command_host_ns, 1000 * edge_us - offset_ns)
        self.exchange()
        return shot

    def _recover(self) -> None:
        """Withdraw what waits in the board, and read its clock anew."""
        try:
            self._send("C")
        except DeviceError:
            self._serial.close()
            self._open()
            return
        self.clock = BoardClock()
        for _ in range(_EXCHANGES_ANEW):
            self.exchange()

    def exchange(self) -> None:
        """Ask the board for its time once; a lost answer is no error.

        The question is as long as the answer: of a slow line's two ways neither then takes longer. The first question,
        when no length is known yet, tells nothing else.
        """
        self._asked += 1
        question = f"T {self._asked}"
        padded = question.replace(" ", " " * max(1 + self._answer_length - len(question), 1))
        asked_ns = time.monotonic_ns()
        self._send(padded)
        with contextlib.suppress(DeviceError):
            answer = self._await("t", self._asked)
            answered_ns = time.monotonic_ns()
            if len(answer) != _ANSWER_TIMES:
                return
            received, sent = answer
            if self._answer_length:
                self.clock.add(asked_ns, _number(received), _number(sent), answered_ns)
            self._answer_length = len(f"t {self._asked} {received} {sent}")

    def close(self) -> None:
        """Forget what waits, release the port."""
        with contextlib.suppress(DeviceError):
            self._send("C")
        self._serial.close()

    def _greet(self) -> None:
        """Some boards restart when the port is opened: ask until it answers."""
        until_ns = time.monotonic_ns() + int(_WAKE_S * 1e9)
        while time.monotonic_ns() < until_ns:
            self._send("V")
            words = self._line()
            if words[:2] == ["v", "spanwise-trigger"]:
                return
        self._serial.close()
        raise DeviceError(f"no trigger board answers on {self._port}")

    def _await(self, kind: str, number: int) -> list[str]:
        """Words after kind and number of the answer; lines that answer something else are passed over."""
        until_ns = time.monotonic_ns() + int(_ANSWER_S * 1e9) + self.lead_ns
        while time.monotonic_ns() < until_ns:
            words = self._line()
            if len(words) > 2 and words[0] == kind and words[1] == str(number):
                return words[2:]
        raise DeviceError(f"trigger board on {self._port} does not answer")

    def _send(self, text: str) -> None:
        try:
            self._serial.write(sealed(text))
        except OSError as error:
            raise DeviceError(f"trigger board on {self._port} is gone: {error}") from error

    def _line(self) -> list[str]:
        try:
            return opened(self._serial.read_until(b"\n", _LONGEST_LINE))
        except OSError as error:
            raise DeviceError(f"trigger board on {self._port} is gone: {error}") from error


def sealed(text: str) -> bytes:
    """A line of the protocol with its checksum."""
    return f"{text}*{_checksum(text.encode()):02X}\n".encode()


def opened(line: bytes) -> list[str]:
    """Words of a line; none if its checksum is wrong."""
    text, star, check = line.strip().rpartition(b"*")
    if not star or check.upper() != f"{_checksum(text):02X}".encode():
        return []
    return text.decode("ascii", errors="replace").split()


def _checksum(text: bytes) -> int:
    total = 0
    for byte in text:
        total ^= byte
    return total


def _number(word: str) -> int:
    if not word.isdigit():
        raise DeviceError(f"trigger board answered '{word}' where a time was due")
    return int(word)
