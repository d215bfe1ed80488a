"""Values that the paper prints, copied as they stand, misprints included. Nothing here is computed."""

from __future__ import annotations

from typing import NamedTuple


class PrintedMode(NamedTuple):
    """One row of Table 2."""

    root: float
    omega_radps: float
    frequency_hz: float


class PrintedRange(NamedTuple):
    """One object of Table 3; percentages as printed (None: "about 0")."""

    name: str
    still_m: float
    vibrating_m: float
    corrected_m: float
    error_percent: float
    left_percent: float | None


# Table 1
YOUNGS_MODULUS = 70e9  # "70 * 10^9 GPa"
DENSITY_KGPM3 = 2700.0  # Table 1
SECOND_MOMENT_M4 = 4.225e-10  # Table 1
AREA_M2 = 3.07e-8  # Table 1
TIP_MASS = 0.035  # the paper: Table 1, ".035 g"
LENGTH_M = 0.1115  # the paper: Table 1

# Table 2
MODES = (PrintedMode(1.047, 126.305, 20.1028), PrintedMode(3.974, 1865.8, 296.955), PrintedMode(7.098, 5952.3, 947.34))

# Tables 3 and 4
BASELINE_M = 1.98
OBJECTS = (
    PrintedRange("Checker board", 5.137, 5.078, 5.148, 1.14, 0.20),
    PrintedRange("Bucket", 4.096, 4.051, 4.088, 1.09, 0.19),
    PrintedRange("Cone", 3.936, 3.891, 3.936, 1.14, None),
)
FAR_M = 60.0  # the paper: Table 4
FAR_VIBRATING_M = 52.8  # the paper: Table 4
FAR_CORRECTED_M = 56.8  # the paper: Table 4
FAR_ERROR_PERCENT = 12.0  # the paper: Table 4
FAR_LEFT_PERCENT = 5.3  # the paper: Table 4
FAR_REMOVED_PERCENT = 55.5  # the paper: text of Table 4

# the experiments
BEAM_BASELINE_M = 0.254  # the paper: "10 inch"
BEAM_REMOVED_PERCENT = 70.0  # the paper: "by more than 70%"
NOISE_BAND_HZ = 200.0  # the paper: the random drive of Figs. 11 and 12
AVERAGES = 100  # of the spectra in Figs. 11 and 12
