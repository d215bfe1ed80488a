"""The airframe that the trials' diagnosis believes in, as its file: the centres and sigmas of ``cases.BELIEF``."""

from __future__ import annotations


def airframe_text(noise_mps2_rthz: float, corner_hz: float = 0.0) -> str:
    """TOML of the believed airframe; the accelerometers' noise is known, the gust's corner (0: white) nearly."""
    return _TEXT.replace("NOISE", repr(noise_mps2_rthz)).replace("CORNER", repr(corner_hz))


_TEXT = """
name="trial"
description="x"
[wing]
semispan_m=1.0
trim_bend_m={value=0.0149,sigma=0.0002}
bend_per_g_m={value=0.0149,sigma=0.0004}
[wing.symmetric]
frequency_hz={value=5.0,sigma=0.05}
damping={value=0.03,sigma=0.003}
slope_factor_radpm={value=1.39,sigma=0.0139}
[wing.antisymmetric]
frequency_hz={value=6.4,sigma=0.064}
damping={value=0.03,sigma=0.003}
slope_factor_radpm={value=1.39,sigma=0.0139}
[wing.gust]
deflection_rms_m={value=0.005,sigma=0.004}
corners_hz=[CORNER,0.0]
[root]
position_m=[0.0,0.0,0.0]
rate_hz=1000.0
source={message="HIGHRES_IMU",component=1,clock="boot"}
[left]
position_m=[0.0,-1.0,0.0]
rate_hz=1000.0
sends="z"
accel_noise_mps2_rthz=NOISE
accel_scale_sigma=0.005
time_offset_sigma_s=0.0002
source={message="HIGHRES_IMU",component=200,clock="boot"}
[right]
position_m=[0.0,1.0,0.0]
rate_hz=1000.0
sends="z"
accel_noise_mps2_rthz=NOISE
accel_scale_sigma=0.005
time_offset_sigma_s=0.0002
source={message="HIGHRES_IMU",component=201,clock="boot"}
[left_camera]
width_px=640
height_px=480
focal_px={value=800.0,sigma=0.4}
principal_px=[319.5,239.5]
position_m=[0.0,-0.99,0.0]
axes=["y","-x","z"]
[right_camera]
width_px=640
height_px=480
focal_px={value=800.0,sigma=0.4}
principal_px=[319.5,239.5]
position_m=[0.0,0.99,0.0]
axes=["y","-x","z"]
"""
