"""Worlds in which the simulated aircraft flies: vibration, sensors, lenses, images, ground, gusts, and their sources.

``ideal`` adds nothing to what file and filter believe, and its lenses are as calibrated. ``fair`` is what a clean
electric aircraft with calibrated machine-vision lenses meets over fields and villages; ``rough`` is a petrol engine, an
old calibration, mist and wind; ``tones`` is ideal but for two steady lines at the tips. A :data:`Span` is drawn
log-uniformly between its ends, once a flight (:mod:`companion.sim.flight.world_draw`); a sigma is drawn from a normal
distribution. Only the levels of the PX4 logs were measured for this table; figures of datasheets, standards and makers
are quoted.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.sim.flight.gust import GustKind

Span = tuple[float, float]


class Ground(enum.StrEnum):
    """The ground that the cameras see."""

    PLAIN = "plain"
    VILLAGE = "village"
    FOREST = "forest"
    ROWS = "rows"
    SNOW = "snow"
    WATER = "water"


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One line of the propulsion: order of the shaft rate, amplitude of the vertical acceleration at root and tips."""

    order: float
    root_mps2: Span
    tip_mps2: Span


@dataclass(frozen=True, slots=True)
class Propulsion:
    """Vibration of the propulsion as it reaches root and tips.

    Attributes
    ----------
    shaft_hz : Span
        Rate of the shaft at cruise.
    throttle_exponent : float
        The shaft's rate goes with this power of throttle over cruise throttle: thrust goes with its square.
    wander_ratio, wander_s : float
        Rms and correlation time of the rate's wandering.
    lateral_ratio : Span
        Lateral and axial amplitude over the vertical one, each axis drawn.
    arm_m : Span
        A vertical amplitude a at f turns the sensor too, by rates of a / (2 pi f arm).
    broadband_mps2_rthz, broadband_radps_rthz : Span
        One-sided level inside ``band_hz``, each axis drawn.
    """

    shaft_hz: Span
    lines: tuple[Harmonic, ...]
    throttle_exponent: float = 0.5
    wander_ratio: float = 0.005
    wander_s: float = 2.0
    lateral_ratio: Span = (0.3, 1.0)
    arm_m: Span = (0.2, 0.8)
    broadband_mps2_rthz: Span = (0.0, 0.0)
    broadband_radps_rthz: Span = (0.0, 0.0)
    band_hz: tuple[float, float] = (40.0, 400.0)


@dataclass(frozen=True, slots=True)
class SensorWear:
    """Errors of inertial sensors beyond the airframe's belief.

    ``noise_ratio`` multiplies the believed noise of every sensor; the biases settle by ``*_thermal`` (sigma of each
    axis) with the time constant ``thermal_s`` from power-on.
    """

    noise_ratio: Span = (1.0, 1.0)
    accel_thermal_mps2: float = 0.0
    gyro_thermal_radps: float = 0.0
    thermal_s: float = 20.0


@dataclass(frozen=True, slots=True)
class LensResiduals:
    """Sigmas of errors that a calibration leaves in each camera, beyond the airframe's own."""

    radial: float = 0.0
    tangential: float = 0.0
    principal_px: float = 0.0
    focal_ratio: float = 0.0
    place_m: float = 0.0


