"""First start: the command line's help, the service from its command to its open link, memory of the inertial process.

Times are those of the clock on the wall, the least of several tries: what else the machine does only adds to them.
Beside them is what they took of the processors. The vehicle is that of ``spanwise vehicle``, on loopback.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

HELP_LIMIT_S, OPEN_LIMIT_S, MEMORY_LIMIT_MB = 0.3, 3.0, 120.0
"""Targets for ``--help``, for the open link, and for the inertial process (choice)."""
_TRIES = 5
_GIVE_UP_S = 120.0
_LOOK_S = 0.01
_KB_PER_MB = 1024.0 / 1.048576  # VmHWM counts kibibytes
_SPANWISE = (sys.executable, "-m", "companion.cli")


def help_s() -> tuple[float, float]:
    """Time of ``spanwise --help`` on the wall's clock, and of the processor, s."""
    began_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*_SPANWISE, "--help"], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - began_s, processor_s


def open_s(port: int, folder: Path) -> tuple[float, float]:
    """Time from the command to the open link of ``spanwise run``, s, and of the processors for all its processes."""
    began_s = time.monotonic()
    with started("run", "--plain", *_link(port), folder=folder) as process:
        _until_bound(port, process)
        return time.monotonic() - began_s, _tree_s(process.pid)


def _tree_s(root: int) -> float:
    """Processor time of a process and of those that it has started, s (proc(5): fields 4, 14 and 15 of stat)."""
    stats = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            stats[int(path.parts[2])] = path.read_text().rpartition(")")[2].split()
    members = {root} | {number for number, words in stats.items() if int(words[1]) == root}
    ticks = sum(int(words[11]) + int(words[12]) for number, words in stats.items() if number in members)
    return ticks / os.sysconf("SC_CLK_TCK")


def memory_mb(port: int, folder: Path, flown_s: float) -> float:
    """Largest resident memory of the process that has the link, in a flight of so long, MB."""
    with started("run", "--plain", *_link(port), folder=folder) as process:
        owner = _until_bound(port, process)
        vehicle = ("vehicle", "--duration", f"{flown_s:g}", "--connect", f"udpout:127.0.0.1:{port}")
        subprocess.run([*_SPANWISE, *vehicle], check=False, capture_output=True, timeout=flown_s + _GIVE_UP_S)
        (peak_kb,) = re.findall(r"^VmHWM:\s+(\d+) kB", Path(f"/proc/{owner}/status").read_text(), re.MULTILINE)
    return int(peak_kb) / _KB_PER_MB


@contextlib.contextmanager
def started(*words: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command of ours meanwhile, with its state in a folder; it is ended as by Ctrl-C."""
    surroundings = {**os.environ, "XDG_STATE_HOME": str(folder)}
    # the first try leaves the byte code that an installed program has; compiling it at each start takes 50 MB
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([*_SPANWISE, *words], env=surroundings, **quiet)  # type: ignore[call-overload]
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(_GIVE_UP_S)


def _link(port: int) -> tuple[str, ...]:
    return ("--connect", f"udpin:127.0.0.1:{port}", "--airframe", "nadir-2m")


def _until_bound(port: int, process: subprocess.Popen[bytes]) -> int:
    """Wait until a process listens on the port; its number."""
    ends_s = time.monotonic() + _GIVE_UP_S
    while time.monotonic() < ends_s and process.poll() is None:
        inode = _inode(port)
        owner = None if inode is None else _owner(inode)
        if owner is not None:
            return owner
        time.sleep(_LOOK_S)
    raise TimeoutError(f"nothing listens on port {port}")


def _inode(port: int) -> str | None:
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return next((row[9] for row in rows if row[1].endswith(f":{port:04X}")), None)


def _owner(inode: str) -> int | None:
    for entry in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if os.readlink(entry) == f"socket:[{inode}]":
                return int(entry.parts[2])
    return None


def free_port() -> int:
    """Give a UDP port that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main(arguments: list[str]) -> int:
    """Print a table; 1 where a target is missed."""
    parser = argparse.ArgumentParser(prog="start", description=__doc__)
    parser.add_argument("--flown", type=float, default=30.0, metavar="S", help="length of the flight for the memory")
    options = parser.parse_args(arguments)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="spanwise-start-") as folder:
        asked = min(help_s() for _ in range(_TRIES))
        opened = min(open_s(free_port(), Path(folder)) for _ in range(_TRIES))
        peak_mb = memory_mb(free_port(), Path(folder), options.flown)
    rows = [
        ("spanwise --help", asked[0], f"s ({asked[1]:.2f} s of processor)", HELP_LIMIT_S),
        ("the service to its open link", opened[0], f"s ({opened[1]:.2f} s of processors)", OPEN_LIMIT_S),
        (f"inertial process, {options.flown:g} s of flight", peak_mb, "MB", MEMORY_LIMIT_MB),
    ]
    for name, value, unit, limit in rows:
        print(f"{name:36s} {value:8.2f} {unit}, {limit:g} are wanted{'' if value <= limit else ': missed'}", flush=True)
    print(f"load of the machine when this began: {load:.1f} on {os.cpu_count()} cores")
    return int(any(value > limit for _, value, _, limit in rows))
