"""Wires one run of the service: which processes, which channels between them, which adapters in each."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import socket
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.link.link import open_link
from companion.adapters.mavlink.link.signing import Signing, load_signing
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.adapters.recordings.mcap.recorder import keep_recording
from companion.adapters.recordings.mcap.recorder_client import RecorderClient, recorder_channel
from companion.adapters.recordings.mcap.writer import About
from companion.adapters.systemd import ServiceManager
from companion.adapters.triggers.mavlink import CAMERAS, link_firing
from companion.adapters.triggers.process import TriggerLink, line_pair, serve_trigger
from companion.core.pipeline import VisionState, start
from companion.errors import ConfigError, LinkDown, SpanwiseError
from companion.lifetime import SharedCount, StopFlag, WatchedStopFlag
from companion.live.broadcaster import require_live
from companion.live.door import listen
from companion.live.feed import FeedEnd, Interest, LiveFeed
from companion.live.process import serve_live
from companion.live.session import Subject
from companion.params.persist import Keeper, load_stored
from companion.params.settings import Settings, tunables
from companion.ports import Clock, Recorder
from companion.records import Notice, Record, Rejected, Shot, Station, TriggerPlan
from companion.service import inertial, vision
from companion.service.channel import Receiver, Sender, channel
from companion.service.config import ServiceConfig
from companion.service.parameter_request import ParameterRequest
from companion.service.supervisor import StandbyGate, Supervisor
from companion.units import Severity


class Service(Supervisor):
    """The live service: inertial, and as the configuration asks trigger, vision and recorder processes.

    Raises
    ------
    LinkError, ConfigError
        At construction, for what can be known to be wrong before a process is started.
    """

    def __init__(self, config: ServiceConfig) -> None:
        super().__init__(MonotonicClock())
        _check_settings(config)
        self._unsaid = _try_links(config)
        self._scratch = tempfile.TemporaryDirectory(prefix="spanwise-") if config.parameters is None else None
        if self._scratch is not None:  # what is set must outlive a restart of the process, if not of the service
            config = dataclasses.replace(config, parameters=Path(self._scratch.name) / "parameters")
        shown_in, self._shown = channel()
        matches_in, matches = channel()
        ends: list[socket.socket] = []
        inertial_recorder = vision_recorder = None
        if config.recording is not None:
            inertial_recorder, end = recorder_channel()
            ends.append(end)
            if config.record_images and config.cameras is not None:
                vision_recorder, end = recorder_channel()
                ends.append(end)
        shots = None
        if config.trigger is not None:
            shots, line = line_pair()
            self.add("trigger", _trigger_process, config, line, thread_beside=False)
        updates_in, updates = channel() if config.cameras is not None else (None, None)
        inertial_feed, vision_feed = self._add_live(config, matches_in)
        ends_of_inertial = (shots, matches, updates_in, shown_in, inertial_recorder, inertial_feed, SharedCount())
        if config.cameras is not None:
            ends_of_vision = (updates, matches_in, vision_recorder, vision_feed)
            self.add("vision", _vision_process, config, _stored(config), *ends_of_vision)
        gate = () if config.standby else (None,)
        stored = _stored(config)
        self.add("inertial", _inertial_process, config, stored, *ends_of_inertial, *gate, standby=config.standby)
        if ends:
            about = About.of(config.airframe, config.settings)
            self.add(
                "recorder", _recorder_process, config, about, ends, SharedCount(), matches_in, optional=True, last=True
            )
        self._say = matches_in

    def _add_live(self, config: ServiceConfig, say: Sender) -> tuple[FeedEnd | None, FeedEnd | None]:
        """Register the live view; give the ends of the inertial and the vision process's feeds."""
        self._listening = None
        if config.live is None:
            return None, None
        require_live()
        self._listening = listen(config.live)
        interest = Interest()
        channels = [recorder_channel() for _ in range(2)]
        ends = [end for _, end in channels]
        arguments = (config, _stored(config), self._listening, ends, interest, say, MonotonicClock().now_ns())
        self.add("live", _live_process, *arguments, optional=True)
        inertial_feed, vision_feed = (FeedEnd(end, interest) for end, _ in channels)
        return inertial_feed, vision_feed

    def shown(self) -> list[Record]:
        """Records for the display from the inertial process since the last call."""
        return self._shown.receive()

    def tend(self) -> list[str]:
        """As the supervisor's; the ground hears of it too."""
        sentences, self._unsaid = self._unsaid + super().tend(), []
        for sentence in sentences:
            self._say.send(_warning(sentence))
        return sentences

    def stop(self) -> None:
        """End the processes, and forget what was to outlive them alone."""
        super().stop()
        if self._listening is not None:
            self._listening.close()
        if self._scratch is not None:
            self._scratch.cleanup()


