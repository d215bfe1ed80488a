"""The vocabulary of the whole flow: frozen records, SI units, explicit clocks.

Every record is a frozen, slotted dataclass. Times are integer nanoseconds whose clock is in the name:
``_host_ns`` is the companion's monotonic clock (in the replay of a log that has one clock only, that clock stands in),
``_boot_ns`` the autopilot's, ``_node_ns`` a wing node's, ``_cam_ns`` a camera's; a bare ``t_ns`` stands beside a
``clock`` field that names it. Axes are body FRD. Modal coordinates are ``[symmetric, antisymmetric]`` in metres at the
tip, positive when the tips bend up; tip quantities are ``[left, right]``:
``left = symmetric - antisymmetric``, ``right = symmetric + antisymmetric``.
"""

from __future__ import annotations

from companion.records.imaging import PLAN_UNKNOWN, Flow, Frame, FramePair, MatchSet
from companion.records.inertial import (
    AutopilotParameter,
    ClockRestart,
    ImuBatch,
    ParameterChange,
    RawChunk,
    Tick,
    TimesyncReply,
    VehicleState,
)
from companion.records.ranging import CorrectedRange, NoRange, ObstacleSectors, RelativeRotation
from companion.records.service import OVERLOADED, Notice, Rejected, ServiceStatus
from companion.records.tracking import ClockState, Deflection, ModeEstimate, ModeState
from companion.records.trigger import CameraFeedback, Shot, TriggerLatency, TriggerPlan
from companion.records.vocabulary import (
    AXIS_LETTERS,
    Axis,
    Bools,
    Bytes,
    ClockName,
    Complexes,
    Firing,
    Floats,
    Health,
    Ints,
    Reject,
    Side,
    Station,
    Validity,
)

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

__all__ = [
    "AXIS_LETTERS", "OVERLOADED", "PLAN_UNKNOWN", "AutopilotParameter", "Axis", "Bools", "Bytes", "CameraFeedback",
    "ClockName", "ClockRestart", "ClockState", "Complexes", "CorrectedRange", "Deflection", "Firing", "Floats", "Flow",
    "Frame", "FramePair", "Health", "ImuBatch", "InputRecord", "Ints", "MatchSet", "ModeEstimate", "ModeState",
    "NoRange", "Notice", "ObstacleSectors", "OutputRecord", "ParameterChange", "RawChunk", "Record", "Reject",
    "Rejected", "RelativeRotation", "ServiceStatus", "Shot", "Side", "Station", "Tick", "TimesyncReply",
    "TriggerLatency", "TriggerPlan", "Validity", "VehicleState",
]  # fmt: skip
