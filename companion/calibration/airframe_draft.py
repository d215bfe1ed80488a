"""The first airframe file of an aircraft, drafted from what its builder can measure in an hour.

Everything that is not asked follows from beam theory, with a sigma as wide as the formula is rough. The formulas are
written into the file beside the values, so that whoever measures better knows what to replace.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.wing.beam import BeamMode, characteristic_roots
from companion.units import GRAVITY_MPS2, Orientation

STATIC_BEND = 1.545
"""Tip deflection of a uniform cantilever under its own weight times omega^2 / g: (1.8751^4 = 12.362) / 8 (derived)."""
_SLOPE_SPREAD = 0.05  # tip: 1.33 under an even static load to 1.50 under a tip load, 1.38 of the mode (derived)
_STATIC_SPREAD = 0.3  # taper, and lift that is denser at the root (choice)
_FREQUENCY_SPREAD = 0.1  # a tap test on the bench holds the fuselage, flight does not (choice)
# chosen: the fuselage's mass lets an antisymmetric mode ring faster; wide, for wings differ
_ANTISYMMETRIC_RATIO, _ANTISYMMETRIC_SPREAD = 1.28, 0.15
# chosen: structure 1 to 2 %, air the rest; the sigma reaches from a clean wing to a soft one
_DAMPING, _DAMPING_SIGMA = 0.03, 0.02
# chosen: gusts bend a third of what 1 g bends; the sigma spans calm and rough air
_GUST_PER_G, _GUST_SPREAD = 1.0 / 3.0, 0.8
_MOUNT_SIGMA_RAD = 0.01  # chosen: half a degree, what an eye leaves when a camera is mounted
_FOCAL_SPREAD = 0.02  # of the focal length: data sheets against calibrations (choice)
_TRUST = 0.03
"""sigma / range above which no range is trusted by default (RNG_TRUST; convention)."""

_TRIM_FLIGHT = """The largest slow error of all:
# fly level over ground of known height once (python -m mission_scripts.calibrate_target), write what it says"""
_ROLLED = """A pair that looks ahead sees
# it as roll, which matched features hold; the largest slow error is how its cameras are turned (rotation_rad)"""
_AXES = {"down": '["y", "-x", "z"]', "forward": '["y", "z", "x"]'}
_ORIENTATION = {"down": int(Orientation.DOWN), "forward": int(Orientation.FORWARD), "none": int(Orientation.DOWN)}


@dataclass(frozen=True, slots=True)
class Measured:
    """Measurements that the builder of an airframe has at hand.

    Frequency and its sigma are of the first symmetric bending mode; ``wing_mass_kg`` is of both halves together, with
    what sits in them; ``station_y_m`` is from the centreline to node and camera. ``looks`` is ``down``, ``forward`` or
    ``none``; ``tip_axes`` are the measured axes of a node, letters of "xyzpqr". With ``hanging`` the stereo calibration
    is made with the wing hanging by its own weight, the fuselage supported.
    """

    name: str
    semispan_m: float
    frequency_hz: float
    frequency_sigma_hz: float
    antisymmetric_hz: float
    mass_kg: float
    wing_mass_kg: float
    hanging: bool
    looks: str
    focal_px: float
    width_px: int
    height_px: int
    station_y_m: float
    tip_axes: str
    imu_rate_hz: float
    accel_filter_hz: float
    node_rate_hz: float


def default_frequency_sigma_hz(frequency_hz: float) -> float:
    """How far a tap test on the bench is trusted."""
    return _FREQUENCY_SPREAD * frequency_hz


def default_antisymmetric_hz(frequency_hz: float) -> float:
    """Antisymmetric first bending, from the symmetric one: the ratio of the airframes in ``config``."""
    return _ANTISYMMETRIC_RATIO * frequency_hz


def bend_per_g_m(measured: Measured) -> float:
    """Deflection at the node that one further g adds."""
    return _static_share(measured) * _tip_bend_per_g_m(measured)


def trim_bend_m(measured: Measured) -> float:
    """Deflection at the node in level flight from the wing as calibrated."""
    return _static_share(measured) * tip_trim_bend_m(measured)


