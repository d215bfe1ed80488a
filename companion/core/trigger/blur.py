"""Predicted motion blur of both cameras, from bending, body rate and ground speed together.

The image of a point at depth Z near the optical axis moves, in camera axes (x right, y down, z forward), by::

    u' = f (-omega_y - v_x / Z),   v' = f (omega_x - v_y / Z)

A roll omega_z about the optical axis moves a pixel at the radius rho by omega_z rho; its rms over the image counts. All
three are linear in the tip's slope rate. So blur^2 is quadratic in the forecast, and its expectation needs only mean
and covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import skew
from companion.core.tracking.prediction import Forecast
from companion.core.trigger.latency import LatencyModel
from companion.native.library import ARRAY, REAL, RECORD, kernel, packed
from companion.params.airframe import Airframe, Camera
from companion.records import Floats, Ints, Side


@dataclass(frozen=True, slots=True)
class GroundMotion:
    """Rigid motion, which is not part of the forecast.

    Attributes
    ----------
    velocity_body_mps : (3,) float64
        Velocity over ground, body axes.
    range_m : float
        Distance of the scene along the optical axis, m; infinite where unknown.
    """

    velocity_body_mps: Floats = field(default_factory=lambda: np.zeros(3))
    range_m: float = np.inf


class BlurForecast(NamedTuple):
    """Blur over a forecast's instants, each side at its own mid-exposure. ``trigger_minima`` in C reads this layout.

    Attributes
    ----------
    t_host_ns : (n,) int64
        Mean of both mid-exposures.
    motion : (n, 2, 3) float64
        Left and right image motion along x, y and roll during one exposure, px. Blur is its length.
    motion_per_rate : (2, 3) float64
        Motion by a slope rate of 1 rad/s, px.
    acceleration_radps2 : (n, 2) float64
        Derivative of each side's slope rate.
    rate_covariance, q_covariance : (n, 2, 2) float64
        Covariances of both slope rates, (rad/s)^2, and of both modal coordinates, m^2.
    spring : (2, 2) float64
        Slope acceleration, rad/s^2, of left and right tip (rows) per metre of either coordinate (columns).
    rms_px : (n, 2) float64
        Expected rms blur of either camera, px, with the uncertainty of rate and exposure time.
    """

    t_host_ns: Ints
    motion: Floats
    motion_per_rate: Floats
    acceleration_radps2: Floats
    rate_covariance: Floats
    q_covariance: Floats
    spring: Floats
    rms_px: Floats


class BlurModel:
    """Blur of the two cameras of one airframe. Without cameras the slope rate alone counts, and blur is 0 px."""

    def __init__(self, airframe: Airframe) -> None:
        self._spring = _spring(airframe)
        left, right = airframe.left_camera, airframe.right_camera
        self._maps = (
            _without_cameras() if left is None or right is None else _image_motion_maps(airframe, (left, right))
        )

    def predict(self, forecast: Forecast, latency: LatencyModel, motion: GroundMotion) -> BlurForecast:
        """Predict the blur at every instant of the forecast, with the newest body rate held."""
        step_s = float(forecast.t_host_ns[1] - forecast.t_host_ns[0]) * 1e-9
        nearness = 1.0 / motion.range_m if motion.range_m > 0 else 0.0
        rates, covariance = forecast.slope_rate_radps, forecast.slope_rate_covariance
        image, per_rate, acceleration, rms = streaks(
            self._maps,
            rates,
            covariance,
            step_s,
            np.array(latency.shifts_ns()),
            np.array(latency.sigmas_ns()),
            forecast.body_rate_radps,
            motion.velocity_body_mps,
            nearness,
        )
        return BlurForecast(
            t_host_ns=forecast.t_host_ns,
            motion=image,
            motion_per_rate=per_rate,
            acceleration_radps2=acceleration,
            rate_covariance=covariance,
            q_covariance=forecast.q_covariance,
            spring=self._spring,
            rms_px=rms,
        )


class _ImageMotionMaps(NamedTuple):
    """Image motion of both cameras, (2, 3) of one exposure in px, as linear maps.

    ``by_rate`` is the map of the body rate, ``by_velocity`` that of the velocity, ``by_lever`` that of the body rate
    through the camera's place. ``by_slope`` is the motion by a slope rate, ``by_lift`` that by the lift rate that goes
    with it. Velocity, lever and lift are at a range of 1 m. ``px`` is 1, or 0 without cameras.
    """

    by_rate: Floats
    by_velocity: Floats
    by_lever: Floats
    by_slope: Floats
    by_lift: Floats
    exposure_s: Floats
    px: float


def _without_cameras() -> _ImageMotionMaps:
    """Maps without cameras: only the slope rate moves the image."""
    slope = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    still = np.zeros((2, 3, 3))
    return _ImageMotionMaps(still, still, still, slope, np.zeros((2, 3)), np.zeros(2), px=0.0)


def _image_motion_maps(airframe: Airframe, cameras: tuple[Camera, Camera]) -> _ImageMotionMaps:
    rig, bend = Rig.from_airframe(airframe), airframe.wing.symmetric
    factor = bend.slope_factor_radpm.value
    turns, shifts, levers, slopes, lifts = [], [], [], [], []
    for side, camera in zip(Side, cameras, strict=True):
        mounted, focal = rig.camera(side), camera.focal_px.value
        down = focal * camera.focal_ratio
        radius = np.hypot(camera.width_px, camera.height_px) / np.sqrt(12)
        turn = np.array([[0.0, -focal, 0.0], [down, 0.0, 0.0], [0.0, 0.0, radius]]) @ mounted.rest.camera_from_body
        shift = np.diag([-focal, -down, 0.0]) @ mounted.rest.camera_from_body
        turns.append(turn * camera.exposure_s)
        shifts.append(shift * camera.exposure_s)
        levers.append(-shifts[-1] @ skew(mounted.rest.position_body_m))
        slopes.append(turns[-1] @ mounted.turn_rad(1.0, bend.twist_factor_radpm.value / factor))
        lifts.append(shifts[-1] @ np.array([0.0, 0.0, -camera.lift_gain / factor]))
    exposure_s = np.array([camera.exposure_s for camera in cameras])
    by_rate, by_velocity, by_lever = np.array(turns), np.array(shifts), np.array(levers)
    return _ImageMotionMaps(by_rate, by_velocity, by_lever, np.array(slopes), np.array(lifts), exposure_s, px=1.0)


def _spring(airframe: Airframe) -> Floats:
    """Slope acceleration, rad/s^2, of left and right tip per metre of symmetric and antisymmetric mode, (2, 2)."""
    modes = (airframe.wing.symmetric, airframe.wing.antisymmetric)
    pull = [-((2 * np.pi * mode.frequency_hz.value) ** 2) * mode.slope_factor_radpm.value for mode in modes]
    spring: Floats = np.array([[1.0, -1.0], [1.0, 1.0]]) * np.array(pull)
    return spring


class Streaks(NamedTuple):
    """Image motion (n, 2, 3), motion per slope rate (2, 3), slope accelerations and rms blur (n, 2)."""

    image: Floats
    per_rate: Floats
    acceleration: Floats
    rms: Floats


_pack_maps, _pack_streaks = packed(_ImageMotionMaps), packed(Streaks)
_streaks = kernel("trigger_streaks", RECORD, ARRAY, ARRAY, REAL, ARRAY, ARRAY, ARRAY, ARRAY, REAL, RECORD)


def streaks(
    maps: _ImageMotionMaps,
    rates: Floats,
    covariance: Floats,
    step_s: float,
    shifts_ns: Floats,
    sigmas_ns: Floats,
    body_rate_radps: Floats,
    velocity_mps: Floats,
    nearness: float,
) -> Streaks:
    """Blur over n instants, at least two, ``step_s`` apart; results as in :class:`BlurForecast`.

    Slope rates are (n, 2), rad/s, with covariance (n, 2, 2). Shifts and sigmas of the exposures are (2,), ns. Body rate
    and velocity are (3,), body axes. ``nearness`` is one over the range, 1/m.
    """
    n = len(rates)
    out = Streaks(np.empty((n, 2, 3)), np.empty((2, 3)), np.empty((n, 2)), np.empty((n, 2)))
    timing = (step_s, shifts_ns, sigmas_ns)
    _streaks(
        _pack_maps(maps), rates, covariance, *timing, body_rate_radps, velocity_mps, nearness, _pack_streaks(out)
    )  # fmt: skip
    return out
