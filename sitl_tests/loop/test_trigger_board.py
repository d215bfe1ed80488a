"""The trigger board's firmware, built for this machine, over a pseudo-terminal: protocol, refusals, punctuality."""

from __future__ import annotations

import dataclasses
import os
import pty
import shutil
import sys
import termios
import threading
import time
import tty
import types
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import call, create_autospec

import numpy as np
import pytest

from companion.adapters.triggers import serial_board
from companion.adapters.triggers.gpio import GpioTrigger
from companion.adapters.triggers.serial_board import BAUD, BoardClock, SerialBoardTrigger, lead_ns, opened, sealed
from companion.errors import DeviceError
from companion.records import Firing, TriggerPlan
from tools.bench.board import Board, build

pytestmark = pytest.mark.realtime
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


def _plan(plan_id: int, command_ns: int) -> TriggerPlan:
    return TriggerPlan(plan_id, Firing.PEAK, command_ns, command_ns, 0, 0.0, command_ns + 10**9, command_ns)


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("board"))


@pytest.fixture
def bench(firmware: Path, tmp_path: Path) -> Iterator[Board]:
    running = Board(firmware, tmp_path / "edges")
    yield running
    running.close()


@needs_compiler
def test_the_edge_comes_when_it_was_planned(bench: Board) -> None:
    """Planned against true edge, by the firmware's own look at the host's clock; a table for who reads with -s."""
    trigger = SerialBoardTrigger(bench.port)
    planned, fired_ns, refused, unheard = [], [], 0, 0
    for k in range(100):
        plan = _plan(k, time.monotonic_ns() + 2_000_000)
        while time.monotonic_ns() < plan.command_host_ns:
            time.sleep(0.0002)
        try:
            shot = trigger.fire(plan)
        except DeviceError as error:  # a busy machine let us sleep past the lead, or past the answer
            late = "late" in str(error)
            refused, unheard = refused + late, unheard + (not late)
            continue
        assert shot.plan_id == k
        planned.append(plan.command_host_ns + lead_ns(BAUD))
        fired_ns.append(shot.fired_host_ns)
        time.sleep(0.01)
    trigger.close()
    edges = bench.edges_ns()
    assert len(planned) <= len(edges) <= len(planned) + unheard, "what was refused was not fired"
    assert len(planned) > 50
    true = edges[np.abs(edges[:, None] - np.array(planned)).argmin(axis=0)]
    assert len(np.unique(true)) == len(planned)
    late_us = 1e-3 * (true - np.array(planned))
    report_us = 1e-3 * np.abs(true - np.array(fired_ns))
    for name, values in (("edge after plan", late_us), ("report against edge", report_us)):
        median, p99 = np.percentile(values, [50, 99])
        print(f"{name:20s} median {median:7.1f}  p99 {p99:7.1f}  max {values.max():7.1f} us")
    print(f"refused as too late: {refused} of 100, answer not heard in time: {unheard}")
    assert np.median(np.abs(late_us)) < 300.0
    assert np.median(report_us) < 300.0


@needs_compiler
def test_a_plan_that_comes_too_late_is_refused_and_does_not_fire(bench: Board) -> None:
    trigger = SerialBoardTrigger(bench.port)
    with pytest.raises(DeviceError, match="late"):
        trigger.fire(_plan(7, time.monotonic_ns() - 50_000_000))
    trigger.close()
    assert len(bench.edges_ns()) == 0


@needs_compiler
def test_garbage_and_wrong_checksums_are_answered_and_do_nothing(bench: Board) -> None:
    line = os.open(bench.port, os.O_RDWR | os.O_NOCTTY)
    os.set_blocking(line, False)
    tty.setraw(line)
    cases = {
        b"F 1 99999999999 1000*00\n": "! checksum",
        b"garbage\n": "! checksum",
        b"A" * 300 + b"\n": "! checksum",
        sealed("X 1"): "! unknown",
        sealed("F 1 99999999999 0"): "f 1 width",
        sealed("F 1 99999999999 1000 9"): "! unknown",
        sealed("V"): "v spanwise-trigger 1",
    }
    for sent, expected in cases.items():
        os.write(line, sent)
        assert " ".join(opened(_read_line(line))) == expected
    for k in range(5):
        os.write(line, sealed(f"F {k} {10**12 + k} 1000"))
        assert opened(_read_line(line)) == ["f", str(k), "ok" if k < 4 else "full"]
    os.close(line)