@dataclass(frozen=True, slots=True)
class ImageFaults:
    """Faults of each image; spans are drawn for each camera.

    ``vignetting`` is the share of light that the corner loses, ``gain_sigma`` the difference of the two cameras' gains,
    ``visibility_m`` Koschmieder's: contrast falls to 2 % there. ``match_ratio`` stands for all of it where no image is
    rendered: error of a match over the sigma that is stated for it.
    """

    vignetting: Span = (0.0, 0.0)
    defocus_px: Span = (0.0, 0.0)
    gain_sigma: float = 0.0
    noise_ratio: Span = (1.0, 1.0)
    visibility_m: float = 0.0
    match_ratio: Span = (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Weather:
    """Gusts: spectra to draw from, and 1-cosine gusts (a minute, change of load factor, seconds to cross)."""

    kinds: tuple[GustKind, ...] = ()
    deflection_ratio: Span = (1.0, 1.0)
    discrete_per_min: float = 0.0
    discrete_g: Span = (0.1, 0.1)
    discrete_s: Span = (0.5, 0.5)


# what lenses that are as their file says leave to a calibration: a thirtieth of the ordinary one's (chosen)
_EXACT = LensResiduals(radial=3e-5, tangential=2e-6, principal_px=0.01, place_m=2e-5)


@dataclass(frozen=True, slots=True)
class Conditions:
    """One world. Consumers: ``flight.build_flight`` and, for images, :mod:`companion.sim.vision`.

    ``stated`` is what the calibration of the cameras states of itself in the airframe file; ``velocity_mps`` is the
    sigma of the autopilot's velocity over ground, each axis, which its receiver states (GPS_RAW_INT); ``heading_rad``
    and ``level_rad`` are those of its attitude, constants of a flight, and ``heat_rad`` is that of each camera's slow
    turn, each axis, which takes ``heat_s``.
    """

    name: str
    propulsion: Propulsion | None = None
    sensors: SensorWear = field(default_factory=SensorWear)
    lenses: LensResiduals = field(default_factory=LensResiduals)
    stated: LensResiduals = _EXACT
    images: ImageFaults = field(default_factory=ImageFaults)
    weather: Weather = field(default_factory=Weather)
    grounds: tuple[Ground, ...] = (Ground.PLAIN,)
    # error of the autopilot's velocity over ground, each axis: ArduPilot's EK3_VELNE_M_NSE for u-blox M8 is 0.3
    velocity_mps: float = 0.3
    # the autopilot's heading, and its level against the cameras' body axes: a calibrated compass, a mounting by hand
    # (chosen: as much as is believed of them, see core.stereo.vehicle_motion)
    heading_rad: float = 0.05
    level_rad: float = 0.02
    # heat turns each camera against its wing section: an aluminium bracket (24e-6 per kelvin) as thick as it is long,
    # one face 5 K warmer, within minutes (chosen)
    heat_rad: float = 1.2e-4
    heat_s: float = 600.0


IDEAL = Conditions("ideal")

_CALIBRATED = LensResiduals(
    # what 30 good ChArUco views at 640x480 leave: k1 0.001, p 5e-5, principal point 0.3 px (quoted, not measured here)
    radial=0.001,
    tangential=5e-5,
    principal_px=0.3,
    place_m=0.0005,
)

_ELECTRIC = Propulsion(
    # 12x6 to 14x7 two-blade propellers on 2 m aircraft cruise at 3,600 to 6,000 rpm (makers' thrust tables)
    shaft_hz=(60.0, 100.0),
    lines=(
        # clean electric wings: 0.5 to 5 m/s^2 at shaft and blade-pass lines of 60 to 200 Hz (ArduPilot batch logs)
        Harmonic(1.0, (0.5, 3.0), (0.5, 2.0)),
        Harmonic(2.0, (0.3, 2.0), (0.2, 1.0)),
    ),
    # PX4/pyulog sample logs, 40 to 60 Hz, their 30 Hz low-pass undone: 0.006 to 0.022 m/s^2, 0.7 to 2.7 mrad/s per rtHz
    broadband_mps2_rthz=(0.003, 0.01),
    broadband_radps_rthz=(0.0003, 0.001),
)

FAIR = Conditions(
    "fair",
    propulsion=_ELECTRIC,
    sensors=SensorWear(
        # PX4/pyulog sample logs: medians above 20 Hz are 1.5 to 3.6 times the believed accelerometer noise
        noise_ratio=(0.7, 2.0),
        # ICM-42688-P datasheet, 0.15 mg and 0.005 deg/s per kelvin, settling by 5 K
        accel_thermal_mps2=0.0075,
        gyro_thermal_radps=0.00044,
    ),
    lenses=_CALIBRATED,
    stated=_CALIBRATED,
    images=ImageFaults(
        vignetting=(0.1, 0.3),  # C-mount lenses at f/2.8: makers' relative-illumination curves
        defocus_px=(0.2, 0.5),  # a tenth of a millimetre of back focus at f/2.8, 4 um pixels
        gain_sigma=0.03,  # auto-exposure of two cameras, 4 % steps
        noise_ratio=(1.0, 1.5),  # EMVA 1288 sheets of global-shutter sensors, gain 0 to 6 dB
        visibility_m=20_000.0,  # WMO: good visibility
        match_ratio=(1.0, 1.4),  # audit of the matcher: 1.16 in the plain scene, 1.76 with all faults at once
    ),
    weather=Weather(
        kinds=(GustKind.AIRFRAME, GustKind.DRYDEN),
        # chosen: light turbulence is below 0.5 g for a pilot; lengths of 10 to 30 m at 22 m/s (1-cosine, CS-23.333)
        discrete_per_min=2.0,
        discrete_g=(0.1, 0.3),
        discrete_s=(0.5, 1.4),
    ),
    grounds=(Ground.VILLAGE,),
    velocity_mps=0.15,  # u-blox M9 datasheet: 0.05 m/s (50 % at 30 m/s), and as much by what the filter makes of it
)

ROUGH = Conditions(
    "rough",
    propulsion=Propulsion(
        shaft_hz=(45.0, 90.0),  # 2,700 rpm (Sensors 2026, 26(2), 583, ground runs) to 5,400 rpm of 30 to 60 cm3 engines
        lines=(
            # the same ground runs: a line at half the excitation's rate, largest amplitudes at tips and engine
            Harmonic(0.5, (0.1, 0.5), (0.1, 0.5)),
            # VIBE below 15 m/s^2 rms is called acceptable (ArduPilot, measuring vibration)
            Harmonic(1.0, (3.0, 12.0), (2.0, 8.0)),
            Harmonic(2.0, (1.0, 6.0), (0.5, 3.0)),
            Harmonic(3.0, (0.3, 2.0), (0.2, 1.0)),
        ),
        wander_ratio=0.015,  # a carburetted single wanders by some percent (recorded rpm of two-strokes)
        broadband_mps2_rthz=(0.01, 0.03),
        broadband_radps_rthz=(0.001, 0.003),
    ),
    sensors=SensorWear(
        noise_ratio=(0.5, 4.0),  # datasheets: ICM-42688-P 70, MPU-6000 400 ug/rtHz
        # 20 K by the same datasheet: 3 mg and 0.1 deg/s
        accel_thermal_mps2=0.03,
        gyro_thermal_radps=0.00175,
    ),
    # an old calibration: two to four times the fair one's (chosen; an audit's lens had p = 3e-4)
    lenses=LensResiduals(radial=0.003, tangential=2e-4, principal_px=1.0, focal_ratio=0.001, place_m=0.001),
    stated=_CALIBRATED,
    images=ImageFaults(
        vignetting=(0.3, 0.5),
        defocus_px=(0.4, 0.9),
        gain_sigma=0.15,
        noise_ratio=(1.5, 3.0),  # 12 to 18 dB of gain under a grey sky
        visibility_m=2_000.0,  # WMO: mist is 1 to 5 km
        match_ratio=(1.2, 2.0),
    ),
    weather=Weather(
        kinds=(GustKind.AIRFRAME, GustKind.DRYDEN, GustKind.WHITE),
        deflection_ratio=(1.0, 1.6),
        # chosen: light to moderate turbulence, which pilots count from 0.5 to 1 g; the white spectrum is harder than
        # air: a wing's lift rolls off at some 10 Hz, and tips would not have 20 to 70 m/s2 above 50 Hz
        discrete_per_min=6.0,
        discrete_g=(0.2, 0.6),
        discrete_s=(0.4, 1.4),
    ),
    grounds=(Ground.VILLAGE, Ground.FOREST, Ground.ROWS, Ground.SNOW),
)

TONES = Conditions(
    "tones",
    propulsion=Propulsion(
        shaft_hz=(80.0, 80.0),
        lines=(Harmonic(1.0, (0.0, 0.0), (3.0, 3.0)), Harmonic(2.0, (0.0, 0.0), (1.0, 1.0))),
        throttle_exponent=0.0,
        wander_ratio=0.0,
    ),
)

WORLDS: Mapping[str, Conditions] = {world.name: world for world in (IDEAL, FAIR, ROUGH, TONES)}
