"""Our bulk decoder against pymavlink, on the same bytes in the same run: in memory and over loopback UDP."""

from __future__ import annotations

import argparse
import itertools
import socket
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.bulk import BulkDecoder
from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.link.link import CHUNK_BYTES, Link
from companion.adapters.mavlink.link.scan import Scanner
from companion.adapters.mavlink.link.udp import UdpIn
from companion.params.files import load_airframe
from companion.records import ImuBatch, RawChunk

TARGET_RATIO = 15.0
_COMPONENTS = (1, 200, 201)
_BURST = 150  # datagrams that a default socket buffer holds
_REPEATS = 5  # measurements of every decoder, whose medians count (choice)


class _Clock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, target_host_ns: int) -> None:
        time.sleep(max(0, target_host_ns - self.now_ns()) / 1e9)


def frames_of_flight(seconds: float) -> list[bytes]:
    """HIGHRES_IMU of three sensors at 1 kHz, with the rare messages of a flight between."""
    packers = {component: mavlink.MAVLink(None, 1, component) for component in _COMPONENTS}
    frames = []
    for step in range(round(seconds * 1000)):
        rare: list[Any] = []
        if step % 1000 == 0:
            rare.append(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3))
        if step % 50 == 0:
            rare.append(mavlink.MAVLink_vfr_hud_message(17, 18, 90, 55, 120, 0))
            rare.append(mavlink.MAVLink_attitude_message(step, 0.1, 0.2, 0.3, 0, 0, 0))
        for message in rare:
            frames.append(_pack(message, packers[1]))
        for component in _COMPONENTS:
            values = (0.01 * (step % 7), 0.2, -9.8, 0.1, 0.02, 0.3)
            message = mavlink.MAVLink_highres_imu_message(1000 * step, *values, 0, 0, 0, 1013, 0, 0, 20, 63, 0)
            frames.append(_pack(message, packers[component]))
    return frames


def _pack(message: Any, packer: Any) -> bytes:
    frame = bytes(message.pack(packer))
    packer.seq = (packer.seq + 1) % 256
    return frame


def _best_rate(count: int, work: Callable[[], int]) -> float:
    """Frames per second and core, median of several rounds; every round must find every frame."""
    rates = []
    for _ in range(_REPEATS):
        begin = time.process_time()
        decoded = work()
        rates.append(count / (time.process_time() - begin))
        if decoded != count:
            raise RuntimeError(f"found {decoded} of {count} frames")
    return statistics.median(rates)


def _pieces(frames: list[bytes], count: int) -> Iterator[bytes]:
    for start in range(0, len(frames), count):
        yield b"".join(frames[start : start + count])


def _decode_all(chunks: list[RawChunk]) -> int:
    decoder = Decoder(load_airframe("nadir-2m"), 191)
    for chunk in chunks:
        decoder.decode_chunk(chunk)
    return decoder.counters(0).frames


def _scan_all(data: bytes) -> int:
    scanner = Scanner(BulkDecoder(()))
    for start in range(0, len(data), CHUNK_BYTES):
        scanner.scan(data[start : start + CHUNK_BYTES])
    return scanner.counters.frames


def _parse_all(data: bytes) -> int:
    return len(mavlink.MAVLink(None).parse_buffer(data) or [])


def _in_bursts(frames: list[bytes], port: int, drain: Callable[[], int]) -> tuple[int, float]:
    """Send bursts to a port and time only their reading: frames found and CPU seconds."""
    decoded, spent = 0, 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for start in range(0, len(frames), _BURST):
            for frame in frames[start : start + _BURST]:
                sender.sendto(frame, ("127.0.0.1", port))
            begin = time.process_time()
            decoded += drain()
            spent += time.process_time() - begin
    return decoded, spent


