"""Predicted motion blur of both cameras, from bending, body rate and ground speed together (DESIGN, rule 9).

The image of a point at depth Z near the optical axis moves, in camera axes (x right, y down, z forward), by::

    u' = f (-omega_y - v_x / Z),   v' = f (omega_x - v_y / Z)

and a roll omega_z about the axis moves a pixel at radius rho by omega_z rho, here its rms over the image. All three are
linear in the tip's slope rate, so blur^2 is a quadratic of the forecast and its expectation needs the covariance only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.compiled import compiled
from companion.core.mode.forecast import Forecast
from companion.core.stereo.geometry import Rig
from companion.core.trigger.latency import LatencyModel
from companion.params.airframe import Airframe, Camera
from companion.records import Floats, Ints, Side


@dataclass(frozen=True, slots=True)
class Motion:
    """Rigid motion that the forecast does not hold.

    Attributes
    ----------
    velocity_body_mps : (3,) float64
        Velocity over ground, body axes.
    range_m : float
        Distance of the scene along the optical axis; infinite where unknown.
    """

    velocity_body_mps: Floats = field(default_factory=lambda: np.zeros(3))
    range_m: float = np.inf


@dataclass(frozen=True, slots=True)
class BlurForecast:
    """Blur over a forecast's instants, each side at its own mid-exposure.

    Attributes
    ----------
    t_host_ns : (n,) int64
        Mean of both mid-exposures.
    motion : (n, 2, 3) float64
        Left and right image motion along x, y and roll; blur is its length. px, of one exposure.
    motion_per_rate : (2, 3) float64
        What a slope rate of 1 rad/s adds to it.
    rate_radps, acceleration_radps2 : (n, 2) float64
        Slope rate at each side's exposure, and its derivative.
    rate_covariance, acceleration_covariance : (n, 2, 2) float64
    rms_px : (n, 2) float64
        Expected rms blur, with the uncertainty of rate and exposure time, and the motion within the exposure.
    """

    t_host_ns: Ints
    motion: Floats
    motion_per_rate: Floats
    rate_radps: Floats
    acceleration_radps2: Floats
    rate_covariance: Floats
    acceleration_covariance: Floats
    rms_px: Floats


class BlurModel:
    """The cameras of one airframe, as far as blur goes; without cameras, slope rate alone counts (and blur is 0 px)."""

    def __init__(self, airframe: Airframe) -> None:
        self._eyes: _Eyes | None = None
        self._spring = _spring(airframe)
        left, right = airframe.left_camera, airframe.right_camera
        if left is not None and right is not None:
            self._eyes = _eyes(airframe, (left, right))

    def predict(self, forecast: Forecast, latency: LatencyModel, motion: Motion) -> BlurForecast:
        """Predict the blur at every instant of the forecast."""
        step_s = float(forecast.t_host_ns[1] - forecast.t_host_ns[0]) * 1e-9
        rigid, per_rate, exposure_s = self._linear(forecast.body_rate_radps, motion)
        shifts_s, sigmas_s = np.array(latency.shifts_ns()) * 1e-9, np.array(latency.sigmas_ns()) * 1e-9
        rates, covariance = forecast.slope_rate_radps, forecast.slope_rate_covariance
        image, rate, acceleration, rms = _smeared(
            rates, covariance, step_s, shifts_s, sigmas_s, rigid, per_rate, exposure_s
        )
        return BlurForecast(
            t_host_ns=forecast.t_host_ns,
            motion=image,
            motion_per_rate=per_rate,
            rate_radps=rate,
            acceleration_radps2=acceleration,
            rate_covariance=covariance,
            acceleration_covariance=_turned(self._spring, forecast.q_covariance),
            rms_px=rms if self._eyes else np.zeros_like(rms),
        )

    def _linear(self, body_rate_radps: Floats, motion: Motion) -> tuple[Floats, Floats, Floats]:
        """Give the image motion of the rigid aircraft (2, 3) and per slope rate (2, 3), and the exposures (2,)."""
        eyes = self._eyes
        if eyes is None:
            return np.zeros((2, 3)), np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.zeros(2)
        nearness = 1.0 / motion.range_m if motion.range_m > 0 else 0.0
        rigid = eyes.by_rate @ body_rate_radps
        rigid += nearness * (eyes.by_velocity @ motion.velocity_body_mps + eyes.by_lever @ body_rate_radps)
        return rigid, eyes.by_slope + nearness * eyes.by_lift, eyes.exposure_s


@dataclass(frozen=True, slots=True, eq=False)
class _Eyes:
    """Image motion of both cameras, (2, 3) of one exposure in px, as linear maps.

    ``by_rate`` of the body rate; ``by_velocity`` of the velocity and ``by_lever`` of the body rate through the camera's
    place, both at a range of 1 m; ``by_slope`` of the slope rate, ``by_lift`` of the lift that goes with it, at 1 m.
    """

    by_rate: Floats
    by_velocity: Floats
    by_lever: Floats
    by_slope: Floats
    by_lift: Floats
    exposure_s: Floats


def _eyes(airframe: Airframe, cameras: tuple[Camera, Camera]) -> _Eyes:
    rig, bend = Rig.from_airframe(airframe), airframe.wing.symmetric
    factor = bend.slope_factor_radpm.value
    turns, shifts, levers, slopes, lifts = [], [], [], [], []
    for side, camera in zip(Side, cameras, strict=True):
        mounted, focal = rig.camera(side), camera.focal_px.value
        radius = np.hypot(camera.width_px, camera.height_px) / np.sqrt(12)
        turn = np.array([[0.0, -focal, 0.0], [focal, 0.0, 0.0], [0.0, 0.0, radius]]) @ mounted.rest.camera_from_body
        shift = np.diag([-focal, -focal, 0.0]) @ mounted.rest.camera_from_body
        turns.append(turn * camera.exposure_s)
        shifts.append(shift * camera.exposure_s)
        levers.append(-shifts[-1] @ _cross(mounted.rest.position_body_m))
        slopes.append(turns[-1] @ mounted.turn_rad(1.0, bend.twist_factor_radpm.value / factor))
        lifts.append(shifts[-1] @ np.array([0.0, 0.0, -camera.lift_gain / factor]))
    exposure_s = np.array([camera.exposure_s for camera in cameras])
    return _Eyes(np.array(turns), np.array(shifts), np.array(levers), np.array(slopes), np.array(lifts), exposure_s)


def _spring(airframe: Airframe) -> Floats:
    """Slope acceleration of the left and right tip per metre of the symmetric and antisymmetric mode, (2, 2)."""
    modes = (airframe.wing.symmetric, airframe.wing.antisymmetric)
    pull = [-((2 * np.pi * mode.frequency_hz.value) ** 2) * mode.slope_factor_radpm.value for mode in modes]
    spring: Floats = np.array([[1.0, -1.0], [1.0, 1.0]]) * np.array(pull)
    return spring


def _cross(vector: Floats) -> Floats:
    """Matrix of ``vector x``."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@compiled
