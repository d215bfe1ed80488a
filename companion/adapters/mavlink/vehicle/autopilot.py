"""The vehicle over MAVLink: a :class:`companion.ports.Autopilot`."""

from __future__ import annotations

import dataclasses
import select
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from companion.adapters.mavlink.component import encode
from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.message_outputs import OutputPublisher
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.component.range_publisher import RangePublisher
from companion.adapters.mavlink.decode.decoder import Decoded, Decoder
from companion.adapters.mavlink.decode.message_records import INTEGER_TYPES, Heard
from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT
from companion.adapters.mavlink.link.dialect import ID_OF, mavlink
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.absence import Absence
from companion.adapters.mavlink.vehicle.autopilot_links import AutopilotLinks
from companion.adapters.mavlink.vehicle.component_sender import ComponentSender
from companion.adapters.mavlink.vehicle.periodic_requests import NEEDED_PARAMETERS, ParameterReader, TimesyncTimer
from companion.adapters.mavlink.vehicle.rates import RateKeeper
from companion.adapters.mavlink.vehicle.senders import ClockConflictDetector
from companion.adapters.mavlink.vehicle.timesync import is_request, timesync_answer
from companion.adapters.mavlink.vehicle.vehicle_choice import ChoiceNotices
from companion.adapters.triggers.mavlink import CAMERAS, LinkFiring
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.params.vehicle import implausible
from companion.ports import Clock
from companion.rate_limiter import RateLimiter
from companion.records import (
    AutopilotParameter,
    ClockName,
    ClockRestart,
    ClockState,
    CorrectedRange,
    Health,
    ModeState,
    NoRange,
    Notice,
    ObstacleSectors,
    ParameterChange,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    TimesyncReply,
    Validity,
    VehicleState,
)
from companion.units import Severity

_SECOND_NS = 1_000_000_000  # by definition
_STATE_RATE_HZ = 20.0  # attitude, airspeed and velocity over ground, for display and rigid motion (choice)
_MOST_ANSWERS = 16  # TIMESYNC answers in one chunk; bound of the time of one read
_MOST_HELD = 16  # bound of memory
_GATHER_NS = 4_000_000  # for so long bytes are gathered before they are decoded (choice)


