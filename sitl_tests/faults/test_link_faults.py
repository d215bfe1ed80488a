"""Links that are mistyped, lost, unplugged, flooded or refused: a clear word, no blocking, and back again."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import re
import select
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.link.link import CHUNK_BYTES, Link, open_link
from companion.adapters.mavlink.link.reconnect import Backoff
from companion.adapters.mavlink.link.tcp import TcpClient, TcpServer
from companion.adapters.mavlink.link.udp import UdpIn, UdpOut
from companion.errors import LinkDown, LinkError
from sitl_tests.ports import free_port

S = 1_000_000_000


class RealClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, target_host_ns: int) -> None:
        time.sleep(max(0, target_host_ns - self.now_ns()) / S)


class Held:
    """Closes what a test opened."""

    def __init__(self) -> None:
        self.stack = contextlib.ExitStack()

    def link(self, spelling: str, number: int = 0) -> Link:
        link = open_link(spelling, RealClock(), number)
        self.stack.callback(link.close)
        return link

    def udp(self) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stack.callback(made.close)
        made.bind(("127.0.0.1", 0))
        made.settimeout(2.0)
        return made

    def listener(self, port: int = 0) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.stack.callback(made.close)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(("127.0.0.1", port))
        made.listen(1)
        made.settimeout(2.0)
        return made


@pytest.fixture
def held() -> Iterator[Held]:
    keeper = Held()
    with keeper.stack:
        yield keeper


def beat(component: int, system: int = 1) -> bytes:
    """A heartbeat."""
    return bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, system, component)))


def listening(held: Held) -> tuple[Link, int]:
    """A udpin link on a port of the system's choice."""
    transport = UdpIn("127.0.0.1", 0)
    held.stack.callback(transport.close)
    return Link(0, "udpin", transport, RealClock()), transport.port


def read(link: Link, least: int = 1, within_s: float = 3.0) -> bytes:
    """Bytes that arrive until ``least`` bytes are there."""
    data, end = b"", time.monotonic() + within_s
    while len(data) < least and time.monotonic() < end:
        chunk = link.read()
        if chunk is not None:
            data += chunk.data
        elif link.fileno() >= 0:
            select.select([link], [], [], 0.05)
        else:
            time.sleep(0.01)
    return data


@pytest.mark.parametrize(
    ("spelling", "says"),
    [
        ("", "not a connection"),
        ("14550", "not a connection"),
        ("udpin", "host and a port"),
        ("udpin:14550", "host and a port"),
        ("udpin:127.0.0.1:high", "host and a port"),
        ("udpin:127.0.0.1:70000", "a port is at most 65535"),
        ("udpin:203.0.113.1:14550", "0.0.0.0"),
        ("tcp:127.0.0.1:1", "start the autopilot"),
        ("tcpin:203.0.113.1:5760", "203.0.113.1"),
        ("/dev/no-such-device,57600", "no such device"),
        ("/dev/ttyS0,fast", "baud rate"),
        ("http://127.0.0.1:80", "not a connection"),
    ],
)
def test_a_connection_that_cannot_be_opened_says_what_to_do(spelling: str, says: str) -> None:
    with pytest.raises(LinkError, match=re.escape(says)):
        open_link(spelling, RealClock())


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
def test_a_taken_port_names_the_likely_holder(held: Held, scheme: str) -> None:
    holder: UdpIn | TcpServer = UdpIn("127.0.0.1", 0) if scheme == "udpin" else TcpServer("127.0.0.1", 0)
    held.stack.callback(holder.close)
    with pytest.raises(LinkError, match="the port is taken; stop the other program"):
        open_link(f"{scheme}:127.0.0.1:{holder.port}", RealClock())


def test_a_listener_learns_its_peers_and_tells_all_of_them(held: Held) -> None:
    link, port = listening(held)
    assert not link.write(b"nobody yet")
    assert link.unsent == 1
    pilot, node = held.udp(), held.udp()
    frames = [beat(1), beat(200)]
    for sender, frame in zip((pilot, node), frames, strict=True):
        sender.sendto(frame, ("127.0.0.1", port))
    assert read(link, len(b"".join(frames))) == b"".join(frames)
    assert link.write(b"hello")
    assert pilot.recv(100) == node.recv(100) == b"hello"


