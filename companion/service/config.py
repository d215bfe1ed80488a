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

    Attributes
    ----------
    connections
        MAVLink links in mavutil's spelling.
    cameras, trigger
        Picklable factories, called inside the process that uses the device; None without cameras. With
        :class:`companion.adapters.triggers.mavlink.MavlinkTrigger` the autopilot fires.
    recording
        Path of the MCAP to write, or None.
    recording_keep_bytes
        Size that all recordings of this path's name may take together; None keeps all of them.
    parameters
        File that keeps what a ground station sets, or None; ``settings`` has its values in already.
    signing_key
        Key file: with it only signed frames come in, and all that go out are signed. None leaves signing off.
    standby
        Keep a second inertial process loaded and compiled, to take over when the first dies.
    live
        Where the live view is served, or None.
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
