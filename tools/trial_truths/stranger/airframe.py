"""The stranger's aircraft as its laboratory wrote its file: the design, with sigmas for what is drawn about it."""

from __future__ import annotations

from tools.trial_truths.stranger import flight, sensors
from tools.trial_truths.stranger.beam import modes

_FAMILIES = ("symmetric", "antisymmetric")


def airframe_text(corner_hz: float = 0.0) -> str:
    """TOML; the gust's corner (0: white) is nearly known, the nodes' noise is a data sheet's and not their own."""
    stations = "".join(_station(side, sign) for side, sign in (("left", -1.0), ("right", 1.0)))
    cameras = "".join(_camera(side, sign) for side, sign in (("left", -1.0), ("right", 1.0)))
    return f"""name = "stranger"
description = "finite elements, free at the fuselage"
[wing]
semispan_m = {sensors.SEMISPAN_M}
trim_bend_m = {{ value = {flight.PER_G_M}, sigma = 0.00015 }}
bend_per_g_m = {{ value = {flight.PER_G_M}, sigma = {flight.PER_G_SIGMA_M} }}
{_modes()}
[wing.gust]
deflection_rms_m = {{ value = {flight.RMS_M[0]}, sigma = 0.003 }}
corners_hz = [{corner_hz}, 0.0]
[root]
position_m = [0.0, 0.0, 0.0]
rate_hz = {sensors.ROOT_HZ}
lowpass_accel_hz = {sensors.ROOT_CORNER_HZ}
lowpass_gyro_hz = {sensors.ROOT_CORNER_HZ}
accel_noise_mps2_rthz = 0.004
source = {{ message = "HIGHRES_IMU", component = 1, clock = "boot" }}
{stations}{cameras}"""


def _modes() -> str:
    design, tables = modes(), []
    for k in range(4):
        rank, name = divmod(k, 2)
        sigma = flight.FREQUENCY_SIGMA if rank == 0 else flight.HIGHER_SIGMA
        f_hz, zeta, slope = float(design.frequency_hz[k]), flight.DAMPING[k], float(design.slope_radpm[1, k])
        tables.append(f"""[wing.{"second_" if rank else ""}{_FAMILIES[name]}]
frequency_hz = {{ value = {f_hz:.3f}, sigma = {sigma * f_hz:.4f} }}
damping = {{ value = {zeta}, sigma = {flight.DAMPING_SIGMA * zeta:.5f} }}
slope_factor_radpm = {{ value = {slope:.4f}, sigma = {flight.SLOPE_SIGMA * slope:.5f} }}""")
    return "\n".join(tables)


def _station(side: str, sign: float) -> str:
    return f"""[{side}]
position_m = [0.0, {sign * sensors.TIP_M}, 0.0]
rate_hz = {sensors.NODE_HZ}
sends = "z"
lowpass_accel_hz = {sensors.NODE_CORNER_HZ}
accel_scale_sigma = {sensors.SCALE_SIGMA}
accel_bias_sigma_mps2 = {sensors.BIAS_SIGMA_MPS2}
time_offset_sigma_s = {sensors.DELAY_SIGMA_S}
source = {{ message = "HIGHRES_IMU", component = {200 if side == "left" else 201}, clock = "boot" }}
"""


def _camera(side: str, sign: float) -> str:
    return f"""[{side}_camera]
width_px = 640
height_px = 480
focal_px = {{ value = {sensors.FOCAL_PX}, sigma = {2.0**0.5 * sensors.FOCAL_PX * sensors.FOCAL_SIGMA:.3f} }}
principal_px = [319.5, 239.5]
position_m = [0.0, {sign * 0.5 * sensors.BASELINE_M}, 0.0]
axes = ["y", "-x", "z"]
"""
