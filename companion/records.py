"""The vocabulary of the whole flow: frozen records, SI units, explicit clocks.

Every record is a frozen, slotted dataclass. Times are integer nanoseconds whose clock is in the name:
``_host_ns`` is the companion's monotonic clock (in the replay of a log that has one clock only, that clock stands in),
``_boot_ns`` the autopilot's, ``_node_ns`` a wing node's, ``_cam_ns`` a camera's; a bare ``t_ns`` stands beside a
``clock`` field that names it. Axes are body FRD. Modal coordinates are ``[symmetric, antisymmetric]`` in metres at the
tip, positive when the tips bend up; tip quantities are ``[left, right]``:
``left = symmetric - antisymmetric``, ``right = symmetric + antisymmetric``.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]


class Station(enum.IntEnum):
    """Where an inertial sensor sits."""

    ROOT = 0
    LEFT = 1
    RIGHT = 2


class Side(enum.IntEnum):
    """A wing half, or the camera on it."""

    LEFT = 0
    RIGHT = 1


class ClockName(enum.StrEnum):
    """The clocks that a stamp may belong to."""

    HOST = "host"
    BOOT = "boot"
    NODE_LEFT = "node_left"
    NODE_RIGHT = "node_right"
    CAM_LEFT = "cam_left"
    CAM_RIGHT = "cam_right"


class Axis(enum.IntFlag):
    """Axes that a sensor really sends; column ``i`` of ``ImuBatch.values`` is bit ``1 << i``."""

    NONE = 0
    X = 1
    Y = 2
    Z = 4
    P = 8
    Q = 16
    R = 32
    ACCEL = 7
    GYRO = 56
    ALL = 63


class Reject(enum.StrEnum):
    """Why something was refused. Counted, shown, and never replaced by a guess."""

    CLOCK_UNSYNCED = "clock not synced"
    STALE = "stream stopped"
    NO_MODE = "no mode to track"
    EXCITATION_LOW = "excitation too low"
    MODE_AMBIGUOUS = "mode ambiguous"
    SATURATED = "sensor saturated"
    BEYOND_RANGE = "value beyond the sensor's range"
    LAPSED = "sample contradicts all its neighbours"
    NOT_SETTLED = "tracker not settled"
    OUT_OF_WINDOW = "outside the smoother's window"
    TOO_LATE = "sample older than the reorder window"
    NOT_FINITE = "value not finite"
    TIME_BACKWARDS = "time went backwards"
    NO_PAIRS = "no image pairs"
    NO_MATCHES = "too few matches"
    SIGMA_TOO_LARGE = "sigma too large"
    OUT_OF_RANGE = "range outside its limits"
    INCONSISTENT = "inconsistent with the last ranges"
    CONTRADICTED = "the sensors contradict the wing's model"
    MATCHES_CONTRADICT = "the matches contradict the sensors"
    ON_GROUND = "aircraft on the ground"
    STAMP_OUTLIER = "exposure stamped off its learned latency"
    PEAK_UNCERTAIN = "peak time too uncertain"
    BLUR_TOO_LARGE = "predicted blur too large"
    PLAN_EXPIRED = "plan expired before it could be fired"
    DEVICE_FAILED = "device failed"
    QUEUE_FULL = "queue full"
    UNPAIRED = "frame without a partner"
    FRAME_LOST = "exposure whose image never came"
    FOREIGN_SOURCE = "message from a component that is not mapped"
    CRC = "checksum wrong"
    IMPLAUSIBLE = "parameter outside its plausible range"
    INTERNAL_ERROR = "internal error"


class Validity(enum.StrEnum):
    """Uses that a :class:`ModeState` allows."""

    TRACKING = "tracking"
    CALM = "calm"
    SETTLING = "settling"
    AMBIGUOUS = "ambiguous"
    INCONSISTENT = "inconsistent"
    STALE = "stale"
    SATURATED = "saturated"


class Firing(enum.StrEnum):
    """Why a plan fires when it does."""

    PEAK = "peak"
    TIMER = "timer"
    CALM = "calm"
    SKIP = "skip"


class Health(enum.StrEnum):
    """The service's own state, as the heartbeat tells it."""

    BOOT = "boot"
    STANDBY = "standby"
    ACTIVE = "active"
    CRITICAL = "critical"


# --------------------------------------------------------------------------------------------- inputs


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
    """The autopilot's own view of the flight; ``on_ground`` is None where it does not tell."""

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


