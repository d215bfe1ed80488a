"""Configuration of one run of the service; picklable, so that every process is built from the same record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.live.config import LiveConfig
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.ports import CameraPair, Trigger


@dataclass(frozen=True, slots=True)
class ServiceConfig:
    """Wiring of one run.

    ``connections`` are MAVLink links in mavutil's spelling. ``cameras`` and ``trigger`` are picklable factories, called
    inside the process that uses the device; with :class:`companion.adapters.triggers.mavlink.MavlinkTrigger` the
    autopilot fires. ``recording`` is the MCAP to write, and ``recording_keep_bytes`` what all recordings of its name
    may take together, None for no limit. ``parameters`` is the file that keeps what a ground station sets, which
    ``settings`` has in already. With ``signing_key`` only signed frames come in, and all that go out are signed, but
    those of links that end with ``,unsigned``. ``standby`` keeps a second inertial process loaded and compiled, to take
    over when the first dies.
    """

    airframe: Airframe
    settings: Settings
    connections: tuple[str, ...]
    cameras: Callable[[], CameraPair] | None = None
    trigger: Callable[[], Trigger] | None = None
    recording: Path | None = None
    recording_keep_bytes: int | None = None
    record_images: bool = False
    parameters: Path | None = None
    signing_key: Path | None = None
    standby: bool = False
    live: LiveConfig | None = None
