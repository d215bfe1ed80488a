"""Evidence on a vehicle, and the findings of a check."""

from __future__ import annotations

import enum
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.adapters.mavlink.link.dialect import mavlink
from companion.adapters.mavlink.link.signing import Refusal
from companion.core.tracking.clipping import at_limit
from companion.core.tracking.streams import channel_ranges
from companion.evaluation.plan_outcomes import PlanOutcomes
from companion.params.airframe import Airframe
from companion.params.persist import decimal32
from companion.params.settings import Settings
from companion.params.vehicle import implausible
from companion.records import Axis, ClockName, ClockState, ImuBatch, Station


class FindingLevel(enum.StrEnum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"
    FIX = "FIX"
    UNKNOWN = "?"


@dataclass(frozen=True, slots=True)
class Fix:
    """An autopilot parameter and the value that it should have."""

    name: str
    value: float
    reboot: bool = False

    def __str__(self) -> str:
        return f"set {self.name} {self.value:g}" + (", reboot" if self.reboot else "")


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's report; ``fixes`` can be applied to the autopilot."""

    subject: str
    level: FindingLevel
    text: str
    fixes: tuple[Fix, ...] = ()

    @classmethod
    def ok(cls, subject: str, text: str) -> Finding:
        """Nothing to do."""
        return cls(subject, FindingLevel.OK, text)

    @classmethod
    def note(cls, subject: str, text: str, *fixes: Fix) -> Finding:
        """Something to know."""
        return cls(subject, FindingLevel.NOTE, text, fixes)

    @classmethod
    def fix(cls, subject: str, text: str, *fixes: Fix) -> Finding:
        """Something to mend."""
        return cls(subject, FindingLevel.FIX, text, fixes)


@dataclass(frozen=True, slots=True)
class Beat:
    """A component that was heard to beat."""

    kind: int
    autopilot: int
    count: int


class SampleCounts(NamedTuple):
    """Samples of a station at their sensor's limits, and all samples."""

    clipped: int
    total: int


@dataclass(slots=True)
class Evidence:
    """Everything seen, of a live vehicle or in a log.

    ``live`` is False for a log, where what cannot be seen is unknown rather than wrong; ``onboard`` says that the
    autopilot wrote it, without messages of other components and at rates of its own. ``beats`` goes by (system,
    component); ``parameters`` are the autopilot's, as far as it sent them. ``rate_hz`` and ``axes`` are samples per
    second as delivered, and the axes that really come. ``range_senders`` counts the DISTANCE_SENSOR messages of others,
    by (system, component, orientation); ``serial_baud`` has the links that have a baud rate, ``link_components`` the
    vehicle's components that were heard on each. ``feedback`` has, by camera, the numbers of the pictures in
    CAMERA_FEEDBACK; with two cameras ArduPilot sends each more than once.

    Of a recording of ours, ``shots`` were fired, ``pairs`` of images matched, ``unpaired`` images had no partner and
    ``lost`` ones never came; ``plan_outcomes`` counts the end of every plan to fire. ``node_counters`` are the
    wing nodes' newest counters since they started, by (component, name) of NAMED_VALUE_INT, and ``node_losses`` by how
    much each has grown while it was heard. ``clipped`` counts the samples at their sensor's limits and
    all of them; ``autopilot_clips`` are the sums of VIBRATION's three counters of clipped samples, in order.
    ``realtime`` is whether this user may take a real-time priority, None where that is not known.
    ``refused`` counts the frames that signing did not let in, by reason.
    ``buffer_shortfall`` are the bytes that may wait in a link's UDP socket and those that were asked for, None where
    they are granted or no link has one.
    """

    airframe: Airframe
    settings: Settings
    live: bool
    onboard: bool = False
    seconds: float = 0.0
    system: int | None = None
    beats: dict[tuple[int, int], Beat] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    rate_hz: dict[Station, float] = field(default_factory=dict)
    axes: dict[Station, Axis] = field(default_factory=dict)
    foreign_imu: Counter[str] = field(default_factory=Counter)
    clocks: dict[ClockName, ClockState] = field(default_factory=dict)
    range_senders: Counter[tuple[int, int, int]] = field(default_factory=Counter)
    feedback: dict[int, set[int]] = field(default_factory=dict)
    shots: int = 0
    pairs: int = 0
    unpaired: int = 0
    lost: int = 0
    plan_outcomes: PlanOutcomes = field(default_factory=PlanOutcomes)
    acknowledged: int = 0
    twice: int = 0
    frames: int = 0
    crc_errors: int = 0
    skipped_bytes: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)
    serial_baud: dict[str, int] = field(default_factory=dict)
    link_components: dict[str, set[int]] = field(default_factory=dict)
    node_counters: dict[tuple[int, str], int] = field(default_factory=dict)
    node_losses: Counter[tuple[int, str]] = field(default_factory=Counter)
    clipped: dict[Station, SampleCounts] = field(default_factory=dict)
    autopilot_clips: list[int] = field(default_factory=list)
    realtime: bool | None = None
    buffer_shortfall: tuple[int, int] | None = None

    @property
    def pilot(self) -> Beat | None:
        """The autopilot's heartbeat."""
        return None if self.system is None else self.beats.get((self.system, 1))

    @property
    def px4(self) -> bool:
        """Whether the autopilot says that it is PX4, or its log has PX4's parameters."""
        if self.pilot is None:
            return "IMU_ACCEL_CUTOFF" in self.parameters
        return self.pilot.autopilot == int(mavlink.MAV_AUTOPILOT_PX4)

    @property
    def highest_hz(self) -> float:
        """The higher of the two first bending modes, as the airframe believes."""
        wing = self.airframe.wing
        return max(wing.symmetric.frequency_hz.value, wing.antisymmetric.frequency_hz.value)

    def count_samples(self, batch: ImuBatch) -> None:
        """Add a batch to the axes that come, and to the counts of clipped samples."""
        self.axes[batch.station] = self.axes.get(batch.station, batch.axes) | batch.axes
        clipped, total = self.clipped.get(batch.station, SampleCounts(0, 0))
        full = np.asarray(at_limit(batch.values, channel_ranges(self.airframe.sensor(batch.station))).any(axis=(0, 2)))
        self.clipped[batch.station] = SampleCounts(clipped + int(full.sum()), total + len(full))

    def parameter(self, *names: str) -> tuple[str, float] | None:
        """The first of these names that the vehicle has with a value that can be; versions differ in names."""
        sent = ((name, decimal32(self.parameters[name])) for name in names if name in self.parameters)
        return next((entry for entry in sent if implausible(*entry) is None), None)

    def missing(self, subject: str, what: str) -> Finding:
        """A finding about something that was not told, or not so that it can be believed."""
        why = "answered by the autopilot" if self.live else "logged"
        if what in self.parameters:
            why = f"known, for {self.parameters[what]:g} cannot be"
        return Finding(subject, FindingLevel.UNKNOWN, f"{what}: not {why}")
