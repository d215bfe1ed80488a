"""Names that records share: stations, sides, clocks, axes, reasons of refusal, states of health."""

from __future__ import annotations

import enum

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]
Complexes = npt.NDArray[np.complex128]
AXIS_LETTERS = "xyzpqr"
"""Axes of an inertial sensor: specific force along x, y, z, angular rate about them."""


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

    @classmethod
    def of(cls, letters: str) -> Axis:
        """The axes of some letters of "xyzpqr"."""
        return cls(sum(1 << AXIS_LETTERS.index(letter) for letter in set(letters)))

    @property
    def columns(self) -> list[int]:
        """Columns of ``ImuBatch.values`` that hold these axes."""
        return [column for column in range(len(AXIS_LETTERS)) if self >> column & 1]

    @property
    def mask(self) -> Bools:
        """Whether each column of ``ImuBatch.values`` holds one of them, (6,)."""
        bits = int(self)
        return np.array([bits >> column & 1 for column in range(len(AXIS_LETTERS))], dtype=np.bool_)

    @property
    def letters(self) -> str:
        """Their letters, in the order of "xyzpqr"."""
        return "".join(AXIS_LETTERS[column] for column in self.columns)


class Reject(enum.StrEnum):
    """Why something was refused. Counted, shown, and never replaced by a guess."""

    CLOCK_UNSYNCED = "clock not synced"
    STALE = "stream stopped"
    NO_MODE = "no mode to track"
    MODE_AMBIGUOUS = "mode ambiguous"
    SATURATED = "sensor saturated"
    BEYOND_RANGE = "value beyond the sensor's range"
    LAPSED = "sample contradicts all its neighbours"
    NOT_SETTLED = "tracker not settled"
    NOT_FITTED = "the wing's modes could not be fitted"
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
    FROZEN = "image equal to the one before"
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