def _read_line(file: int) -> bytes:
    got, until = b"", time.monotonic() + 30.0
    while not got.endswith(b"\n"):
        assert time.monotonic() < until, f"no answer, only {got!r}"
        try:
            got += os.read(file, 1)
        except BlockingIOError:
            time.sleep(0.001)
    return got


@needs_compiler
def test_a_board_that_goes_away_is_a_device_error(bench: Board) -> None:
    trigger = SerialBoardTrigger(bench.port)
    bench.process.kill()
    bench.process.wait()
    with pytest.raises(DeviceError):
        trigger.fire(_plan(1, time.monotonic_ns()))


def test_a_port_that_is_not_there_is_named() -> None:
    with pytest.raises(DeviceError, match="/dev/none"):
        SerialBoardTrigger("/dev/none")


def test_a_port_that_babbles_without_an_end_of_line_is_no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another device on that name, or the wrong baud rate."""
    monkeypatch.setattr(serial_board, "_WAKE_S", 0.2)
    master, slave = pty.openpty()
    tty.setraw(slave)
    ends_s = time.monotonic() + 3.0

    def babble() -> None:
        while time.monotonic() < ends_s:
            os.write(master, b"\xfd" * 20)
            time.sleep(0.01)

    talk = threading.Thread(target=babble, daemon=True)
    talk.start()
    with pytest.raises(DeviceError, match="no trigger board answers"):
        SerialBoardTrigger(os.ttyname(slave))
    assert time.monotonic() < ends_s - 1.0
    ends_s = 0.0
    talk.join()
    os.close(slave)
    os.close(master)


def test_a_port_that_vanishes_while_it_is_opened_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of pyserial is no OSError then."""

    def vanishing(*_: object, **__: object) -> None:
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(serial_board.serial, "Serial", vanishing)
    with pytest.raises(DeviceError, match="cannot open trigger board on /dev/x"):
        SerialBoardTrigger("/dev/x")


@needs_compiler
@pytest.mark.parametrize("answer", [["1"], ["1", "2", "3"]])
def test_a_time_of_another_form_is_a_lost_answer(bench: Board, answer: list[str]) -> None:
    trigger = SerialBoardTrigger(bench.port)
    before = trigger.clock.offset(0)
    trigger._await = lambda _kind, _number: answer  # type: ignore[method-assign]
    trigger.exchange()
    assert trigger.clock.offset(0) == before
    trigger.close()