@dataclass(frozen=True, slots=True)
class Frame:
    """One image with its measured exposure.

    Attributes
    ----------
    image : (rows, columns) uint8
    mid_exposure_ns : int
        Middle of the exposure of the middle row, on ``clock``.
    row_time_ns : int
        Time between the starts of two rows; 0 for a global shutter.
    """

    side: Side
    sequence: int
    clock: ClockName
    mid_exposure_ns: int
    exposure_ns: int
    row_time_ns: int
    plan_id: int
    image: Bytes


@dataclass(frozen=True, slots=True)
class FramePair:
    """A left and a right frame of the same shot."""

    pair_id: int
    left: Frame
    right: Frame


@dataclass(frozen=True, slots=True)
class MatchSet:
    """Matched features of one pair, in raw (distorted) pixels: what vision hands to the correction.

    Attributes
    ----------
    left_px, right_px : (n, 2) float64
        Column, row of each match.
    sigma_px : (n,) float64
        One-sigma of the match along the epipolar line.
    mid_exposure_ns : (2,) int64
        Left and right mid-exposure on ``clocks``.
    filled : int
        So many at the end are no features but places between them, found by dense disparity: for the obstacle picture.
    """

    pair_id: int
    plan_id: int
    clocks: tuple[ClockName, ClockName]
    mid_exposure_ns: Ints
    exposure_ns: int
    row_time_ns: int
    left_px: Floats
    right_px: Floats
    sigma_px: Floats
    matched_host_ns: int
    filled: int = 0

    def features(self) -> MatchSet:
        """The same without what fills the picture: ranges and rotations are taken from features alone."""
        if not self.filled:
            return self
        triangulated = slice(0, len(self.sigma_px) - self.filled)
        return replace(
            self,
            left_px=self.left_px[triangulated],
            right_px=self.right_px[triangulated],
            sigma_px=self.sigma_px[triangulated],
            filled=0,
        )


# --------------------------------------------------------------------------------------------- states


@dataclass(frozen=True, slots=True)
class ClockState:
    """Estimate of a remote clock: ``remote = host + offset``."""

    clock: ClockName
    at_host_ns: int
    offset_ns: int
    skew_ppm: float
    bound_ns: int
    synced: bool


@dataclass(frozen=True, slots=True)
class ModeEstimate:
    """One bending mode now: ``q(t) = amplitude cos(phase)``, so the deflection peaks at phase 0 and pi."""

    frequency_hz: float
    frequency_sigma_hz: float
    damping: float
    damping_sigma: float
    amplitude_m: float
    amplitude_sigma_m: float
    phase_rad: float
    phase_sigma_rad: float
    instantaneous_hz: float
    instantaneous_sigma_hz: float
    rms_m: float

    @property
    def swings(self) -> bool:
        """Whether the swing stands out from what is not known of it."""
        return self.rms_m > self.amplitude_sigma_m


@dataclass(frozen=True, slots=True)
class ModeState:
    """The wing as the causal tracker sees it."""

    t_host_ns: int
    symmetric: ModeEstimate
    antisymmetric: ModeEstimate
    validity: Validity
    q_m: Floats
    q_sigma_m: Floats
    stations: tuple[Station, ...]
    axes: tuple[Axis, ...]


@dataclass(frozen=True, slots=True)
class Deflection:
    """The wing at one past instant, from the fixed-lag smoother (or causal, as ``lag_ns`` tells).

    Attributes
    ----------
    q_m, qdot_mps : (2,) float64
        Symmetric and antisymmetric modal coordinate and its rate, trim bend included.
    slope_rad : (2,) float64
        Bending slope at the left and right tip station, positive tips up, with all modes and estimated slope factors.
    covariance : (6, 6) float64
        Of ``[q_m, qdot_mps, slope_rad]``.
    body_rate_radps : (3,) float64
        Rigid body rate at that instant, for bridging unequal exposures.
    slow_slope_sigma_rad : float
        The part of the symmetric slope's sigma that is slow (trim bend, tilt bias), one tip.
    fast_slope_time_s : float
        Correlation time of the rest of the symmetric slope's error: the noisier the sensors, the longer.
    """

    t_host_ns: int
    q_m: Floats
    qdot_mps: Floats
    slope_rad: Floats
    covariance: Floats
    body_rate_radps: Floats
    lag_ns: int
    slow_slope_sigma_rad: float
    fast_slope_time_s: float = 0.0


# --------------------------------------------------------------------------------------------- outputs


@dataclass(frozen=True, slots=True)
class TriggerPlan:
    """When to fire. The newest plan replaces the older ones; a plan past ``expires_host_ns`` is not fired."""

    plan_id: int
    firing: Firing
    command_host_ns: int
    exposure_host_ns: int
    sigma_ns: int
    blur_px: float
    expires_host_ns: int
    planned_host_ns: int
    reject: Reject | None = None


