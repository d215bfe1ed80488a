"""Everything that the estimation knows, and what it begins with."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from companion.core.autopilot_filters import VehicleFilters
from companion.core.clock.bank import ClockBank
from companion.core.clock.unsynced_nodes import UnsyncedNodes
from companion.core.output_scheduler import OutputScheduler
from companion.core.rate_monitor import StreamRateMonitor
from companion.core.silence import Complaints, RangeSilence
from companion.core.stereo.correction import Correction
from companion.core.tracking.tracker import WingTracker
from companion.core.trigger.exposure_feedback import ExposureFeedback
from companion.core.trigger.latency import LatencyModel
from companion.core.trigger.scheduling import Scheduling
from companion.core.wing.effects import apply_to_airframe
from companion.core.wing.sample_corrections import SampleCorrections
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.rate_limiter import RateLimiter
from companion.records import ClockName, ImuBatch, Station, Validity, VehicleState

_ERROR_PERIOD_NS = 1_000_000_000  # the heartbeat's: an error that stays is told once in it (choice)


@dataclass(slots=True)
class PipelineState:
    """Everything that the estimation knows. Built by :func:`start`; only :func:`step` changes it."""

    airframe: Airframe
    settings: Settings
    clocks: ClockBank
    tracker: WingTracker
    scheduling: Scheduling | None
    correction: Correction | None
    output_scheduler: OutputScheduler
    feedback: ExposureFeedback
    corrections: SampleCorrections = field(default_factory=SampleCorrections)
    rate_monitor: StreamRateMonitor = field(default_factory=StreamRateMonitor)
    filters: VehicleFilters = field(default_factory=VehicleFilters)
    unsynced_nodes: UnsyncedNodes = field(default_factory=UnsyncedNodes)
    silence: RangeSilence = field(default_factory=RangeSilence)
    complaints: Complaints = field(default_factory=Complaints)
    validity: Validity | None = None  # of what the tracker says; None until there is something
    vehicle: VehicleState | None = None
    on_ground: bool = False  # as the autopilot said last, whatever it has left open since
    counters: Counter[str] = field(default_factory=Counter)
    waiting: dict[Station, list[ImuBatch]] = field(default_factory=dict)
    next_track_ns: int = 0
    airborne_ns: int | None = None  # when a wing that has just lifted off will bend by its load alone
    next_status_ns: int = 0
    hub: ClockName | None = None
    now_ns: int = 0  # of the last tick, for what has no time of its own
    errors: RateLimiter = field(default_factory=lambda: RateLimiter(_ERROR_PERIOD_NS))


def start(
    airframe: Airframe, settings: Settings, hub: ClockName | None = None, clocks: ClockBank | None = None
) -> PipelineState:
    """Begin with the airframe's beliefs.

    ``hub`` names the only clock of a log that has just one; ``clocks`` is what is known of them from before.
    """
    corrections = SampleCorrections.of(airframe)
    airframe = apply_to_airframe(airframe)
    if clocks is None:
        clocks = ClockBank()
        if hub is not None:
            clocks.identity(hub)
    has_cameras = airframe.left_camera is not None and airframe.right_camera is not None
    scheduling = Scheduling.create(airframe, settings) if has_cameras else None
    latency = LatencyModel(airframe) if scheduling is None else scheduling.latency
    return PipelineState(
        airframe=airframe,
        settings=settings,
        clocks=clocks,
        tracker=WingTracker(airframe, settings),
        scheduling=scheduling,
        correction=Correction.create(airframe, settings) if has_cameras else None,
        output_scheduler=OutputScheduler(airframe.orientation),
        feedback=ExposureFeedback(airframe, clocks, latency),
        corrections=corrections,
        hub=hub,
    )
