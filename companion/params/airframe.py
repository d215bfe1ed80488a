"""The airframe: everything measured or believed about one aircraft's wing, sensors and cameras, with prior sigmas.

The dataclasses are the schema of ``config/airframes/<name>.toml``; :mod:`companion.params.files` reads and writes them.
An :class:`Uncertain` carries the prior standard deviation of the belief. For quantities that are positive by nature
(frequency, damping, gust) the prior is log-normal with relative sigma ``sigma / value``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.errors import ConfigError
from companion.records import Axis, ClockName, Side, Station
from companion.units import Orientation

Vector3 = tuple[float, float, float]
FAMILIES = ("symmetric", "antisymmetric")
"""Modes that move both tips alike, and against each other."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A believed value and its prior standard deviation, in the unit of the field's name."""

    value: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Mode:
    """One bending mode.

    ``slope_factor_radpm`` is the slope at the tip station per metre of tip deflection; ``twist_factor_radpm`` the
    nose-up twist there per metre (torsion that comes with the bending).
    """

    frequency_hz: Uncertain
    damping: Uncertain
    slope_factor_radpm: Uncertain
    twist_factor_radpm: Uncertain = field(default_factory=lambda: Uncertain(0.0, 0.0))


@dataclass(frozen=True, slots=True)
class Gust:
    """The load on a mode: what rms deflection to expect, and the corners of its spectrum (0: white)."""

    deflection_rms_m: Uncertain
    corners_hz: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Wing:
    """Modes and static bend.

    ``second_*`` are the next bending modes, ``further_*`` those above, the lowest first. A second mode that is left out
    is tracked with a cantilever's wide prior, or is taken not to exist where ``assume_second`` is false.
    ``trim_bend_m`` is the symmetric tip deflection in level flight at 1 g relative to the wing as calibrated on the
    ground; ``bend_per_g_m`` what each further g adds. ``shortening`` is how far a bent wing's tip moves inboard, over
    what that of a cantilever with the same slope factors does.
    """

    semispan_m: float
    symmetric: Mode
    antisymmetric: Mode
    gust: Gust
    trim_bend_m: Uncertain
    bend_per_g_m: Uncertain
    second_symmetric: Mode | None = None
    second_antisymmetric: Mode | None = None
    further_symmetric: tuple[Mode, ...] = ()
    further_antisymmetric: tuple[Mode, ...] = ()
    assume_second: bool = True
    shortening: Uncertain = Uncertain(1.0, 0.1)

    def family(self, parity: int) -> dict[str, Mode]:
        """Modes of the symmetric (parity 0) or antisymmetric (1) family by name, the lowest first.

        A name is the path of the mode's table in the file: ``second_symmetric``, ``further_symmetric.0``.
        """
        name = FAMILIES[parity]
        second: Mode | None = getattr(self, f"second_{name}")
        further: tuple[Mode, ...] = getattr(self, f"further_{name}")
        named = {name: getattr(self, name)} | ({} if second is None else {f"second_{name}": second})
        return named | {f"further_{name}.{index}": mode for index, mode in enumerate(further)}

    @property
    def modes(self) -> dict[str, Mode]:
        """All modes by name: the first of both families, their second, and so on."""
        ranked = [
            (2 * rank + parity, name, mode)
            for parity in range(len(FAMILIES))
            for rank, (name, mode) in enumerate(self.family(parity).items())
        ]
        return {name: mode for _, name, mode in sorted(ranked, key=lambda entry: entry[0])}

    def with_modes(self, change: Callable[[str, Mode], Mode]) -> Wing:
        """The wing with each mode replaced by what ``change`` makes of its name and itself."""
        families = [{name: change(name, mode) for name, mode in self.family(k).items()} for k in range(len(FAMILIES))]
        changes: dict[str, Any] = {}
        for family, modes in zip(FAMILIES, families, strict=True):
            changes |= {name: mode for name, mode in modes.items() if name.endswith(family)}
            changes[f"further_{family}"] = tuple(mode for name, mode in modes.items() if not name.endswith(family))
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a sensor's samples on the link.

    ``axes`` gives, for body x, y, z, the sensor axis that carries it, with sign: ``["y", "-x", "z"]``.
    ``instance`` selects among equal messages: the ``id`` of HIGHRES_IMU, or the name of a DEBUG_FLOAT_ARRAY.
    ``stamp_offset_s`` is added to every stamp (0.0005 for stamps truncated to milliseconds).
    """

    message: str
    component: int
    clock: ClockName
    instance: str = ""
    axes: tuple[str, str, str] = ("x", "y", "z")
    stamp_offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Sensor:
    """An inertial sensor, its place and its errors. Noise is one-sided root spectral density; errors are prior sigmas.

    ``lowpass_*_hz`` is the 2nd-order Butterworth that the source has applied (INS_ACCEL_FILTER, INS_GYRO_FILTER), or 0.
    ``sends`` lists the axes that are really measured, as letters of "xyzpqr".
    """

    source: Source
    position_m: Vector3
    rate_hz: float
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
    height_sigma_m: float = 0.0
    accel_range_mps2: float = 157.0
    gyro_range_radps: float = 34.9
    lowpass_accel_hz: float = 0.0
    lowpass_gyro_hz: float = 0.0

    @property
    def axes(self) -> Axis:
        """The axes that it sends."""
        return Axis.of(self.sends)


@dataclass(frozen=True, slots=True)
class Camera:
    """One camera. Its frame is OpenCV's (x right, y down, z forward).

    ``axes`` names the body direction of camera x, y, z at rest (nadir: ``["y", "-x", "z"]``, forward:
    ``["y", "z", "x"]``); ``rotation_rad`` is the calibrated small rotation vector, in camera axes, from there to the
    camera as mounted.
    ``drift_sigma_rad`` is how far, per axis, heat and load may slowly turn the camera against the wing section that its
    inertial sensor sits on, ``drift_time_s`` how long it takes; matched features follow it.
    ``slope_gain`` scales the tip station's slope to the camera (1: mounted at the station); ``lift_gain`` likewise its
    deflection. ``focal_px`` is along the rows, ``focal_ratio`` times it along the columns. ``latency_s`` is from
    trigger command to the start of the exposure. ``stamp_sigma_s`` is how well its own stamps tell the middle of an
    exposure: where an autopilot's hot-shoe pin tells it better (CAMERA_FEEDBACK, some 0.3 ms), that is used.
    ``tilt_sigma_rad``, ``prism_sigma`` and ``radial_sigma`` are what a calibration leaves in the lens (keystone, thin
    prism, first radial term; see :mod:`companion.core.stereo.lens_residual`). Their defaults are those of 30 views of a
    board that fit to 0.13 px rms, 640 px wide at 800 px of focal length.
    """

    width_px: int
    height_px: int
    focal_px: Uncertain
    principal_px: tuple[float, float]
    position_m: Vector3
    axes: tuple[str, str, str]
    rotation_rad: Vector3 = (0.0, 0.0, 0.0)
    rotation_sigma_rad: float = 0.0001
    drift_sigma_rad: float = 0.0
    drift_time_s: float = 600.0
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    exposure_s: float = 0.002
    row_time_s: float = 0.0
    latency_s: Uncertain = field(default_factory=lambda: Uncertain(0.008, 0.002))
    slope_gain: float = 1.0
    lift_gain: float = 1.0
    focal_ratio: float = 1.0
    stamp_sigma_s: float = 0.0001
    tilt_sigma_rad: float = 0.0004
    prism_sigma: float = 0.00017
    radial_sigma: float = 0.0014


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """A model extension in force (see the catalogue), as diagnosis or the builder wrote it.

    An effect that follows a recorded ``channel`` counts it from ``channel_mean`` in units of ``channel_rms`` (0: each
    recording's own mean and rms).
    """

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    channel: str = ""
    channel_mean: float = 0.0
    channel_rms: float = 0.0


@dataclass(frozen=True, slots=True)
class Airframe:
    """One aircraft as Spanwise believes it to be; without cameras where only the wing is of interest.

    ``pair_sigma_rad`` is how well it is known how the pair as a whole is mounted, beyond ``rotation_sigma_rad`` of each
    camera: a stereo calibration knows how they are turned against each other, and not how both are on the aircraft.
    """

    name: str
    description: str
    wing: Wing
    root: Sensor
    left: Sensor
    right: Sensor
    left_camera: Camera | None = None
    right_camera: Camera | None = None
    orientation: int = int(Orientation.DOWN)
    pair_sigma_rad: float = 0.0
    effects: tuple[NamedEffect, ...] = ()

    @property
    def looks_down(self) -> bool:
        """Whether the camera pair looks at the ground: range grows with height."""
        return self.orientation == Orientation.DOWN

    @property
    def looks_forward(self) -> bool:
        """Whether the camera pair looks along the flight: it sees obstacles, and bending rolls its images."""
        return self.orientation == Orientation.FORWARD

    @property
    def camera_pair(self) -> tuple[Camera, Camera]:
        """Left and right camera; :class:`ConfigError` where there are none."""
        if self.left_camera is None or self.right_camera is None:
            raise ConfigError(f"airframe '{self.name}' has no camera pair: it needs left_camera and right_camera")
        return self.left_camera, self.right_camera

    def with_sensors(self, change: Callable[[Station, Sensor], Sensor]) -> Airframe:
        """The airframe with each sensor replaced by what ``change`` makes of its station and itself."""
        root, left, right = (change(station, self.sensor(station)) for station in Station)
        return dataclasses.replace(self, root=root, left=left, right=right)

    def with_cameras(self, change: Callable[[Side, Camera], Camera]) -> Airframe:
        """The airframe with each camera, where it has one, replaced by what ``change`` makes of its side and itself."""
        cameras = zip(Side, (self.left_camera, self.right_camera), strict=True)
        left, right = (None if camera is None else change(side, camera) for side, camera in cameras)
        return dataclasses.replace(self, left_camera=left, right_camera=right)

    def sensor(self, station: Station) -> Sensor:
        """The sensor of a station."""
        return (self.root, self.left, self.right)[station]