def test_invented_peers_do_not_grow_without_bound_nor_push_out_who_speaks(held: Held) -> None:
    transport = UdpIn("127.0.0.1", 0)
    held.stack.callback(transport.close)
    pilot = held.udp()
    for _ in range(40):
        held.udp().sendto(beat(77), ("127.0.0.1", transport.port))
        pilot.sendto(beat(1), ("127.0.0.1", transport.port))
        time.sleep(0.001)
        transport.receive(CHUNK_BYTES, 0)
    assert len(transport.peers) <= 16
    assert pilot.getsockname() in transport.peers


def test_a_peer_that_goes_away_disturbs_nobody(held: Held) -> None:
    link, port = listening(held)
    gone, stays = held.udp(), held.udp()
    for peer in (gone, stays):
        peer.sendto(beat(1), ("127.0.0.1", port))
    read(link, 2 * len(beat(1)))
    gone.close()
    for _ in range(5):
        assert link.write(b"beat")
        assert stays.recv(10) == b"beat"
    stays.sendto(b"more", ("127.0.0.1", port))
    assert read(link, 4) == b"more"


def test_calling_before_anybody_listens_goes_on_when_they_come(held: Held) -> None:
    port = free_port(socket.SOCK_STREAM)
    link = held.link(f"udpout:127.0.0.1:{port}")
    assert link.speaks_first
    for _ in range(3):
        link.write(b"knock")
        assert link.read() is None
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    held.stack.callback(vehicle.close)
    vehicle.bind(("127.0.0.1", port))
    vehicle.settimeout(2.0)
    link.write(b"knock")
    _, caller = vehicle.recvfrom(100)
    vehicle.sendto(b"yes", caller)
    assert read(link, 3) == b"yes"


@pytest.mark.parametrize("scheme", ["udpout", "tcp"])
def test_a_host_whose_name_nobody_knows_yet_is_waited_for(
    held: Held, monkeypatch: pytest.MonkeyPatch, scheme: str
) -> None:
    """A companion that boots before its network; asked at the start it is told."""
    names: list[str] = []  # fills when the network comes up

    def resolver(_: str) -> str:
        if not names:
            raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
        return names[0]

    monkeypatch.setattr(socket, "gethostbyname", resolver)
    server = held.udp() if scheme == "udpout" else held.listener()
    spelling = f"{scheme}:autopilot.local:{server.getsockname()[1]}"
    with pytest.raises(LinkDown, match=r"autopilot\.local' is not known"):
        open_link(spelling, RealClock())
    link = open_link(spelling, RealClock(), may_be_down=True)
    held.stack.callback(link.close)
    for _ in range(20):
        assert link.read() is None
        assert not link.write(b"hello")
        time.sleep(0.01)
    names.append("127.0.0.1")
    begin = time.monotonic()
    while not link.write(b"hello"):
        link.read()
        assert time.monotonic() - begin < 5.0
        time.sleep(0.01)


