"""The airframe as the tracker is made to believe it: the truth with everything wrong that a builder gets wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.params.airframe import Airframe, Gust, Mode, Sensor, Source, Uncertain, Wing
from companion.records import ClockName
from tools.reference.spec import ModeSpec, SensorSpec, TruthSpec

_EXACT_M = 1e-6  # a sigma that leaves nothing to estimate
_ENDLESS = 1e6  # the truth's sensors do not clip: a sample that happens to lie at a range's end is as good as any
_SECOND_RATIO = 5.4  # of a second bending mode's frequency to the first's
SECOND_SLOPE_RADPM = 4.78


@dataclass(frozen=True, slots=True)
class Perturbation:
    """How wrong the belief is: each factor is drawn as its value or the inverse of it, by seed."""

    frequency: float = 1.10
    damping: float = 2.0
    gust: float = 2.0
    second: str = "wrong"  # "wrong": believed with wrong numbers, "none": not believed at all


def believed_airframe(spec: TruthSpec, seed: int, perturbation: Perturbation) -> Airframe:
    """Give the tracker's airframe for one seed."""
    draw = np.random.default_rng([seed, 16])
    symmetric = _mode(spec.symmetric, draw, perturbation, spec.slope_sigma_ratio)
    antisymmetric = _mode(spec.antisymmetric, draw, perturbation, spec.slope_sigma_ratio)
    second = _second(spec, draw, perturbation) if perturbation.second != "none" else None
    gust_factor = perturbation.gust ** draw.uniform(-1, 1)
    corners = (0.0, 0.0) if draw.random() < 0.5 else (2.0, 20.0)
    rms = spec.symmetric.rms_m * gust_factor
    wing = Wing(
        semispan_m=abs(spec.left.y_m),
        symmetric=symmetric,
        antisymmetric=antisymmetric,
        gust=Gust(Uncertain(rms, 0.8 * rms), corners),
        trim_bend_m=Uncertain(spec.trim_bend_m, max(spec.trim_sigma_m, _EXACT_M)),
        bend_per_g_m=Uncertain(spec.bend_per_g_m, max(spec.bend_per_g_sigma_m, _EXACT_M)),
        second_symmetric=second,
        shortening=Uncertain(0.0),
    )
    root, left, right = (_sensor(sensor) for sensor in spec.sensors)
    return Airframe("bench", "a truth with its belief perturbed", wing, root, left, right)


def _mode(mode: ModeSpec, draw: np.random.Generator, wrong: Perturbation, slope_sigma_ratio: float) -> Mode:
    frequency = mode.frequency_hz * (1 + (wrong.frequency - 1) * draw.uniform(-1, 1))
    damping = mode.damping * wrong.damping ** draw.choice([-1.0, 1.0])
    slope = mode.slope_radpm
    return Mode(
        frequency_hz=Uncertain(frequency, 0.07 * frequency),
        damping=Uncertain(damping, 0.5 * damping),
        slope_factor_radpm=Uncertain(slope, max(slope_sigma_ratio, 1e-5) * slope),
    )


def _second(spec: TruthSpec, draw: np.random.Generator, wrong: Perturbation) -> Mode:
    first = spec.symmetric
    true = spec.second_symmetric or ModeSpec(
        _SECOND_RATIO * first.frequency_hz, 0.02, 0.01 * first.rms_m, SECOND_SLOPE_RADPM
    )
    return _mode(true, draw, wrong, spec.slope_sigma_ratio)


def second_mode(first: ModeSpec) -> ModeSpec:
    """A second mode with one hundredth of the first's deflection."""
    return ModeSpec(_SECOND_RATIO * first.frequency_hz, 0.02, 0.01 * first.rms_m, SECOND_SLOPE_RADPM)


def _sensor(spec: SensorSpec) -> Sensor:
    return Sensor(
        source=Source("HIGHRES_IMU", 1, ClockName.HOST),
        position_m=(0.0, spec.y_m, 0.0),
        rate_hz=1000.0,
        sends=spec.sends,
        accel_noise_mps2_rthz=spec.accel_noise_mps2_rthz,
        gyro_noise_radps_rthz=spec.gyro_noise_radps_rthz,
        accel_bias_sigma_mps2=spec.accel_bias_sigma_mps2,
        gyro_bias_sigma_radps=spec.gyro_bias_sigma_radps,
        bias_time_s=spec.bias_time_s,
        accel_scale_sigma=spec.accel_scale_sigma,
        gyro_scale_sigma=spec.gyro_scale_sigma,
        misalignment_sigma_rad=spec.misalignment_sigma_rad,
        time_offset_sigma_s=spec.time_offset_sigma_s,
        accel_range_mps2=_ENDLESS,
        gyro_range_radps=_ENDLESS,
    )
