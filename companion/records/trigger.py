"""Plans to fire, what became of them, and the latency learned from it."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records.vocabulary import Firing, Floats, Reject


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