class _NoShots:
    """Stands in where nothing fires."""

    def send(self, plan: TriggerPlan) -> None:
        """Nobody fires it."""

    def poll(self) -> list[Shot | Rejected]:
        """Nothing was fired."""
        return []

    def warnings(self) -> list[str]:
        """Nothing to be warned of."""
        return []


def _try_links(config: ServiceConfig) -> list[str]:
    """Open and close every link once, so that a wrong one is told to the user and not to a log.

    Sentences are of links that are down; where all are, the first of them is raised.
    """
    clock = MonotonicClock()
    down: list[LinkDown] = []
    for number, spelling in enumerate(config.connections):
        try:
            open_link(spelling, clock, number).close()
        except LinkDown as error:
            down.append(error)
    if down and len(down) == len(config.connections):
        raise down[0]
    return [f"{error} (it is waited for; the service runs without it)" for error in down]


class _Recorders:
    """Several recorders in the place of one."""

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = tuple(recorders)

    def write(self, record: Record) -> None:
        """Hand the record to each."""
        for recorder in self._recorders:
            recorder.write(record)

    def close(self) -> None:
        """Finish each."""
        for recorder in self._recorders:
            recorder.close()


def _recorder(recorder_end: socket.socket | None, feed_end: FeedEnd | None, *, successor: bool = False) -> Recorder:
    """The recorder's client and the live view's feed, as far as they are there."""
    clients: list[Recorder] = [] if recorder_end is None else [RecorderClient(recorder_end, successor=successor)]
    clients += [] if feed_end is None else [LiveFeed(feed_end)]
    return clients[0] if len(clients) == 1 else _Recorders(clients)


def _stored(config: ServiceConfig) -> dict[str, float]:
    """Parameters set from a ground station, by MAVLink name, less those that contradict each other."""
    return {} if config.parameters is None else Settings().agreeing(load_stored(config.parameters).values)[0]


@contextlib.contextmanager
def _ending_with_a_sentence(process: str) -> Iterator[None]:
    """End the process with what a device or a link says of itself, in place of a traceback."""
    try:
        yield
    except SpanwiseError as error:
        raise SystemExit(f"spanwise {process}: {error}") from error


def _changed(at_start: Mapping[str, float], now: Mapping[str, float], *, live: bool) -> dict[str, float]:
    """Values set since the service's own start that act at once, or that act from its next start on."""
    rows = [row.name for row in tunables() if row.live is live and row.name in now]
    return {name: now[name] for name in rows if at_start.get(name) != now[name]}


def resumed(settings: Settings, at_start: Mapping[str, float], now: Mapping[str, float]) -> Settings:
    """The settings of a process that starts anew: live changes since the service's own start are in force again."""
    for name, value in _changed(at_start, now, live=True).items():
        settings = settings.replace(name, value)
    return settings


def _inertial_process(
    config: ServiceConfig,
    stored_at_start: dict[str, float],
    shots: socket.socket | None,
    matches: Receiver,
    vision_ear: Sender | None,
    shown: Sender,
    recorder_end: socket.socket | None,
    feed_end: FeedEnd | None,
    starts: SharedCount,
    gate: StandbyGate | None,
    stop: WatchedStopFlag,
) -> None:
    clock: Clock = MonotonicClock()
    manager = ServiceManager(os.environ)
    if gate is not None and not gate.wait_for_turn(stop):
        return
    config = dataclasses.replace(config, settings=resumed(config.settings, stored_at_start, _stored(config)))
    signing = None if config.signing_key is None else load_signing(config.signing_key, clock)
    with _ending_with_a_sentence("inertial"):
        links = [open_link(link, clock, n, signing, may_be_down=True) for n, link in enumerate(config.connections)]
    firing = link_firing(config.trigger)
    autopilot = MavlinkAutopilot(
        links,
        config.airframe,
        config.settings,
        clock,
        component=_component(config, signing, stored_at_start),
        firing=firing or CAMERAS,
    )
    loop = inertial.InertialLoop(
        state=start(config.airframe, config.settings),
        autopilot=autopilot,
        clock=clock,
        shots=_NoShots() if shots is None else TriggerLink(shots),
        inbox=matches.receive,
        show=shown.send,
        recorder=_recorder(recorder_end, feed_end, successor=starts.next() > 1),
        fires_by_link=firing is not None,
        tell_vision=_unheard if vision_ear is None else vision_ear.send,
        alive=manager.ticked,
    )
    inertial.run(loop, stop)


