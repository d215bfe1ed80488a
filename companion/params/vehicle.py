"""The autopilot's parameters that Spanwise uses, each with the range outside which its value is not believed.

A value may be a misprint, a damaged message or somebody's attack. Outside its range it is said once and not used: what
the vehicle told before, or else the airframe file, stays in force. The ranges are those of ArduPilot's and PX4's own
parameter lists (the scheduler's is the one to which ArduPilot clips), except for the low-passes: there a cutoff
below 1 Hz, which ArduPilot allows, would leave nothing of a wing's mode to be undone.
"""

from __future__ import annotations

from dataclasses import dataclass

_LONGEST_RANGE_M = 1000.0  # choice
_TYPES = 127.0  # INT8 (by definition)
_ORIENTATIONS = 101.0  # MAV_SENSOR_ROTATION_CUSTOM and below
_BITS_16 = 65535.0  # a 16-bit mask (by definition)


@dataclass(frozen=True, slots=True)
class VehicleParameter:
    """One parameter of the autopilot: what it is for, and from where to where its value is believed.

    ``may_be_off`` says that 0 is believed too, and switches off what the parameter sets.
    """

    name: str
    unit: str
    low: float
    high: float
    purpose: str
    may_be_off: bool = False

    def plausible(self, value: float) -> bool:
        """Whether a value is believed; not-a-number and infinity never are."""
        return self.low <= value <= self.high or (self.may_be_off and value == 0.0)

    def __str__(self) -> str:
        off = " or 0" if self.may_be_off and self.low > 0.0 else ""
        return f"{self.low:g} to {self.high:g}{off}{' ' if self.unit else ''}{self.unit}"


def _notch(name: str) -> tuple[VehicleParameter, ...]:
    return (
        VehicleParameter(f"INS_{name}_ENABLE", "", 0, 1, "whether rates go through this notch"),
        VehicleParameter(f"INS_{name}_FREQ", "Hz", 10, 495, "centre of the notch, from which its delay follows"),
        VehicleParameter(f"INS_{name}_BW", "Hz", 5, 250, "width of the notch, for its delay"),
        VehicleParameter(f"INS_{name}_ATT", "dB", 5, 50, "depth of the notch, for its delay"),
        VehicleParameter(f"INS_{name}_HMNCS", "", 0, _BITS_16, "harmonics of the notch as bits, for its delay"),
    )


def _rangefinder(number: int) -> tuple[VehicleParameter, ...]:
    name = f"RNGFND{number}"
    return (
        VehicleParameter(f"{name}_TYPE", "", 0, _TYPES, "whether our ranges are used, or another range finder's"),
        VehicleParameter(f"{name}_ORIENT", "", 0, _ORIENTATIONS, "direction for which it is used"),
        VehicleParameter(f"{name}_MIN", "m", 0, _LONGEST_RANGE_M, "shortest range used"),
        VehicleParameter(f"{name}_MAX", "m", 0, _LONGEST_RANGE_M, "longest range used"),
        VehicleParameter(f"{name}_MIN_CM", "cm", 0, 100 * _LONGEST_RANGE_M, "shortest used, before ArduPilot 4.7"),
        VehicleParameter(f"{name}_MAX_CM", "cm", 0, 100 * _LONGEST_RANGE_M, "longest used, before ArduPilot 4.7"),
    )


_ROWS = (
    VehicleParameter("INS_ACCEL_FILTER", "Hz", 1, 256, "low-pass of the accelerometers, undone", may_be_off=True),
    VehicleParameter("INS_GYRO_FILTER", "Hz", 1, 256, "low-pass of the rates, undone", may_be_off=True),
    *_notch("HNTCH"),
    *_notch("HNTC2"),
    VehicleParameter("IMU_INTEG_RATE", "Hz", 50, 1000, "PX4's integration: half of it is taken off the stamps"),
    VehicleParameter("IMU_ACCEL_CUTOFF", "Hz", 0, 1000, "tells the doctor that the autopilot is PX4"),
    VehicleParameter("IMU_GYRO_CUTOFF", "Hz", 0, 1000, "tells the doctor that the autopilot is PX4"),
    VehicleParameter("SCHED_LOOP_RATE", "Hz", 50, 2000, "how fast inertial messages can come"),
    *_rangefinder(1),
    *_rangefinder(2),
    *_rangefinder(3),
    *_rangefinder(4),
    VehicleParameter("RNGFND_LANDING", "", 0, _TYPES, "whether ArduPlane lands by our ranges"),
    VehicleParameter("EKF2_RNG_CTRL", "", 0, 2, "whether PX4's height takes our ranges"),
    VehicleParameter("PRX1_TYPE", "", 0, _TYPES, "whether our obstacle sectors are used"),
    VehicleParameter("PRX_TYPE", "", 0, _TYPES, "whether our obstacle sectors are used, in old versions"),
    VehicleParameter("CAM1_DURATION", "s", 0, 5, "how fast the autopilot's left camera can be fired"),
    VehicleParameter("CAM2_DURATION", "s", 0, 5, "how fast the autopilot's right camera can be fired"),
)
VEHICLE_PARAMETERS: dict[str, VehicleParameter] = {row.name: row for row in _ROWS}
"""The one table, by name: every parameter that is used anywhere, asked for by the doctor and read from logs."""


def implausible(name: str, value: float) -> str | None:
    """The sentence that says why a value is not used; None where it is, or where the parameter is none of ours."""
    row = VEHICLE_PARAMETERS.get(name)
    if row is None or row.plausible(value):
        return None
    return f"{name} {value:g} on the vehicle is not {row}: ignored, the airframe's value or the last one holds"