class MavlinkAutopilot:
    """Reads, keeps time with, asks and tells the vehicle, over one link or several.

    Everything is done inside :meth:`poll`, which the loop that can see the service's health calls: when it stalls, our
    heartbeat stops. Times are of the given clock alone.

    ``links`` are open, their numbers differ and are below 128. Bytes are gathered for 4 ms before they are
    read, so that decoding works on batches, but not while an answer to TIMESYNC is awaited, whose arrival time matters.
    ``listener`` is called with every rare message (COMMAND_LONG, CAMERA_FEEDBACK ...). ``component`` is our own
    component (parameters, commands, files), by default one that keeps nothing over a restart. ``needed`` names the
    autopilot's parameters to read.
    """

    def __init__(
        self,
        links: Sequence[Link],
        airframe: Airframe,
        settings: Settings,
        clock: Clock,
        *,
        listener: Callable[[Heard], None] | None = None,
        component: OnboardComponent | None = None,
        needed: tuple[str, ...] = NEEDED_PARAMETERS,
        firing: LinkFiring = CAMERAS,
    ) -> None:
        self.decoder = Decoder(airframe, settings.component_id, settings.system_id)
        self.health = Health.BOOT
        self._firing = firing
        self._fired: int | None = None
        self._unfired: list[Rejected] = []
        self._two_clocks = ClockConflictDetector()
        self._said: list[Notice] = []
        self._links = list(links)
        self._settings, self._clock = settings, clock
        for link in self._links:
            if link.senders is not None:
                link.senders.guarded = frozenset(self.decoder.mapping.clocks)
        self._listener = listener
        self.component = OnboardComponent(ParameterServer(settings)) if component is None else component
        self._sender = ComponentSender(self._links, self.component, settings, clock)
        self._timesync = TimesyncTimer()
        self._parameters = ParameterReader(needed)
        self._integer_parameters: set[str] = set()
        self.rates = self._rate_keeper(airframe, settings)
        self._each_second = RateLimiter(_SECOND_NS)
        self._read_host_ns = 0
        self._boot_offset_ns = 0
        self._ranges = RangePublisher(settings, airframe.orientation)
        self._absence = Absence()
        self._choices = ChoiceNotices()
        self._autopilot_links = AutopilotLinks()
        self._held: deque[Notice] = deque(maxlen=_MOST_HELD)  # until somebody is there to read them
        self._outputs = OutputPublisher()

    @property
    def refused(self) -> int:
        """Messages that were not sent because a value was not finite."""
        return self._sender.refused

    def _rate_keeper(self, airframe: Airframe, settings: Settings) -> RateKeeper:
        wanted_hz = {ID_OF[name]: _STATE_RATE_HZ for name in ("ATTITUDE", "VFR_HUD", "GLOBAL_POSITION_INT")}
        for source in self.decoder.mapping.sources:
            if source.component == AUTOPILOT_COMPONENT:
                wanted_hz[source.message] = settings.imu_rate_hz
        rates = RateKeeper(wanted_hz, self.decoder.mapping.messages)
        modes = (airframe.wing.symmetric, airframe.wing.antisymmetric)
        rates.mode(max(mode.frequency_hz.value for mode in modes))
        return rates

    def poll(self, timeout_s: float) -> Iterator[Record]:
        """Yield what has arrived within the timeout, raw bytes first, then what they decode to.

        Also sends what is due: heartbeat, TIMESYNC, rate and parameter requests. Chunks of what we sent are yielded
        like received ones; from recorded chunks :meth:`Decoder.decode_chunk` makes the same records.
        """
        self._upkeep(self._clock.now_ns())
        for sent in self._sender.sent():
            yield sent
            yield from self.decoder.decode_chunk(sent)
        if self._wait(timeout_s):
            for link in self._links:
                chunk = link.read()
                if chunk is not None:
                    yield chunk
                    decoded = self.decoder.decode(chunk)
                    self._attend(decoded, chunk.received_host_ns)
                    yield from self._choices.due(self.decoder.choice, chunk.received_host_ns)
                    yield from decoded.records
            self._read_host_ns = self._clock.now_ns()
        yield from self._unfired
        yield from self._said
        self._unfired.clear()
        self._said.clear()
        if self.decoder.system_id is None:
            yield from self._complain()
        yield from self._refusals()
        yield from self.rates.notices()
        for event in self.component.events(self._clock.now_ns()):
            if isinstance(event, ParameterChange):
                self.adopt(self.component.parameters.settings)
            yield event

    def _refusals(self) -> Iterator[Record]:
        for link in self._links:
            if link.senders is not None:
                link.senders.system = self.decoder.system_id
                yield from link.senders.refusals(self._clock.now_ns())

    def _complain(self) -> Iterator[Notice]:
        junk = any(self.decoder.counters(link.number).skipped_bytes for link in self._links)
        signing = self.component.signing
        refused = () if signing is None else tuple(signing.refused)
        notice = self._absence.due(self._clock.now_ns(), junk=junk, refused=refused)
        if notice is not None:
            yield notice

    def _wait(self, timeout_s: float) -> bool:
        """Wait for bytes; whether it is time to read them."""
        now = self._clock.now_ns()
        deadline = now + max(0, round(timeout_s * _SECOND_NS))
        if self.decoder.system_id is not None:
            deadline = min(deadline, max(self._timesync.next_host_ns, now))
        if not self._timesync.awaiting(now):
            gathered = self._read_host_ns + _GATHER_NS
            self._clock.sleep_until(min(gathered, deadline))
            if gathered > deadline:
                return False
        waiter = select.poll()
        for link in self._links:
            if link.fileno() >= 0:
                waiter.register(link.fileno(), select.POLLIN)
        waiter.poll(max(0, deadline - self._clock.now_ns()) / 1e6)
        return True

    def _attend(self, decoded: Decoded, now_host_ns: int) -> None:
        """Answer and take note of what concerns the adapter itself."""
        for echo in decoded.echoed:
            self.component.echoed(echo)
        system = self.decoder.system_id
        ours = self._settings.component_id
        for request in [heard for heard in decoded.heard if is_request(heard, system, ours)][:_MOST_ANSWERS]:
            self._sender.send(timesync_answer(request, self._clock.now_ns()), request.link)
        for heard in decoded.heard:
            self._hear(heard, now_host_ns)
            if system is not None:
                self.component.hear(heard, system)
            if self._listener is not None:
                self._listener(heard)
        for record in decoded.records:
            notice_of_clocks = self._two_clocks.hear(record)
            if notice_of_clocks is not None:
                self._said.append(notice_of_clocks)
            self._note(record, now_host_ns)

    def _hear(self, heard: Heard, now_host_ns: int) -> None:
        """Take note of an acknowledgement, a parameter or a heartbeat."""
        if heard.name == "COMMAND_ACK" and self._is_ours(heard):
            self.rates.acknowledged(heard.message.result, now_host_ns)
        elif heard.name == "COMMAND_ACK" and heard.message.command == self._fired:
            self._acknowledge_shot(heard, now_host_ns)
        elif heard.name == "PARAM_VALUE" and self._from_autopilot(heard):
            self._parameters.arrived(heard.message.param_id)
            if heard.message.param_type in INTEGER_TYPES:
                self._integer_parameters.add(heard.message.param_id)
        elif heard.name == "HEARTBEAT":
            self._absence.beat(heard.system, heard.component)
            if self._from_autopilot(heard):
                self._note_link(heard.link, now_host_ns)

    def _note_link(self, number: int, now_host_ns: int) -> None:
        """Ask and command the autopilot over one link alone; say where it comes over two."""
        if self._autopilot_links.beat(number, now_host_ns):
            text = "the autopilot comes over two links, and its samples twice: give only one of them (--connect)"
            self._said.append(Notice(Severity.WARNING, text, now_host_ns))
        self._sender.autopilot_link = self._autopilot_links.chosen

    def _note(self, record: Record, now_host_ns: int) -> None:
        """Keep rates and clocks by what was decoded."""
        if isinstance(record, AutopilotParameter) and implausible(record.name, record.value) is None:
            if record.name == "SCHED_LOOP_RATE":
                self.rates.loop_rate(record.value)
            elif record.name == "IMU_INTEG_RATE":
                self.rates.integration_rate(record.value)
        elif isinstance(record, VehicleState):
            self._ranges.note_motion(record)
        elif isinstance(record, TimesyncReply):
            self._timesync.answered(record.clock)
        elif isinstance(record, ClockRestart):
            self._timesync.hurry(now_host_ns)
            if record.clock == ClockName.BOOT:
                self.rates.restart(now_host_ns)
                self._parameters.restart()

    def _acknowledge_shot(self, heard: Heard, now_host_ns: int) -> None:
        """A shot that the autopilot refuses is a device that failed: counted and told, not mistaken for a late one."""
        result = heard.message.result
        done = result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
        if self._answers_us(heard) and not done:
            what = f"autopilot refused to fire (command {heard.message.command}, result {result})"
            self._unfired.append(Rejected(Reject.DEVICE_FAILED, what, now_host_ns))

    def _from_autopilot(self, heard: Heard) -> bool:
        return (heard.system, heard.component) == (self.decoder.system_id, AUTOPILOT_COMPONENT)

    def _answers_us(self, heard: Heard) -> bool:
        """Whether an acknowledgement is the autopilot's, and for us: 0 is for everyone."""
        system, component = heard.message.target_system, heard.message.target_component
        to_us = system in (0, self._sender.system) and component in (0, self._settings.component_id)
        return self._from_autopilot(heard) and to_us

    def _is_ours(self, heard: Heard) -> bool:
        return self._answers_us(heard) and heard.message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL

    def set_own_parameter(self, name: str, value: float) -> None:
        """Set one of our own parameters for who is no ground station."""
        self.component.parameters.ask(name, value, self._clock.now_ns())

    def _upkeep(self, now_host_ns: int) -> None:
        """Send what is due."""
        system = self.decoder.system_id
        if system is not None:
            self._sender.system = system
            while self._held:
                self._sender.tell(dataclasses.replace(self._held.popleft(), at_host_ns=now_host_ns))
        if self._each_second.take(now_host_ns, "heartbeat"):
            unheard = [link.number for link in self._links if link.speaks_first]
            for number in unheard if system is None else [None]:
                self._sender.send(encode.heartbeat(self.health), number)
        if system is None:
            return
        for message in self.component.due(now_host_ns, busy=any(link.busy for link in self._links)):
            self._sender.send(message)
        if self._timesync.due(now_host_ns):  # answered by everyone who keeps a clock
            self._sender.send(mavlink.MAVLink_timesync_message(0, self._clock.now_ns()))
        request = self.rates.due(now_host_ns)
        if request is not None:
            self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, request.message, request.interval_us)
        name = self._parameters.due(now_host_ns)
        if name is not None:
            self._sender.request_parameter(name)
        if self._each_second.take(now_host_ns, "rates"):
            delivered = self.decoder.delivered
            counts = {message: n for (message, component), n in delivered.items() if component == AUTOPILOT_COMPONENT}
            self.rates.verify(counts, now_host_ns)

    def publish(self, record: Record) -> None:
        """Send a record in the form that the autopilot understands; others are not sent.

        A :class:`Shot` becomes the command that fires the autopilot's cameras: publish shots only where those are used.
        """
        if isinstance(record, CorrectedRange | NoRange | ObstacleSectors):
            px4 = self.decoder.px4
            for message in self._ranges.messages(record, self._boot_offset_ns, self._clock.now_ns(), px4=px4):
                self._sender.send(message)
        elif isinstance(record, Shot):
            request = self._firing.command(record, px4=self.decoder.px4)
            self._fired = request.command
            self.command(request.command, *request.parameters)
        elif isinstance(record, Notice):
            if self.decoder.system_id is None:
                if not self._absence.is_absence_notice(record):
                    self._held.append(record)
            else:
                self._sender.tell(record)
        elif isinstance(record, ServiceStatus):
            self.health = record.health
        elif isinstance(record, ClockState) and record.clock == ClockName.BOOT and record.synced:
            self._boot_offset_ns = record.offset_ns
        if isinstance(record, ModeState) and record.validity is Validity.TRACKING:
            self.rates.mode(max(record.symmetric.frequency_hz, record.antisymmetric.frequency_hz))
        for message in self._outputs.messages(record, self._settings, self._boot_offset_ns):
            self._sender.send(message)

    def adopt(self, settings: Settings) -> None:
        """Use changed live settings from now on."""
        self._settings = settings
        self._ranges.adopt(settings)

    def command(self, command: int, *parameters: float) -> None:
        """Send a COMMAND_LONG to the autopilot; parameters that are left out are 0."""
        self._sender.command(command, *parameters)

    def set_parameter(self, name: str, value: float) -> None:
        """Ask the autopilot to set one of its parameters; its PARAM_VALUE in answer tells what is in force."""
        self._sender.set_parameter(name, value, integer=self.decoder.px4 and name in self._integer_parameters)

    def close(self) -> None:
        """Release the links, and store what waits to be stored."""
        self.component.close()
        for link in self._links:
            link.close()