def _smeared(
    rates: Floats,
    covariance: Floats,
    step_s: float,
    shifts_s: Floats,
    sigmas_s: Floats,
    rigid: Floats,
    per_rate: Floats,
    exposure_s: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Image motion, slope rates at the exposures, slope accelerations and expected rms blur over the instants."""
    acceleration = _derivative(rates, step_s)
    rate = rates + acceleration * shifts_s
    timing = sigmas_s**2 + exposure_s**2 / 12.0
    image, rms = np.empty((len(rates), 2, 3)), np.empty((len(rates), 2))
    for side in range(2):
        square = (covariance[:, side, side] + acceleration[:, side] ** 2 * timing[side]) * np.sum(per_rate[side] ** 2)
        for axis in range(3):
            image[:, side, axis] = rigid[side, axis] + per_rate[side, axis] * rate[:, side]
            square += image[:, side, axis] ** 2
        rms[:, side] = np.sqrt(square)
    return image, rate, acceleration, rms


@compiled
def _turned(turn: Floats, covariance: Floats) -> Floats:
    """``turn C turn^T`` of every instant, (n, 2, 2)."""
    out = np.zeros_like(covariance)
    for i in range(2):
        for j in range(2):
            for k in range(2):
                for m in range(2):
                    out[:, i, j] += turn[i, k] * turn[j, m] * covariance[:, k, m]
    return out


@compiled
def _derivative(rates: Floats, step_s: float) -> Floats:
    """Slope acceleration (n, 2) of equally spaced instants, by central differences."""
    derivative = np.empty_like(rates)
    derivative[1:-1] = (rates[2:] - rates[:-2]) / (2 * step_s)
    derivative[0], derivative[-1] = (rates[1] - rates[0]) / step_s, (rates[-1] - rates[-2]) / step_s
    return derivative