def tip_trim_bend_m(measured: Measured) -> float:
    """Tip deflection in level flight from the wing as calibrated."""
    return _tip_bend_per_g_m(measured) + (_own_weight_bend_m(measured) if measured.hanging else 0.0)


def trusted_to_m(measured: Measured) -> float:
    """Range at which the largest slow error of the toe alone uses up the trusted share, matches not counted.

    A pair that looks down sees the trim bend as toe. One that looks ahead sees it as roll; there it is the mounting.
    """
    slope_radpm = _slope_times_semispan(measured) / measured.semispan_m
    if measured.looks == "forward":
        toe_sigma_rad = math.sqrt(2.0) * _MOUNT_SIGMA_RAD
    else:
        toe_sigma_rad = 2.0 * slope_radpm * _relative_sigma(measured) * trim_bend_m(measured)
    return _TRUST * 2.0 * measured.station_y_m / toe_sigma_rad


def _tip_bend_per_g_m(measured: Measured) -> float:
    """Tip deflection for one further g: the fuselage hangs on the wing, whose own weight is borne where it is."""
    return _own_weight_bend_m(measured) * (measured.mass_kg / measured.wing_mass_kg - 1.0)


def _own_weight_bend_m(measured: Measured) -> float:
    return STATIC_BEND * GRAVITY_MPS2 / (math.tau * measured.frequency_hz) ** 2


def _static_share(measured: Measured) -> float:
    """Deflection of an evenly loaded uniform cantilever at the node over that at its tip."""
    eta = measured.station_y_m / measured.semispan_m
    return (eta**4 - 4.0 * eta**3 + 6.0 * eta**2) / 3.0


def _slope_times_semispan(measured: Measured) -> float:
    """Slope of a uniform cantilever's first mode at the node over its deflection there, times its length."""
    mode = BeamMode(float(characteristic_roots(1, 0.0)[0]), 0.0, 1.0, 0.0, 0.0)
    eta = np.array([measured.station_y_m / measured.semispan_m])
    return float(mode.slope(eta)[0] / mode.shape(eta)[0])


def _relative_sigma(measured: Measured) -> float:
    return math.hypot(_STATIC_SPREAD, 2.0 * measured.frequency_sigma_hz / measured.frequency_hz)


def draft(measured: Measured) -> str:
    """The airframe file as TOML, commented."""
    parts = [_head(measured), _wing(measured), _root(measured)]
    parts += [_node(measured, side, component) for side, component in (("left", 200), ("right", 201))]
    if measured.looks != "none":
        parts += [_camera(measured, side) for side in ("left", "right")]
    return "\n".join(parts)


def _head(m: Measured) -> str:
    eyes = "no cameras" if m.looks == "none" else f"two cameras looking {m.looks}"
    return f"""\
# Drafted by `spanwise new-airframe` from measurements of an hour; config/README.md explains every key.
# Every sigma is wide on purpose: what is not known goes into the sigma of every range, and a range that
# cannot be trusted is not published. Replace a value by a measured one, and its sigma by that of the measurement.
name = "{m.name}"
description = "{2 * m.semispan_m:g} m span, {m.mass_kg:g} kg, {m.frequency_hz:g} Hz wing, {eyes}"
orientation = {_ORIENTATION[m.looks]}  # of the range: 25 down, 0 forward
"""