@dataclass(frozen=True, slots=True)
class Shot:
    """Shot that the trigger process made of a plan."""

    plan_id: int
    planned_host_ns: int
    fired_host_ns: int


@dataclass(frozen=True, slots=True)
class CameraFeedback:
    """The autopilot felt the shutter of a camera of its own (0 left, 1 right) on the hot-shoe pin.

    ``t_ns`` is boot time cut to 32 bits of microseconds: it starts again every 71.6 minutes.
    """

    camera: int
    image: int
    t_ns: int
    received_host_ns: int


@dataclass(frozen=True, slots=True)
class TriggerLatency:
    """Learned time from the command to the start of the exposure, left and right camera.

    Attributes
    ----------
    latency_s, sigma_s : (2,) float64
        Bias, and how far the next shot may be from it: its sigma and the spread from shot to shot together.
    shots : int
        Exposures that it rests on, of the camera with fewer.
    """

    at_host_ns: int
    latency_s: Floats
    sigma_s: Floats
    shots: int


@dataclass(frozen=True, slots=True)
class CorrectedRange:
    """A range at mid-exposure, corrected for the bend, with everything that tells how far to trust it.

    ``toe_rad`` is the relative rotation that was taken out (positive: axes diverge, the raw range reads short);
    ``rigid_range_m`` is what the ground calibration alone would have said (0 where it has no finite answer).
    """

    pair_id: int
    plan_id: int
    t_host_ns: int
    orientation: int
    range_m: float
    sigma_m: float
    toe_rad: float
    toe_sigma_rad: float
    rigid_range_m: float
    matches: int
    trusted: bool
    reject: Reject | None


@dataclass(frozen=True, slots=True)
class RelativeRotation:
    """Rotation of the right camera against the left beyond the tracked bend, from one pair's matches.

    Rotation vectors in the epipolar frame: x along the baseline (pitch), y across it (yaw: the toe of a pair), z where
    the cameras look (roll). Yaw is seen weakly in distant flat scenes; the covariances say how weakly.

    Attributes
    ----------
    rotation_rad, covariance : (3,), (3, 3) float64
        At this exposure, what the tracker's fast part has wrong included: the pair is corrected by this.
    slow_rad, slow_covariance : (3,), (3, 3) float64
        The slow part alone (static bend, thermal set, mounting), carried from pair to pair.
    parallax_scale : float
        How much more the matches scatter across the epipolar lines than their sigmas say; 0 where none were used.
    lens : (7,) float64
        Residual of the lenses, left minus right: relative focal length, first radial term, keystone x and y, thin prism
        x and y; mean of the two radial terms (:mod:`companion.core.stereo.lens_residual`).
    """

    pair_id: int
    t_host_ns: int
    rotation_rad: Floats
    covariance: Floats
    slow_rad: Floats
    slow_covariance: Floats
    matches: int
    parallax_scale: float
    lens: Floats = field(default_factory=lambda: np.zeros(7))


@dataclass(frozen=True, slots=True)
class NoRange:
    """Alive, but without a range to trust: what goes out instead of an old number."""

    at_host_ns: int
    orientation: int
    reject: Reject


@dataclass(frozen=True, slots=True)
class ObstacleSectors:
    """Nearest obstacle in each of 72 sectors of 5 degrees, clockwise from forward, body FRD.

    ``distance_m`` is meaningful where ``known``; ``clear`` marks sectors that were looked at and found empty.
    """

    t_host_ns: int
    distance_m: Floats
    sigma_m: Floats
    known: Bools
    clear: Bools
    min_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class Rejected:
    """A refusal, with what it befell."""

    reason: Reject
    what: str
    at_host_ns: int
    count: int = 1


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence for the operator; ``severity`` as in MAV_SEVERITY (3 error, 4 warning, 6 info)."""

    severity: int
    text: str
    at_host_ns: int


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """The service's health and counters, once a second."""

    at_host_ns: int
    health: Health
    reason: str
    counters: dict[str, int] = field(default_factory=dict)


InputRecord = (
    RawChunk
    | ImuBatch
    | TimesyncReply
    | ClockRestart
    | VehicleState
    | AutopilotParameter
    | ParameterChange
    | Tick
    | MatchSet
    | Frame
    | FramePair
    | Shot
    | CameraFeedback
)
OutputRecord = (
    ClockState
    | ModeState
    | Deflection
    | TriggerPlan
    | TriggerLatency
    | CorrectedRange
    | RelativeRotation
    | NoRange
    | ObstacleSectors
    | Rejected
    | Notice
    | ServiceStatus
)
Record = InputRecord | OutputRecord