def test_the_board_clock_believes_short_ways_and_forgets_old_ones() -> None:
    clock, offset_ns = BoardClock(), 5_000_000_000
    clock.add(1_000_000, (1_400_000 + offset_ns) // 1000, (1_400_000 + offset_ns) // 1000, 1_500_000)
    clock.add(2_000_000, (2_010_000 + offset_ns) // 1000, (2_010_000 + offset_ns) // 1000, 2_020_000)
    estimated_ns, bound = clock.offset(2_020_000)
    assert abs(estimated_ns - offset_ns) <= bound
    assert bound < 11_000
    later, grown = clock.offset(2_020_000 + 10_000_000_000)
    assert later == estimated_ns
    assert grown == pytest.approx(bound + 300_000, rel=0.01)  # 30 ppm of 10 s


def test_the_host_asks_only_what_has_a_checksum() -> None:
    assert opened(sealed("t 3 12 13")) == ["t", "3", "12", "13"]
    assert opened(b"t 3 12 13*00\n") == []
    assert opened(b"t 3 12 13\n") == []


class _FakeRequest:
    def __init__(self) -> None:
        self.log: list[tuple[int, str, int]] = []
        self.released = False

    def set_value(self, line: int, value: str) -> None:
        self.log.append((line, value, time.monotonic_ns()))

    def release(self) -> None:
        self.released = True


def test_gpio_raises_the_line_and_lowers_it(monkeypatch: pytest.MonkeyPatch) -> None:
    request = _FakeRequest()
    library = types.SimpleNamespace(
        LineSettings=lambda **settings: settings,
        line=types.SimpleNamespace(
            Direction=types.SimpleNamespace(OUTPUT="out"), Value=types.SimpleNamespace(ACTIVE="on", INACTIVE="off")
        ),
        request_lines=lambda chip, consumer, config: request,
    )
    monkeypatch.setitem(sys.modules, "gpiod", library)
    trigger = GpioTrigger("/dev/gpiochip0", 17)
    shot = trigger.fire(_plan(3, 0))
    trigger.close()
    (line, on, up_ns), (_, off, down_ns) = request.log
    assert (line, on, off) == (17, "on", "off")
    assert down_ns - up_ns >= 500_000
    assert abs(shot.fired_host_ns - up_ns) < 5_000_000
    assert request.released


def test_gpio_speaks_to_the_real_library_as_it_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """No chip is here: the request alone is a stand-in, with the signatures of libgpiod's own binding."""
    gpiod = pytest.importorskip("gpiod")
    request = create_autospec(gpiod.LineRequest, instance=True)
    ask = create_autospec(gpiod.request_lines, return_value=request)
    monkeypatch.setattr(gpiod, "request_lines", ask)
    trigger = GpioTrigger("/dev/gpiochip0", 17, active_low=True)
    trigger.fire(_plan(3, 0))
    settings = ask.call_args.kwargs["config"][17]
    assert (settings.direction, settings.active_low) == (gpiod.line.Direction.OUTPUT, True)
    assert settings.output_value is gpiod.line.Value.INACTIVE
    on, off = gpiod.line.Value.ACTIVE, gpiod.line.Value.INACTIVE
    assert request.set_value.call_args_list == [call(17, on), call(17, off)]


@pytest.mark.parametrize("chip", ["/dev/null", "/dev/gpiochip77"])
def test_what_is_no_gpio_chip_is_named_by_the_real_library(chip: str) -> None:
    pytest.importorskip("gpiod")
    with pytest.raises(DeviceError, match=f"cannot take line 17 of {chip}"):
        GpioTrigger(chip, 17)


def test_gpio_without_its_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(DeviceError, match=r"spanwise\[gpio\]"):
        GpioTrigger("/dev/gpiochip0", 17)


@needs_compiler
def test_after_a_failure_the_boards_clock_is_read_anew_and_the_next_shot_comes(bench: Board) -> None:
    """A board that started again has another time: what was planned by the old one is late, or never comes."""
    trigger = SerialBoardTrigger(bench.port)
    trigger.clock = _moved(trigger.clock, -50_000_000, 0)
    with pytest.raises(DeviceError, match="late"):
        trigger.fire(_plan(1, time.monotonic_ns()))
    assert trigger.fire(_plan(2, time.monotonic_ns())).plan_id == 2
    trigger.close()


class Recorded(SerialBoardTrigger):
    """A trigger that notes the length of its questions for the time, and of the board's answers."""

    def __init__(self, port: str) -> None:
        self.asked: list[int] = []
        self.answered: list[int] = []
        super().__init__(port)

    def _send(self, text: str) -> None:
        if text.startswith("T"):
            self.asked.append(len(sealed(text)))
        super()._send(text)

    def _line(self) -> list[str]:
        words = super()._line()
        if words[:1] == ["t"]:
            self.answered.append(len(sealed(" ".join(words))))
        return words


@needs_compiler
def test_a_question_for_the_time_is_as_long_as_its_answer(bench: Board) -> None:
    """On a slow line a short question arrives sooner than a long answer: half the difference would be an offset."""
    trigger = Recorded(bench.port)
    trigger.close()
    assert len(trigger.asked) == len(trigger.answered) > 10
    assert np.abs(np.array(trigger.asked) - trigger.answered)[1:].max() <= 3  # digits more than in the last answer
    assert trigger.asked[-1] == trigger.answered[-1]


@pytest.mark.parametrize("baud", [57600, 115200])
def test_a_plan_s_line_arrives_within_the_lead_on_a_slow_line(baud: int) -> None:
    """A plan a month after both clocks began, eight data bits between a start and a stop bit."""
    line = sealed(f"F {(1 << 32) - 1} {31 * 86_400_000_000} 1000")
    assert lead_ns(baud) - 10 * len(line) * 1_000_000_000 // baud >= lead_ns(10**9) - 1000


@needs_compiler
def test_after_minutes_without_a_shot_the_board_is_asked_first(bench: Board) -> None:
    trigger = SerialBoardTrigger(bench.port)
    trigger.clock = _moved(trigger.clock, -12_000_000, 600_000_000_000)
    plan = _plan(1, time.monotonic_ns())
    shot = trigger.fire(plan)
    assert abs(shot.fired_host_ns - plan.command_host_ns - lead_ns(BAUD)) < 5_000_000
    trigger.close()


def _moved(clock: BoardClock, offset_ns: int, age_ns: int) -> BoardClock:
    """The exchanges of a clock, as old as that and with another offset."""
    moved = BoardClock()
    for exchange in clock._exchanges:
        at_ns, offset = exchange.at_host_ns - age_ns, exchange.offset_ns + offset_ns
        moved._exchanges.append(dataclasses.replace(exchange, at_host_ns=at_ns, offset_ns=offset))
    return moved