def _unheard(record: Record) -> None:
    """Stands in where no vision process listens."""
    del record


def _component(
    config: ServiceConfig, signing: Signing | None, stored_at_start: Mapping[str, float]
) -> OnboardComponent:
    """Our own MAVLink component, which keeps its parameters where that is asked for."""
    reserved, stored = _sensor_components(config), _stored(config)
    keeper = None if config.parameters is None else Keeper(config.parameters)
    pending = _changed(stored_at_start, stored, live=False)
    parameters = ParameterServer(config.settings, keeper, stored, reserved, pending)
    return OnboardComponent(parameters, signing=signing)


def _sensor_components(config: ServiceConfig) -> frozenset[int]:
    return frozenset(config.airframe.sensor(station).source.component for station in Station)


def _check_settings(config: ServiceConfig) -> None:
    clash = config.settings.conflict(_sensor_components(config))
    if clash is not None:
        raise ConfigError(f"{clash.text}: change it (--set, --settings)")
    if config.signing_key is not None:
        load_signing(config.signing_key, MonotonicClock()).require_keeping()


def _trigger_process(config: ServiceConfig, line: socket.socket, stop: StopFlag) -> None:
    assert config.trigger is not None
    with _ending_with_a_sentence("trigger"):
        serve_trigger(config.trigger, line, stop.is_set)


def _warning(sentence: str) -> Notice:
    return Notice(Severity.WARNING, sentence, MonotonicClock().now_ns())


def _recorder_process(
    config: ServiceConfig, about: About, ends: list[socket.socket], parts: SharedCount, say: Sender, stop: StopFlag
) -> None:
    assert config.recording is not None
    keep_bytes = config.recording_keep_bytes
    keep_recording(config.recording, about, ends, lambda text: say.send(_warning(text)), stop, keep_bytes, parts)


def _live_process(
    config: ServiceConfig,
    stored_at_start: dict[str, float],
    listening: socket.socket,
    ends: list[socket.socket],
    interest: Interest,
    say: Sender,
    began_ns: int,
    stop: StopFlag,
) -> None:
    assert config.live is not None

    def request_topics(mask: int) -> None:
        interest.mask = mask

    subject = Subject(
        airframe=config.airframe,
        settings=resumed(config.settings, stored_at_start, _stored(config)),
        title="live",
        ask=lambda name, value: say.send(ParameterRequest(name, value)),
        request_topics=request_topics,
        is_recording=config.recording is not None,
        has_images=config.cameras is not None,
        began_host_ns=began_ns,
    )
    serve_live(config.live, subject, listening, ends, stop.is_set)


def _vision_process(
    config: ServiceConfig,
    stored_at_start: dict[str, float],
    updates: Receiver,
    matches: Sender,
    recorder_end: socket.socket | None,
    feed_end: FeedEnd | None,
    stop: StopFlag,
) -> None:
    assert config.cameras is not None
    recorder = _recorder(recorder_end, feed_end)
    with _ending_with_a_sentence("vision"):
        cameras = config.cameras()
    settings = resumed(config.settings, stored_at_start, _stored(config))
    clock = MonotonicClock()
    # milliseconds of the host's clock: no number comes twice, although this process may be the second of a flight
    first_pair = clock.now_ns() // 1_000_000
    state = VisionState.create(config.airframe, settings, free_running=config.trigger is None, first_pair=first_pair)
    try:
        with _ending_with_a_sentence("vision"):
            vision.run(state, cameras, clock, matches.send, recorder, stop, updates.receive)
    finally:
        recorder.close()
