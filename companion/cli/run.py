"""``spanwise run``: the live service beside an autopilot."""

from __future__ import annotations

import argparse
import signal
import time
from pathlib import Path

from companion.adapters.cameras import camera_factory as cameras
from companion.adapters.triggers import trigger_factory as triggers
from companion.adapters.triggers.mavlink import link_firing
from companion.adapters.triggers.oak import soft_line
from companion.cli.steps.airframe_check import check_airframe
from companion.cli.steps.live_view import add_live, read_live
from companion.cli.steps.numbers import number, seconds
from companion.cli.steps.options import add_settings, check_ending, read_settings, state_file
from companion.cli.steps.simulated_devices import SPELLING, opens_at_take_off, simulated_cameras, simulated_trigger
from companion.cli.terminal.progress import say
from companion.cli.terminal.run_loop import run_service
from companion.cli.terminal.status_view import View, live_view_possible
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError
from companion.numbered_files import numbered_files
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.learned import keep_latency, load_latency, with_latency
from companion.records import Record, TriggerLatency
from companion.service.config import ServiceConfig
from companion.service.wiring import Service

_KEEP_NS = 30_000_000_000  # chosen: a crash loses half a minute of learning, and the card is rarely written
_GB = 1e9  # bytes (by definition)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "--connect", action="append", required=True, metavar="LINK",
        help="MAVLink link: udpin:0.0.0.0:14550, udpout:host:port, tcp:host:port, /dev/ttyAMA0,921600; may be repeated",
    )  # fmt: skip
    parser.add_argument("--airframe", required=True, metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help="record everything that goes in and out")
    parser.add_argument(
        "--record-keep", type=number(0.001, 1e6, "GB"), metavar="GB",
        help="most that all recordings of this name may take: long ones go on in further files, the oldest are removed",
    )  # fmt: skip
    parser.add_argument(
        "--parameters", type=Path, metavar="FILE",
        help="where what a ground station sets is kept (default: ~/.local/state/spanwise/<airframe>.parameters)",
    )  # fmt: skip
    parser.add_argument(
        "--cameras", metavar="PAIR", help="left and right camera: " + "; ".join((*cameras.SPELLINGS, SPELLING))
    )
    parser.add_argument(
        "--trigger",
        default="none",
        metavar="LINE",
        help="what fires the cameras: " + "; ".join((*triggers.SPELLINGS, "sim:FOLDER")),
    )
    parser.add_argument("--record-images", action="store_true", help="record every image too (PNG, lossless)")
    parser.add_argument(
        "--sign-key", type=Path, metavar="FILE",
        help="sign what is sent, accept only what is signed; a link whose wing nodes cannot sign is LINK,unsigned",
    )  # fmt: skip
    parser.add_argument("--for", type=seconds, metavar="SECONDS", dest="seconds", help="stop after so long")
    parser.add_argument(
        "--no-standby", action="store_true", help="no second inertial process that waits to take over (saves 180 MB)"
    )
    parser.add_argument("--plain", action="store_true", help="a line every few seconds instead of the live view")
    add_live(parser)
    add_settings(parser)


def execute(options: argparse.Namespace) -> int:
    """Run until Ctrl-C, SIGTERM or SIGHUP (or for the given time)."""
    config = service_config(options)
    try_devices(config)
    return serve(config, options)


def service_config(options: argparse.Namespace) -> ServiceConfig:
    """Configuration that the options ask for."""
    check_ending(options.record, "--record", ".mcap")
    if options.record is not None and not options.record.parent.is_dir():
        raise ConfigError(f"--record {options.record}: no folder {options.record.parent}")
    if options.record is not None and options.record.is_dir():
        raise ConfigError(f"--record {options.record}: is a folder; name a file in it, such as flight.mcap")
    if len(set(options.connect)) < len(options.connect):
        raise ConfigError(f"--connect {' --connect '.join(options.connect)}: the same link twice; name each once")
    if options.record_keep is not None and options.record is None:
        raise ConfigError("--record-keep needs --record")
    if options.parameters is None:
        options.parameters = state_file(f"{Path(options.airframe).stem}.parameters")
    if options.record_images and (options.record is None or options.cameras is None):
        raise ConfigError("--record-images needs --record and --cameras")
    trigger = simulated_trigger(options.trigger) or triggers.trigger_factory(options.trigger)
    airframe = _with_kept_latency(load_airframe(options.airframe), options)
    settings = read_settings(options)
    check_airframe(airframe, settings)
    eyes = None
    if options.cameras is not None:
        soft = soft_line(trigger)
        eyes = simulated_cameras(options.cameras) or cameras.camera_factory(
            options.cameras, airframe, triggered=trigger is not None, soft=soft
        )
    return ServiceConfig(
        airframe=airframe,
        settings=settings,
        connections=tuple(options.connect),
        cameras=eyes,
        trigger=trigger,
        recording=options.record,
        recording_keep_bytes=None if options.record_keep is None else round(_GB * options.record_keep),
        record_images=options.record_images,
        parameters=options.parameters,
        signing_key=options.sign_key,
        standby=not options.no_standby,
        live=read_live(options, options.record),
    )


