"""ONBOARD_COMPUTER_STATUS: how the companion computer itself is doing, from what Linux tells of it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from companion.adapters.mavlink.link.dialect import mavlink
from companion.rate_limiter import RateLimiter

_PERIOD_NS = 1_000_000_000  # convention: once a second, as the heartbeat
# "unknown" of each field (MAVLink common.xml)
_UNKNOWN_8, _UNKNOWN_TEMPERATURE, _UNKNOWN_16, _UNKNOWN_32 = 0xFF, 127, 32767, 0xFFFFFFFF
_MIB = 1 << 20  # bytes (by definition)
_CORES = 8  # length of cpu_cores (MAVLink common.xml)


class OnboardComputerStatus:
    """Makes the message once a second. What this machine does not tell is sent as unknown.

    ``root`` is the folder that holds ``proc`` and ``sys``; None for a computer that is only simulated, whose state is
    not this machine's.
    """

    def __init__(self, root: Path | None = Path("/")) -> None:
        self._root = root
        self._limiter = RateLimiter(_PERIOD_NS)
        self._times: dict[str, tuple[int, int]] = {}

    def due(self, now_host_ns: int) -> Any | None:
        """The message, if it is time for one."""
        return self._message(now_host_ns) if self._limiter.take(now_host_ns) else None

    def _message(self, now_host_ns: int) -> Any:
        load = self._load_percent()
        cores = [load.get(f"cpu{number}", _UNKNOWN_8) for number in range(_CORES)]
        used_mib, total_mib = self._memory_mib()
        disk_used_mib, disk_total_mib = self._disk_mib()
        none = [_UNKNOWN_32]
        return mavlink.MAVLink_onboard_computer_status_message(
            time_usec=now_host_ns // 1000,
            uptime=now_host_ns // 1_000_000 & _UNKNOWN_32,  # Linux counts its monotonic clock from boot
            type=0,
            cpu_cores=cores,
            cpu_combined=[_UNKNOWN_8] * 10,
            gpu_cores=[_UNKNOWN_8] * 4,
            gpu_combined=[_UNKNOWN_8] * 10,
            temperature_board=_UNKNOWN_TEMPERATURE,
            temperature_core=[self._temperature_degc(), *[_UNKNOWN_TEMPERATURE] * 7],
            fan_speed=[_UNKNOWN_16] * 4,
            ram_usage=used_mib,
            ram_total=total_mib,
            storage_type=none * 4,
            storage_usage=[disk_used_mib, *none * 3],
            storage_total=[disk_total_mib, *none * 3],
            link_type=none * 6,
            link_tx_rate=none * 6,
            link_rx_rate=none * 6,
            link_tx_max=none * 6,
            link_rx_max=none * 6,
        )

    def _load_percent(self) -> dict[str, int]:
        """Busy share of each core (``cpu0`` ...) since the last call, in percent."""
        shares = {}
        for line in self._lines("proc/stat"):
            name, *fields = line.split()
            if not name.startswith("cpu") or len(fields) < 5:
                continue
            counts = [int(field) for field in fields[:8]]
            idle, total = counts[3] + counts[4], sum(counts)
            was_idle, was_total = self._times.get(name, (0, 0))
            self._times[name] = (idle, total)
            if total > was_total:
                busy_percent = 100 * (1 - (idle - was_idle) / (total - was_total))
                shares[name] = min(max(round(busy_percent), 0), 100)
        return shares

    def _memory_mib(self) -> tuple[int, int]:
        sizes = {line.split(":")[0]: int(line.split()[1]) for line in self._lines("proc/meminfo") if ":" in line}
        total, free = sizes.get("MemTotal"), sizes.get("MemAvailable")
        if total is None or free is None:
            return _UNKNOWN_32, _UNKNOWN_32
        return (total - free) // 1024, total // 1024

    def _disk_mib(self) -> tuple[int, int]:
        if self._root is None:
            return _UNKNOWN_32, _UNKNOWN_32
        try:
            disk = os.statvfs(self._root)
        except OSError:
            return _UNKNOWN_32, _UNKNOWN_32
        total = disk.f_blocks * disk.f_frsize
        return (total - disk.f_bavail * disk.f_frsize) // _MIB, total // _MIB

    def _temperature_degc(self) -> int:
        lines = self._lines("sys/class/thermal/thermal_zone0/temp")
        try:
            return min(max(round(int(lines[0]) / 1000), -127), 126)
        except (IndexError, ValueError):
            return _UNKNOWN_TEMPERATURE

    def _lines(self, name: str) -> list[str]:
        if self._root is None:
            return []
        try:
            return (self._root / name).read_text(encoding="ascii", errors="replace").splitlines()
        except OSError:
            return []
