"""Clocks and wing as they are estimated."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records.vocabulary import Axis, ClockName, Floats, Station, Validity


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
    manoeuvre_slope_sigma_rad : float
        The part of ``slow_slope_sigma_rad`` that a manoeuvre brings and takes away.
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
    manoeuvre_slope_sigma_rad: float = 0.0