def _with_kept_latency(airframe: Airframe, options: argparse.Namespace) -> Airframe:
    stored = None
    try:
        stored = load_latency(_latency_file(options))
    except ConfigError as error:  # what was learned is learned again
        say(f"{error} (the service runs without it)")
    learned = with_latency(airframe, stored, _path(options))
    if stored is not None and learned is not airframe:
        latencies = " and ".join(f"{1e3 * side.value:.2f} +- {1e3 * side.sigma:.2f} ms" for side in stored.latency_s)
        say(f"trigger latency of the last flight: {latencies} ({stored.shots} shots)")
    return learned


def _latency_file(options: argparse.Namespace) -> Path:
    file: Path = options.parameters.with_suffix(".latency")
    return file


def _path(options: argparse.Namespace) -> str:
    """Trigger path that the latency belongs to."""
    return f"{options.trigger} {options.cameras or ''}".strip()


class LatencyKeeper:
    """Keeps what is learned of the trigger for the next flight; never in the process that flies."""

    def __init__(self, file: Path, path: str) -> None:
        self._file, self._path = file, path
        self._newest: TriggerLatency | None = None
        self._kept_ns = 0
        self._is_told = False

    def take(self, record: Record) -> None:
        """Look at a record; write at most every half minute."""
        if isinstance(record, TriggerLatency):
            self._newest = record
            if record.at_host_ns - self._kept_ns >= _KEEP_NS:
                self.keep()

    def keep(self) -> None:
        """Write the newest, if there is one; where that cannot be, say so once and fly on."""
        if self._newest is None:
            return
        try:
            stored = keep_latency(self._file, self._path, self._newest)
        except ConfigError as error:
            stored = True  # not tried again for a while
            if not self._is_told:
                say(str(error))
            self._is_told = True
        if stored:
            self._kept_ns = self._newest.at_host_ns


def try_devices(config: ServiceConfig) -> None:
    """Open and close cameras and trigger once, so that a missing one is told to the user and not to a log.

    Raises
    ------
    DeviceError
        A device or its library is absent.
    """
    for factory in (config.cameras, None if link_firing(config.trigger) else config.trigger):
        if factory is not None and not opens_at_take_off(factory):
            factory().close()


def serve(config: ServiceConfig, options: argparse.Namespace) -> int:
    """Run it in the foreground, and say at the end how it stood; 3 where no vehicle came in the time that was given."""
    ends = time.monotonic() + options.seconds if options.seconds else float("inf")
    stopped: list[int] = []
    for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if ending is not signal.SIGHUP or signal.getsignal(ending) is not signal.SIG_IGN:  # as nohup asks for
            signal.signal(ending, lambda caught, _: stopped.append(caught))
    view = View(f"spanwise run {config.airframe.name} on {', '.join(config.connections)}", options.seconds)
    live = live_view_possible(plain=options.plain)
    began, before = time.monotonic(), _recordings(config.recording)
    keeper = LatencyKeeper(_latency_file(options), _path(options))
    try:
        run_service(
            Service(config), view, lambda: bool(stopped) or time.monotonic() >= ends, live=live, each=keeper.take
        )
    finally:
        keeper.keep()
    print(view.line(time.monotonic() - began).strip())
    if config.recording is not None:
        print(_recorded(config.recording, before))
    if options.seconds and not stopped and not view.began:
        say(f"spanwise run: nothing to estimate in {options.seconds:g} s")
        return NOTHING_TO_ESTIMATE
    return 0


def _recordings(path: Path | None) -> dict[Path, int]:
    """Recordings of that name and their numbered successors, with the instants of their last change."""
    files = numbered_files(path) if path is not None else ()
    return {entry: entry.stat().st_mtime_ns for _, entry in files}


def _recorded(path: Path, before: dict[Path, int]) -> str:
    """The sentence about the recording: a file of that name from before stays, and the next free number is written."""
    written = {entry: changed for entry, changed in _recordings(path).items() if before.get(entry) != changed}
    if not written:
        return f"nothing was recorded to {path}"
    newest = max(written, key=lambda entry: written[entry])
    return f"recorded {newest}; next: spanwise report {newest}"
