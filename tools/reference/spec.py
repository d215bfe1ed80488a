"""Ingredients of a truth: modes, gust, rigid motion, sensors and the priors that their errors are drawn from."""

from __future__ import annotations

from dataclasses import dataclass, field

from tools.reference.rigid import RigidMotion

GRAVITY_MPS2 = 9.80665
SAMPLE_S = 0.001
STATIONS = ("root", "left", "right")


@dataclass(frozen=True, slots=True)
class GustShape:
    """Spectrum of the load on a mode: white through one real pole per corner, and at most one real zero."""

    name: str
    poles_hz: tuple[float, ...] = ()
    zero_hz: float | None = None


WHITE = GustShape("white")
# Dryden's vertical gust (1 + sqrt(3) tau s)/(1 + tau s)^2 with V/L = 2 pi 0.5 rad/s: 16 m/s through eddies of 5 m
DRYDEN = GustShape("dryden", (0.5, 0.5), 0.5 / 3**0.5)
TWO_EIGHT = GustShape("2+8", (2.0, 8.0))
FIVE_TWENTY = GustShape("5+20", (5.0, 20.0))
GUSTS = {shape.name: shape for shape in (WHITE, DRYDEN, TWO_EIGHT, FIVE_TWENTY)}


@dataclass(frozen=True, slots=True)
class ModeSpec:
    """One true mode; its load has the rms that gives ``rms_m`` of deflection."""

    frequency_hz: float
    damping: float
    rms_m: float
    slope_radpm: float = 1.39


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """One true inertial sensor at lateral position ``y_m``; noise is one-sided root density, ``*_sigma`` are priors.

    The defaults are an ICM-42688 (70 ug and 0.0028 deg/s per root hertz) with 2 mg and 0.05 deg/s over 1,000 s.
    """

    y_m: float
    sends: str = "xyzpqr"
    accel_noise_mps2_rthz: float = 0.0007
    gyro_noise_radps_rthz: float = 0.00005
    accel_bias_sigma_mps2: float = 0.02
    gyro_bias_sigma_radps: float = 0.0009
    bias_time_s: float = 1000.0
    accel_scale_sigma: float = 0.0
    gyro_scale_sigma: float = 0.0
    misalignment_sigma_rad: float = 0.0
    time_offset_sigma_s: float = 0.0


@dataclass(frozen=True, slots=True)
class TruthSpec:
    """One true aircraft in one flight. ``drift_per_s`` is d(ln f)/dt of the first modes."""

    symmetric: ModeSpec
    antisymmetric: ModeSpec
    gust: GustShape
    trim_bend_m: float
    bend_per_g_m: float
    motion: RigidMotion
    second_symmetric: ModeSpec | None = None
    drift_per_s: float = 0.0
    duration_s: float = 40.0
    root: SensorSpec = field(default_factory=lambda: SensorSpec(0.0))
    left: SensorSpec = field(default_factory=lambda: SensorSpec(-1.0))
    right: SensorSpec = field(default_factory=lambda: SensorSpec(1.0))
    slope_sigma_ratio: float = 0.0
    trim_sigma_m: float = 0.0
    bend_per_g_sigma_m: float = 0.0

    @property
    def modes(self) -> tuple[ModeSpec, ...]:
        """Symmetric, antisymmetric and, where it is, the second symmetric mode."""
        second = () if self.second_symmetric is None else (self.second_symmetric,)
        return (self.symmetric, self.antisymmetric, *second)

    @property
    def sensors(self) -> tuple[SensorSpec, SensorSpec, SensorSpec]:
        """Root, left, right."""
        return (self.root, self.left, self.right)
