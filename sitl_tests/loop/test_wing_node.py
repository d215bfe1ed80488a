"""The wing node's reference firmware on a pseudo-terminal, with pymavlink as the oracle of all that it sends."""

from __future__ import annotations

import itertools
import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.core.clock.bank import ClockBank
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, ImuBatch, RawChunk, Station, TimesyncReply
from sitl_tests.loop.wing_node import HOST, Node, build

pytestmark = [pytest.mark.realtime, pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")]
SHAKE_HZ, SHAKE_MPS2 = 5.0, 3.0  # host.c


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("node"))


@pytest.fixture
def start(program: Path) -> Iterator[Callable[..., Node]]:
    running: list[Node] = []

    def begin(**options: float) -> Node:
        running.append(Node(program, **options))
        return running[-1]

    yield begin
    for node in running:
        node.close()


def samples(node: Node) -> tuple[np.ndarray, np.ndarray]:
    """Stamps in s and vertical acceleration, in order of arrival."""
    messages = [message for message, _ in node.heard if message.get_type() == "HIGHRES_IMU"]
    return np.array([m.time_usec for m in messages]) * 1e-6, np.array([m.zacc for m in messages])


def undisturbed(start: Callable[..., Node], **options: float) -> Node:
    """A node that told of no loss, and what was heard until it told so.

    Its loop is a process here, and so is who reads its line: a busy machine may hold either up.
    """
    for _ in range(20):
        node = start(**options)
        node.listen(1.5)
        counter_indices = [k for k, (message, _) in enumerate(node.heard) if message.get_type() == "NAMED_VALUE_INT"]
        lost = {name: value for name, value in node.counters().items() if name != "line_bad"}
        if lost == {"loop_lost": 0, "line_lost": 0}:
            del node.heard[counter_indices[-1] :]
            return node
    pytest.fail(f"twenty nodes in a row lost readings, the last {lost}")


def test_samples_come_at_their_rate_whole_and_stamped_with_the_instant_they_belong_to(
    start: Callable[..., Node],
) -> None:
    node = undisturbed(start, rate_hz=1000)
    t_s, z = samples(node)
    assert node.kinds()["BAD_DATA"] == 0
    np.testing.assert_allclose(t_s, 0.0005 + 0.001 * np.arange(len(t_s)), atol=2e-6)
    came_s = [node.node_ns(at_ns) * 1e-9 for message, at_ns in node.heard if message.get_type() == "HIGHRES_IMU"]
    assert (np.array(came_s) > t_s).all()
    assert np.min(came_s - t_s) < 0.02  # the one that nothing held up
    # the value is a closed form of the true instant: the stamp is right where the value fits it
    np.testing.assert_allclose(z, -9.80665 + SHAKE_MPS2 * np.sin(2 * np.pi * SHAKE_HZ * t_s), atol=2e-4)
    last = next(message for message, _ in reversed(node.heard) if message.get_type() == "HIGHRES_IMU")
    assert (last.get_srcSystem(), last.get_srcComponent(), last.id, last.fields_updated) == (1, 200, 0, 0x3F)
    assert (last.xacc, last.yacc, last.ygyro, last.zgyro) == (0, 0, 0, 0)


def test_no_number_is_skipped_while_nothing_is_lost(start: Callable[..., Node]) -> None:
    node = start()
    for _ in range(10):
        node.ask_time()
        node.listen(0.1)
    steps = np.diff([message.get_seq() for message, _ in node.heard]) % 256
    assert set(steps.tolist()) == {1}


def test_averaged_readings_are_the_mean_at_the_middle(start: Callable[..., Node]) -> None:
    node = undisturbed(start, rate_hz=1000, average=4)
    t_s, z = samples(node)
    np.testing.assert_allclose(np.diff(t_s), 0.004, atol=2e-6)
    readings = t_s[:, None] + np.array([-1.5, -0.5, 0.5, 1.5]) * 0.001
    expected = -9.80665 + SHAKE_MPS2 * np.sin(2 * np.pi * SHAKE_HZ * readings).mean(1)
    np.testing.assert_allclose(z, expected, atol=2e-4)


def test_time_is_answered_once_inside_the_round_trip_and_mirrored(start: Callable[..., Node]) -> None:
    node = start(skew_ppm=200)
    rounds = []
    for _ in range(40):
        answers = node.ask_time()
        assert len(answers) == 1
        message, asked_ns, heard_ns = answers[0]
        assert tuple(message.get_msgbuf()[26:28]) == HOST, "addressed to who asked"
        # the answer was stamped between asking and hearing; its clock counts microseconds
        assert node.node_ns(asked_ns) - 1000 <= message.tc1 <= node.node_ns(heard_ns)
        rounds.append(heard_ns - asked_ns)
    print(f"round trip median {np.median(rounds) / 1e3:.0f} us, worst {max(rounds) / 1e3:.0f} us")


def test_only_questions_to_it_or_to_all_are_answered(start: Callable[..., Node]) -> None:
    node = start()
    assert len(node.ask_time(1, 200)) == 1
    assert len(node.ask_time(1, 0)) == 1
    assert node.ask_time(1, 201, within_s=0.1) == []
    assert node.ask_time(7, within_s=0.1) == []
    node.say(mavlink.MAVLink_timesync_message(123, 456))  # an answer of somebody else's
    node.listen(0.1)
    assert node.kinds()["TIMESYNC"] == 2