def _wing(m: Measured) -> str:
    per_g, trim, spread = bend_per_g_m(m), trim_bend_m(m), _relative_sigma(m)
    factor = _slope_times_semispan(m)
    slope = factor / m.semispan_m
    eta = f"{m.station_y_m / m.semispan_m:.2f}"
    gust = _GUST_PER_G * per_g
    masses = f"{m.mass_kg:g} and {m.wing_mass_kg:g} kg"
    percent = f"{100 * spread:.0f} %: {100 * _STATIC_SPREAD:.0f} %"
    droop = (
        f"and {STATIC_BEND} g / omega^2 for the wing that hung when calibrated" if m.hanging else "laid straight before"
    )
    return f"""\
[wing]
semispan_m = {m.semispan_m!r}
# load over stiffness of a uniform beam: {STATIC_BEND} g / omega^2 (mass / wing mass - 1), {masses};
# of it {_static_share(m):.3f} at {eta} semispan, where the node sits;
# sigma {percent} for taper and the shape of the lift, and twice the frequency's
bend_per_g_m = {_uncertain(per_g, spread * per_g)}
# the same at 1 g, {droop}. {_slow_error(m)}
trim_bend_m = {_uncertain(trim, spread * trim)}

[wing.symmetric]
frequency_hz = {_uncertain(m.frequency_hz, m.frequency_sigma_hz)}
damping = {_uncertain(_DAMPING, _DAMPING_SIGMA)}  # structure 1 to 2 %, air the rest
slope_factor_radpm = {_uncertain(slope, _SLOPE_SPREAD * slope)}  # {factor:.3g} / semispan: a cantilever at {eta} of it

[wing.antisymmetric]
frequency_hz = {_uncertain(m.antisymmetric_hz, _ANTISYMMETRIC_SPREAD * m.antisymmetric_hz)}
damping = {_uncertain(_DAMPING, _DAMPING_SIGMA)}
slope_factor_radpm = {_uncertain(slope, _SLOPE_SPREAD * slope)}

[wing.gust]
deflection_rms_m = {_uncertain(gust, _GUST_SPREAD * gust)}  # a third of what 1 g bends
corners_hz = [2.0, 20.0]
"""


def _slow_error(m: Measured) -> str:
    return _ROLLED if m.looks == "forward" else _TRIM_FLIGHT


def _root(m: Measured) -> str:
    return f"""\
[root]  # the autopilot's IMU
position_m = [0.0, 0.0, 0.0]
rate_hz = {m.imu_rate_hz!r}
lowpass_accel_hz = {m.accel_filter_hz!r}  # INS_ACCEL_FILTER and INS_GYRO_FILTER; read from the vehicle when it is there
lowpass_gyro_hz = {m.accel_filter_hz!r}
accel_scale_sigma = 0.005
gyro_scale_sigma = 0.003
misalignment_sigma_rad = 0.01  # aligned by eye
source = {{ message = "HIGHRES_IMU", component = 1, clock = "boot" }}
"""


def _node(m: Measured, side: str, component: int) -> str:
    y_m = -m.station_y_m if side == "left" else m.station_y_m
    return f"""\
[{side}]  # the {side} wing node
position_m = [0.0, {y_m!r}, 0.0]  # x forward, y right, z down, from the autopilot's IMU
rate_hz = {m.node_rate_hz!r}
sends = "{m.tip_axes}"
accel_scale_sigma = 0.01
gyro_scale_sigma = 0.01
misalignment_sigma_rad = 0.01  # aligned by eye
time_offset_sigma_s = 0.0002
height_sigma_m = 0.1  # not asked: the node may sit above or below the autopilot; 0.005 once position_m has its z
source = {{ message = "HIGHRES_IMU", component = {component}, clock = "node_{side}" }}
"""


def _camera(m: Measured, side: str) -> str:
    y_m = -m.station_y_m if side == "left" else m.station_y_m
    return f"""\
[{side}_camera]  # until `spanwise calibrate stereo` has measured lens and mounting
width_px = {m.width_px}
height_px = {m.height_px}
focal_px = {_uncertain(m.focal_px, _FOCAL_SPREAD * m.focal_px)}  # data sheet
principal_px = [{0.5 * (m.width_px - 1)!r}, {0.5 * (m.height_px - 1)!r}]
position_m = [0.0, {y_m!r}, 0.0]
axes = {_AXES[m.looks]}  # body directions of camera x (right), y (down), z (forward)
rotation_rad = [0.0, 0.0, 0.0]  # of the camera from these axes, right-handed about its x, y, z: {_turns(m)}
rotation_sigma_rad = {_MOUNT_SIGMA_RAD}  # mounted by eye
exposure_s = 0.002
latency_s = {{ value = 0.008, sigma = 0.004 }}  # trigger command to start of exposure; learned in flight
"""


def _turns(m: Measured) -> str:
    return "x > 0 looks up" if m.looks == "forward" else "x > 0 looks ahead of straight down"


def _uncertain(value: float, sigma: float) -> str:
    return f"{{ value = {_rounded(value)}, sigma = {_rounded(sigma)} }}"


def _rounded(value: float) -> str:
    """Four figures are more than any of this is known to; TOML wants a digit on both sides of the point."""
    return repr(float(f"{value:.4g}"))