def test_a_silent_host_may_have_another_address_by_now(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """A laptop that got a new lease: its name is asked for again once it has been silent for 8 s."""
    names = ["127.0.0.2"]
    monkeypatch.setattr(socket, "gethostbyname", lambda _: names[0])
    laptop = held.udp()
    laptop.settimeout(0.2)
    link = UdpOut("laptop.local", laptop.getsockname()[1])
    held.stack.callback(link.close)
    names[0] = "127.0.0.1"
    for at_s in (1.0, 7.0):
        link.receive(65536, round(at_s * 1e9))
        link.send(b"hello")
    with pytest.raises(TimeoutError):
        laptop.recv(100)
    for at_s in (9.0, 20.0):  # the name is looked up in a thread
        link.receive(65536, round(at_s * 1e9))
        time.sleep(0.2)
    link.send(b"hello")
    assert laptop.recv(100) == b"hello"


def test_a_flood_is_read_in_bounded_chunks_and_read_never_blocks(held: Held) -> None:
    link, port = listening(held)
    flooder = held.udp()
    for _ in range(2000):
        flooder.sendto(bytes(1000), ("127.0.0.1", port))
    sizes = []
    while (chunk := link.read()) is not None:
        sizes.append(len(chunk.data))
    assert sizes
    assert max(sizes) <= 2 * CHUNK_BYTES
    begin = time.monotonic()
    assert link.read() is None
    assert time.monotonic() - begin < 0.1


def test_the_largest_datagram_arrives_whole(held: Held) -> None:
    link, port = listening(held)
    sender = held.udp()
    for letter in (b"a", b"b"):
        sender.sendto(letter * 65_507, ("127.0.0.1", port))
    assert read(link, 131_014) == b"a" * 65_507 + b"b" * 65_507


def test_several_links_are_waited_for_at_once(held: Held) -> None:
    (silent, _), (addressed, port) = listening(held), listening(held)
    held.udp().sendto(b"second", ("127.0.0.1", port))
    ready, _, _ = select.select([silent, addressed], [], [], 2.0)
    assert ready == [addressed]


def test_a_lost_tcp_connection_comes_back(held: Held) -> None:
    server = held.listener()
    port = server.getsockname()[1]
    link = held.link(f"tcp:127.0.0.1:{port}")
    first, _ = server.accept()
    first.sendall(b"one")
    assert read(link, 3) == b"one"
    first.close()
    server.close()
    assert read(link, 1, within_s=0.3) == b""
    assert link.fileno() == -1
    assert not link.write(b"lost")
    again = held.listener(port)
    begin = time.monotonic()
    assert read(link, 1, within_s=0.0) == b""
    while link.fileno() < 0 and time.monotonic() - begin < 5:
        link.read()
        time.sleep(0.01)
    second, _ = again.accept()
    held.stack.callback(second.close)
    second.sendall(b"two")
    assert read(link, 3) == b"two"
    assert link.write(b"back")
    assert second.recv(10) == b"back"


def test_a_tcp_server_that_is_not_up_is_waited_for_without_blocking(held: Held) -> None:
    port = free_port(socket.SOCK_STREAM)
    with pytest.raises(LinkDown, match="nothing listens there"):
        open_link(f"tcp:127.0.0.1:{port}", RealClock())
    begin = time.monotonic()
    link = open_link(f"tcp:127.0.0.1:{port}", RealClock(), may_be_down=True)
    held.stack.callback(link.close)
    assert read(link, 1, within_s=0.1) == b""
    assert (link.fileno(), link.write(b"lost")) == (-1, False)
    assert time.monotonic() - begin < 1.0
    server = held.listener(port)
    while link.fileno() < 0 and time.monotonic() - begin < 5:
        link.read()
        time.sleep(0.01)
    peer, _ = server.accept()
    held.stack.callback(peer.close)
    peer.sendall(b"up")
    assert read(link, 2) == b"up"


def test_a_tcp_peer_that_does_not_read_blocks_nothing_and_takes_bounded_memory(held: Held) -> None:
    server = held.listener()
    link = held.link(f"tcp:127.0.0.1:{server.getsockname()[1]}")
    peer, _ = server.accept()
    held.stack.callback(peer.close)
    begin, refused = time.monotonic(), 0
    for _ in range(20_000):
        refused += not link.write(bytes(1000))
    assert refused > 0
    assert link.unsent == refused
    assert time.monotonic() - begin < 5.0


def test_a_tcp_listener_takes_the_next_client(held: Held) -> None:
    transport = TcpServer("127.0.0.1", 0)
    held.stack.callback(transport.close)
    link = Link(0, "tcpin", transport, RealClock())
    for word in (b"first", b"second"):
        with socket.create_connection(("127.0.0.1", transport.port), timeout=2) as client:
            client.sendall(word)
            assert read(link, len(word)) == word
            assert link.write(b"ok")
            assert client.recv(10) == b"ok"
        assert read(link, 1, within_s=0.1) == b""


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="an option of Linux")
def test_a_client_that_vanished_makes_room_in_seconds(held: Held) -> None:
    """No test can pull the cable out of a loopback; the system is told how long to wait."""
    transport = TcpServer("127.0.0.1", 0)
    held.stack.callback(transport.close)
    client = socket.create_connection(("127.0.0.1", transport.port), timeout=2)
    held.stack.callback(client.close)
    begin = time.monotonic()
    listener = transport.fileno()
    while transport.fileno() == listener:
        transport.receive(10, 0)
        assert time.monotonic() - begin < 2.0
    with socket.socket(fileno=os.dup(transport.fileno())) as taken:
        assert taken.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert taken.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 5000
        assert taken.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) <= 2