def test_questions_are_found_in_garbage_in_both_versions_and_damaged_ones_counted(start: Callable[..., Node]) -> None:
    node, rng = start(), random.Random(3)
    asked = mavlink.MAVLink_timesync_message(0, 77)
    for version_1 in (False, True):
        frame = bytes(asked.pack(node.packer, force_mavlink1=version_1))
        other = bytes(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(node.packer, force_mavlink1=version_1))
        node.write(rng.randbytes(40).replace(b"\xfd", b"").replace(b"\xfe", b"") + other + frame)
        node.listen(0.5)
    assert node.kinds()["TIMESYNC"] == 2
    bent = bytearray(asked.pack(node.packer))
    bent[12] ^= 0x40
    node.write(bytes(bent))
    node.listen(1.2)
    assert node.kinds()["TIMESYNC"] == 2
    assert node.counters()["line_bad"] == 1
    assert {message.type for message, _ in node.heard if message.get_type() == "HEARTBEAT"} == {mavlink.MAV_TYPE_IMU}


def lost_before_news(node: Node, name: str) -> list[tuple[int, int]]:
    """Each time that a counter was told: its value, and the readings that the stamps until then lack."""
    losses, last = [], None
    count = 0
    for message, _ in node.heard:
        if message.get_type() == "HIGHRES_IMU":
            last, count = message.time_usec, count + 1
        elif message.get_type() == "NAMED_VALUE_INT" and message.name == name and last is not None:
            losses.append((message.value, round(last * 1e-6 * node.rate_hz + 0.5) - count))
    return losses


def until_quiet(node: Node) -> None:
    """Listen until between two tellings nothing more was lost: the samples of all losses have come."""
    for _ in range(15):
        node.listen(2.2)
        newest_losses = [lost_before_news(node, name)[-2:] for name in ("loop_lost", "line_lost")]
        if all(len({value for value, _ in pair}) == 1 for pair in newest_losses):
            return
    pytest.fail(f"readings are lost on and on: {newest_losses}")


def test_a_loop_that_comes_late_loses_readings_and_counts_every_one(start: Callable[..., Node]) -> None:
    for _ in range(10):
        node = start(rate_hz=1000, stall_ms=150)  # the FIFO holds 64
        node.listen(4.5)
        if node.counters()["line_lost"] == 0:  # this reader was not held up
            break
    losses = lost_before_news(node, "loop_lost")
    assert losses[-1][0] >= 3 * (150 - 64 - 30)
    # the news may leave before the samples that show the newest loss
    assert all(before <= missing <= value for (before, _), (value, missing) in itertools.pairwise(losses))
    readings = np.rint(samples(node)[0] * node.rate_hz + 0.5)  # of the first to the one of each stamp
    lost_so_far = np.cumsum(np.diff(readings, prepend=0.0) - 1.0)
    assert {value for value, _ in losses[:-1]} <= set(lost_so_far), "whole losses, no reading more or less"
    assert node.counters()["line_lost"] == 0
    assert (np.diff(samples(node)[0]) > 0).all()


def test_a_line_that_is_not_read_costs_whole_samples(start: Callable[..., Node]) -> None:
    node = start(rate_hz=2000)
    node.listen(0.3)
    time.sleep(1.0)  # the terminal's buffer fills, then the node's queue, then the sensor's FIFO
    until_quiet(node)
    assert node.kinds()["BAD_DATA"] == 0, "no frame was cut"
    steps = np.diff([message.get_seq() for message, _ in node.heard]) % 256
    assert set(steps.tolist()) == {1}, "nothing that was numbered was lost"
    value, missing = lost_before_news(node, "line_lost")[-1]
    assert value > 500
    assert missing == value + node.counters()["loop_lost"]


def test_the_companion_keeps_the_nodes_time_within_its_bound(start: Callable[..., Node]) -> None:
    """The firmware against our own adapter and clock bank: stamps in host time, error against the node's true clock."""
    node, clock = start(skew_ppm=150), MonotonicClock()
    link = Link(0, "pty", _Terminal(node.line), clock)
    pilot = MavlinkAutopilot([link], load_airframe("nadir-2m"), Settings(), clock)
    greeting = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
    pilot.decoder.decode_chunk(RawChunk(0, clock.now_ns(), bytes(greeting)))
    bank, errors, bounds, count = ClockBank(), [], [], 0
    ends = time.monotonic() + 60.0
    while count < 5000 and time.monotonic() < ends:
        for record in pilot.poll(0.002):
            if isinstance(record, TimesyncReply):
                bank.exchange(record)
            elif isinstance(record, ImuBatch) and record.station is Station.LEFT:
                answer = bank.to_host(ClockName.NODE_LEFT, record.t_ns, record.received_host_ns)
                if isinstance(answer, tuple):
                    count += len(record.t_ns)
                    true_ns = record.t_ns / (1.0 + node.skew) + node.start_ns
                    errors.append(float(np.abs(answer[0] - true_ns).max()))
                    bounds.append(answer[1])
    state = bank.state(ClockName.NODE_LEFT, clock.now_ns())
    print(f"clock error median {np.median(errors[-200:]) / 1e3:.0f} us, bound {np.median(bounds) / 1e3:.0f} us")
    assert state.synced
    assert count >= 5000
    assert np.mean(np.array(errors) <= np.array(bounds)) >= 0.999
    assert np.median(errors[-200:]) < 0.3e6  # in the end; the first questions may have been held up on their way


class _Terminal:
    """The line's end as a transport of the adapter."""

    def __init__(self, line: int) -> None:
        self._line = line

    def fileno(self) -> int:
        return self._line

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        del now_host_ns
        try:
            return os.read(self._line, limit)
        except BlockingIOError:
            return b""

    def send(self, data: bytes) -> bool:
        return os.write(self._line, data) == len(data)

    def close(self) -> None:
        """The node's owner closes it."""