def _udp_ours(frames: list[bytes]) -> float:
    transport = UdpIn("127.0.0.1", 0)
    link, decoder = Link(0, "udpin", transport, _Clock()), Decoder(load_airframe("nadir-2m"), 191)

    def drain() -> int:
        before = decoder.counters(0).frames
        while (chunk := link.read()) is not None:
            decoder.decode_chunk(chunk)
        return decoder.counters(0).frames - before

    decoded, spent = _in_bursts(frames, transport.port, drain)
    link.close()
    return _checked(decoded, len(frames)) / spent


def _udp_mavutil(frames: list[bytes]) -> float:
    connection = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")

    def drain() -> int:
        return sum(1 for _ in iter(connection.recv_match, None))

    decoded, spent = _in_bursts(frames, connection.port.getsockname()[1], drain)
    connection.close()
    return _checked(decoded, len(frames)) / spent


def _checked(decoded: int, expected: int) -> int:
    if decoded != expected:
        raise RuntimeError(f"found {decoded} of {expected} frames over UDP")
    return decoded


def _live_cost_ms(frames: list[bytes], seconds: float, gather_s: float) -> tuple[float, float]:
    """CPU milliseconds per second of data when chunks hold ``gather_s`` of it, and samples in the largest batch."""
    per_chunk = round(len(frames) / seconds * gather_s)
    chunks = [RawChunk(0, k, piece) for k, piece in enumerate(_pieces(frames, per_chunk))]
    decoder = Decoder(load_airframe("nadir-2m"), 191)
    begin = time.process_time()
    records = [decoder.decode_chunk(chunk) for chunk in chunks]
    spent = time.process_time() - begin
    sizes = [len(record.t_ns) for record in itertools.chain(*records) if isinstance(record, ImuBatch)]
    return 1e3 * spent / seconds, float(max(sizes))


def run(seconds: float = 8.0) -> list[dict[str, Any]]:
    """Measure; each row has ``name``, ``value``, ``unit`` and, where there is one, ``target``."""
    frames = frames_of_flight(seconds)
    data, count = b"".join(frames), len(frames)
    chunks = [RawChunk(0, k, piece) for k, piece in enumerate(_pieces(frames, 600))]
    ours, theirs = _best_rate(count, lambda: _decode_all(chunks)), _best_rate(count, lambda: _parse_all(data))
    scan = _best_rate(count, lambda: _scan_all(data))
    pairs = [(_udp_ours(frames), _udp_mavutil(frames)) for _ in range(_REPEATS)]
    udp_ours, udp_theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    rows: list[dict[str, Any]] = [
        {"name": "in memory: bulk decoder to SI batches", "value": ours, "unit": "frames/s"},
        {"name": "in memory: frame scan alone", "value": scan, "unit": "frames/s"},
        {"name": "in memory: pymavlink parse_buffer", "value": theirs, "unit": "frames/s"},
        {"name": "in memory: ratio", "value": ours / theirs, "unit": "x"},
        {"name": "loopback UDP: link and bulk decoder", "value": udp_ours, "unit": "frames/s"},
        {"name": "loopback UDP: mavutil recv_match", "value": udp_theirs, "unit": "frames/s"},
        {"name": "loopback UDP: ratio", "value": udp_ours / udp_theirs, "unit": "x", "target": TARGET_RATIO},
        {"name": "in memory against mavutil over UDP: ratio", "value": ours / udp_theirs, "unit": "x"},
    ]
    for gather_ms in (1, 3, 5, 10):
        cost_ms, _ = _live_cost_ms(frames, seconds, gather_ms / 1e3)
        rows.append({"name": f"3 x 1 kHz, chunks of {gather_ms} ms", "value": cost_ms, "unit": "ms CPU/s"})
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 when a target is missed."""
    argparse.ArgumentParser(prog="python -m tools.bench decode").parse_args(arguments)
    rows = run()
    for row in rows:
        target = f"   (target >= {row['target']:g})" if "target" in row else ""
        print(f"{row['name']:45s} {row['value']:12,.1f} {row['unit']}{target}")
    return int(any(row["value"] < row["target"] for row in rows if "target" in row))


if __name__ == "__main__":
    sys.exit(main())
