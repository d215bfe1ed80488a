"""Ports for the ends of a test, taken by nobody else.

The system gives a socket that asks for any port one of 32768 and above (Linux): a port that was free there a moment ago
may be another socket's when the test opens it, and MAVSDK shares the port of another MAVSDK without a word. Ports here
are lower, each is given once in a while, and each worker of pytest-xdist has its own.
"""

from __future__ import annotations

import itertools
import os
import random
import socket

_LOWEST = 15000  # chosen: above MAVLink's own ports, 14540 to 14560
_PORTS_OF_A_WORKER = 1000  # chosen: more than a worker's tests open in any minute
_WORKERS = 17  # bound: ends below 32768
_HOST = "127.0.0.1"


def _ports_of(worker: str) -> list[int]:
    first = _LOWEST + _PORTS_OF_A_WORKER * (int(worker.removeprefix("gw")) % _WORKERS)
    return random.sample(range(first, first + _PORTS_OF_A_WORKER), _PORTS_OF_A_WORKER)


_PORTS = itertools.cycle(_ports_of(os.environ.get("PYTEST_XDIST_WORKER", "gw0")))


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """Port of this host's loopback that nobody listens on."""
    for port in itertools.islice(_PORTS, _PORTS_OF_A_WORKER):
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind((_HOST, port))
            except OSError:
                continue
            return port
    raise RuntimeError(f"all {_PORTS_OF_A_WORKER} ports of this worker are taken")
