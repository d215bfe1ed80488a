"""Records that arrive on the link: bytes, inertial samples, clock exchanges, the vehicle, parameters, the timer."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records.vocabulary import Axis, ClockName, Floats, Ints, Station


@dataclass(frozen=True, slots=True)
class RawChunk:
    """Bytes as one read of a link returned them: the first thing that is recorded."""

    link: int
    received_host_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class ImuBatch:
    """Consecutive samples of one inertial sensor, in arrival order.

    Attributes
    ----------
    t_ns : (n,) int64
        Sample stamps on ``clock``.
    values : (n, 6) float64
        Specific force x, y, z in m/s^2, then angular rate p, q, r in rad/s, body FRD (after axes and signs mapping,
        before calibration). Columns not in ``axes`` are zero.
    """

    station: Station
    clock: ClockName
    t_ns: Ints
    values: Floats
    axes: Axis
    received_host_ns: int


@dataclass(frozen=True, slots=True)
class TimesyncReply:
    """One answered TIMESYNC exchange of ours with the component that owns ``clock``."""

    clock: ClockName
    sent_host_ns: int
    remote_ns: int
    received_host_ns: int


@dataclass(frozen=True, slots=True)
class ClockRestart:
    """A component restarted: its clock went back, and what was known of it is void."""

    clock: ClockName
    seen_host_ns: int


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The autopilot's own view of the flight; what it does not tell is None.

    ``velocity_ned_mps`` is over ground: north, east, down, by its navigation filter; ``velocity_sigma_mps`` is what the
    satellite receiver behind it states of itself. ``air_host_ns`` is when airspeed, climb and throttle were received,
    where they came by themselves; None: with the attitude.
    """

    t_boot_ns: int
    received_host_ns: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    airspeed_mps: float
    climb_mps: float
    throttle: float
    armed: bool
    on_ground: bool | None = None
    velocity_ned_mps: tuple[float, float, float] | None = None
    velocity_sigma_mps: float | None = None
    air_host_ns: int | None = None


@dataclass(frozen=True, slots=True)
class AutopilotParameter:
    """A parameter of the autopilot that Spanwise depends on (filters, loop rate, range finder)."""

    name: str
    value: float
    received_host_ns: int


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """One of our own live parameters was set."""

    name: str
    value: float
    changed_host_ns: int


@dataclass(frozen=True, slots=True)
class Tick:
    """The service's timer: planning and publishing happen on it, so that a replay repeats them."""

    now_host_ns: int