def test_a_network_that_is_away_is_asked_ever_less_often(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """No TCP call leads to a broadcast address: it fails at once, and is no connection."""
    client, calls = TcpClient("255.255.255.255", 5760, may_be_down=True), list[int]()
    held.stack.callback(client.close)
    make = socket.socket

    def counted(*words: int) -> socket.socket:
        calls.append(now_ns)
        return make(*words)

    monkeypatch.setattr("companion.adapters.mavlink.link.tcp.socket.socket", counted)
    for now_ns in range(0, 60_000_000_000, 50_000_000):
        client.receive(10, now_ns)
        assert client.fileno() < 0
    assert 8 <= len(calls) <= 14, "0.25 s, then twice as long each time, up to 8 s"


def test_a_call_that_nobody_takes_is_given_up_and_made_again(held: Held) -> None:
    """The system alone tries again after one second, three, seven and so on up to a minute."""
    server = held.listener()
    address = server.getsockname()
    callers = [socket.socket() for _ in range(4)]
    for caller in callers:
        caller.setblocking(False)
        caller.connect_ex(address)
    time.sleep(0.1)
    client = TcpClient(*address, may_be_down=True)
    held.stack.callback(client.close)
    client.receive(10, 0)
    client.receive(10, 2_900_000_000)
    client.receive(10, 3_100_000_000)
    for caller in callers:
        caller.close()
    server.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            server.accept()[0].close()
    begin = time.monotonic()
    while client.fileno() < 0:
        client.receive(10, 4_000_000_000)
        assert time.monotonic() - begin < 0.6
        time.sleep(0.005)


def test_a_serial_device_that_is_unplugged_comes_back(held: Held, tmp_path: Path) -> None:
    node = tmp_path / "ttyACM0"

    def plug() -> int:
        master, slave = pty.openpty()
        node.unlink(missing_ok=True)
        node.symlink_to(os.ttyname(slave))
        os.set_blocking(master, False)
        plugged.append(slave)
        return master

    plugged: list[int] = []
    master = plug()
    link = held.link(f"{node},115200")
    frame = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
    os.write(master, frame)
    assert read(link, len(frame)) == frame
    assert read(link, 1, within_s=0.1) == b""  # silence is no loss
    assert link.fileno() >= 0
    assert link.write(b"up")
    assert os.read(master, 10) == b"up"
    os.close(plugged.pop())
    os.close(master)
    read(link, 1, within_s=0.2)
    assert link.fileno() == -1
    assert not link.write(b"gone")
    master = plug()
    begin = time.monotonic()
    while link.fileno() < 0 and time.monotonic() - begin < 5:
        link.read()
        time.sleep(0.01)
    os.write(master, frame)
    assert read(link, len(frame)) == frame
    os.close(plugged.pop())
    os.close(master)


def test_pauses_double_up_to_eight_seconds_and_start_over() -> None:
    backoff, tries = Backoff(), []
    for step in range(6000):
        if backoff.due(step * 10_000_000):
            tries.append(step / 100)
    assert tries[:6] == [0, 0.25, 0.75, 1.75, 3.75, 7.75]
    assert {round(b - a, 3) for a, b in itertools.pairwise(tries[7:])} == {8.0}
    backoff.succeeded()
    assert backoff.due(10**12)
    assert backoff.due(10**12 + 250_000_000)
