"""Equations 1 to 12: the code that stands for each, a check by number, and the misprints shown by number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from companion.core.stereo.exposure import rest_exposures
from companion.core.stereo.geometry import Rig, orientation_axis
from companion.core.stereo.rotation import exp_rotation, log_rotation, relative_rotation, skew
from companion.core.stereo.triangulation import match_rays, range_axis_of_rig, triangulate
from companion.core.wing.beam import BeamMode, characteristic
from companion.paper import printed
from companion.paper.beam_tables import corrected_beam
from companion.paper.findings import Section, number
from companion.paper.range_tables import exact_toe_rad
from companion.params.files import load_airframe
from companion.records import ClockName, Floats, MatchSet, Side
from companion.reporting.blocks import Table
from companion.units import Orientation

_AXIS = np.array([0.48, -0.6, 0.64])  # chosen: a unit vector with no component zero
_ANGLE_RAD = 0.7  # chosen: large enough that no small-angle formula passes
_STEP = 1e-3  # of the beam's length, for differences (numerical)


@dataclass(frozen=True, slots=True)
class Equation:
    """One audited equation.

    ``error`` is that of our implementation in the stated check; ``as_printed`` the same of the formula as printed,
    None where it is right.
    """

    label: str
    meaning: str
    implementation: str
    check: str
    error: float
    as_printed: float | None
    remark: str = ""


def audit() -> list[Equation]:
    """All equations, in the paper's order."""
    return [_stereo(), *_rotations(), *_beam()]


# ------------------------------------------------------------------------------------------------ eq. 1


def projected_range_m(depth_m: float, slope_rad: float) -> tuple[float, float]:
    """Disparity (px) of a point below a bent flying wing, and the range that the rest calibration reads from it.

    ``slope_rad`` is the up-bend of both tips: positive diverges, negative converges.
    """
    rig = Rig.from_airframe(load_airframe("paper-flying-wing"))
    point = np.array([[0.0, 0.0, depth_m]])
    pixels = {side: rig.project(side, rig.pose(side, slope_rad, 0.0), point) for side in Side}
    matches = MatchSet(
        0, 0, (ClockName.HOST, ClockName.HOST), np.zeros(2, np.int64), 0, 0,
        pixels[Side.LEFT], pixels[Side.RIGHT], np.ones(1), 0,
    )  # fmt: skip
    sight = range_axis_of_rig(rig, orientation_axis(Orientation.DOWN))
    depths = triangulate(match_rays(rig, rest_exposures(rig), matches), sight, np.ones(1))
    return float((pixels[Side.LEFT] - pixels[Side.RIGHT])[0, 0]), float(1.0 / depths.inverse_pm[0])


def _stereo() -> Equation:
    rig = Rig.from_airframe(load_airframe("paper-flying-wing"))
    depth = printed.OBJECTS[0].still_m
    disparity, read = projected_range_m(depth, 0.0)
    by_formula = rig.baseline_m * rig.left.lens.focal_px / disparity
    check = f"a point at {depth} m through both lenses: our range against B f / d"
    return Equation(
        "1", "Z = B f / d", "core.stereo.triangulation.triangulate", check, abs(read - by_formula), as_printed=None
    )


def convergence() -> dict[str, float]:
    """Change that half of Table 3's board angle at each camera does to disparity and range, either way."""
    board = printed.OBJECTS[0]
    slope = 0.5 * exact_toe_rad(board)
    still, _ = projected_range_m(board.still_m, 0.0)
    converged, long = projected_range_m(board.still_m, -slope)
    diverged, short = projected_range_m(board.still_m, slope)
    return {
        "still_px": still,
        "converged_px": converged,
        "converged_range_m": long,
        "diverged_px": diverged,
        "diverged_range_m": short,
    }


# ------------------------------------------------------------------------------------------------ eqs. 2 to 8


def eq_7_as_printed(axis: Floats, angle_rad: float) -> Floats:
    """The matrix (3, 3) of eq. 7, letter by letter; ``axis`` (3,)."""
    x, y, z = axis.tolist()
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    v = 1.0 - c
    return np.array(
        [
            [c + x * x * v, -x * y * v + z * s, x * z * v + y * s],
            [x * y * v + z * s, c + y * y * v, -y * z * v + x * s],
            [x * z * v + y * s, -y * z * v + x * s, c + z * z * v],
        ]
    )


def defect(matrix: Floats) -> float:
    """How far a matrix (3, 3) is from a rotation: the largest entry of ``R R^T - I``."""
    return float(np.max(np.abs(matrix @ matrix.T - np.eye(3))))


def wrong_entries() -> list[str]:
    """Entries of eq. 7 that differ from eq. 6, as row and column."""
    gap = np.abs(eq_7_as_printed(_AXIS, _ANGLE_RAD) - exp_rotation(_ANGLE_RAD * _AXIS))
    return [f"{row + 1}{column + 1}" for row, column in np.argwhere(gap > 1e-12).tolist()]


def _rotations() -> list[Equation]:
    vector = _ANGLE_RAD * _AXIS
    rotation, other = exp_rotation(vector), exp_rotation(np.array([-0.2, 0.4, 0.1]))
    probe = np.array([0.3, -1.2, 2.0])
    back = log_rotation(rotation)
    by_axis = np.eye(3) + math.sin(_ANGLE_RAD) * skew(_AXIS) + (1.0 - math.cos(_ANGLE_RAD)) * skew(_AXIS) @ skew(_AXIS)
    module = "core.stereo.rotation."
    relative = relative_rotation(rotation, other)
    return [
        Equation("2", "RV = [theta_x, theta_y, theta_z]", module + "log_rotation", "log(exp(RV)) against RV",
                 float(np.max(np.abs(back - vector))), None),
        Equation("3", "theta = |RV|", module + "exp_rotation", "|log R| against theta",
                 abs(float(np.linalg.norm(back)) - _ANGLE_RAD), None),
        Equation("4", "Omega = RV / theta", module + "exp_rotation", "R Omega against Omega, the fixed axis",
                 float(np.max(np.abs(rotation @ _AXIS - _AXIS))), None),
        Equation("5", "Omega_v", module + "skew", "Omega_v b against the cross product",
                 float(np.max(np.abs(skew(_AXIS) @ probe - np.cross(_AXIS, probe)))), None),
        Equation("6", "Rodrigues", module + "exp_rotation", "against the formula; R R^T - I",
                 max(float(np.max(np.abs(rotation - by_axis))), defect(rotation)), None),
        Equation("7", "Rodrigues written out", "not used; eq. 6 is", "R R^T - I", defect(rotation),
                 defect(eq_7_as_printed(_AXIS, _ANGLE_RAD)),
                 f"entries {', '.join(wrong_entries())} are wrong in sign; not a rotation"),
        Equation("8", "R = R_r R_l^T", module + "relative_rotation", "R takes left coordinates to right ones",
                 float(np.max(np.abs(relative @ (other @ probe) - rotation @ probe))), None),
    ]  # fmt: skip


# ------------------------------------------------------------------------------------------------ eqs. 9 to 12


def eq_12_root(mass_ratio: float) -> float:
    """First root with eq. 12's shear sign as printed: 1 + cos cosh - mu x (cos sinh - sin cosh) = 0.

    Changing the sign of the tip's inertia changes the sign of ``mu`` in the characteristic equation, nothing else.
    """
    grid = np.linspace(0.05, 5.0, 400)
    values = np.array([characteristic(float(x), -mass_ratio) for x in grid])
    turn = int(np.flatnonzero(values[:-1] * values[1:] < 0)[0])
    return float(brentq(characteristic, grid[turn], grid[turn + 1], args=(-mass_ratio,)))


def _fourth(mode: BeamMode, xi: Floats) -> Floats:
    """Y'''' by differences of the curvature, per length to the fourth."""
    step = _STEP * mode.length_m
    station: Floats = xi * np.float64(mode.length_m)
    return (mode.curvature(station - step) - 2.0 * mode.curvature(station) + mode.curvature(station + step)) / step**2


def _beam() -> list[Equation]:
    beam = corrected_beam()
    mode = beam.modes(1)[0]
    xi = np.linspace(0.1, 0.9, 9)
    c_squared = beam.youngs_modulus_pa * beam.second_moment_m4 / (beam.density_kgpm3 * beam.area_m2)
    inertia = mode.omega_radps**2 * mode.shape(xi * mode.length_m)
    wave = float(np.max(np.abs(c_squared * _fourth(mode, xi) - inertia)) / np.max(np.abs(inertia)))
    x = mode.root * np.linspace(0.0, 1.0, 40)
    basis = np.stack([np.sin(x), np.cos(x), np.sinh(x), np.cosh(x)], axis=1)
    shape = mode.shape(np.linspace(0.0, mode.length_m, 40))
    fit = np.linalg.lstsq(basis, shape, rcond=None)[0]
    root = np.zeros(1)
    held = max(abs(float(mode.shape(root)[0])), abs(float(mode.slope(root)[0])) * mode.length_m)
    shear, inertial = tip_shear(mode)
    name = "core.wing.beam."
    return [
        Equation("9", "Y_tt + c^2 Y_xxxx = 0", name + "Beam.modes", "omega^2 Y against c^2 Y'''', mode 1, relative",
                 wave, None, "checked by finite differences, whose own error this is"),
        Equation("10", "Y = c1 sin + c2 cos + c3 sinh + c4 cosh", name + "BeamMode.shape", "fit of the four functions",
                 float(np.max(np.abs(basis @ fit - shape))), None),
        Equation("11", "Y = Y' = 0 at the root", name + "BeamMode.shape, slope", "per unit at the tip", held, None),
        Equation("12", "Y'' = 0, E I Y''' = m w_tt at the tip", name + "characteristic",
                 "shear against tip inertia, relative", abs(shear / inertial - 1.0), abs(-shear / inertial - 1.0),
                 f"with the printed sign the first root would be {number(eq_12_root(mode.mass_ratio), 3)}"),
    ]  # fmt: skip


def tip_shear(mode: BeamMode) -> tuple[float, float]:
    """Y''' at the tip by one-sided differences, and ``-mu x^4 Y`` scaled by the length: what it must equal."""
    step = _STEP * mode.length_m
    tip: Floats = np.float64(mode.length_m) - np.float64(step) * np.arange(3)
    k0, k1, k2 = mode.curvature(tip).tolist()
    return (3 * k0 - 4 * k1 + k2) / (2 * step), -mode.mass_ratio * mode.root**4 / mode.length_m**3


def section() -> Section:
    """The audit as a section."""
    equations = audit()
    turned = convergence()
    tip = next(entry for entry in equations if entry.label == "12")
    seventh = next(entry for entry in equations if entry.label == "7")
    data: dict[str, Any] = {
        "equations": {
            entry.label: {
                "implementation": entry.implementation,
                "error": entry.error,
                "error_as_printed": entry.as_printed,
                "remark": entry.remark,
            }
            for entry in equations
        },
        "eq_7_wrong_entries": wrong_entries(),
        "eq_12_root_as_printed": eq_12_root(corrected_beam().mass_ratio),
        "convergence": turned,
    }
    findings = (
        f"Eq. 7 as printed is not a rotation (R R^T - I up to {number(seventh.as_printed, 3)}): {seventh.remark}. "
        "Eq. 6 is right and is what flies.",
        f"Eq. 12's sign of the tip's inertia is wrong: {tip.remark}.",
        "The text says that converging cameras see smaller disparities and read shorter. Converging by Table 3's angle "
        f"takes the disparity from {turned['still_px']:.1f} to {turned['converged_px']:.1f} px and the range from "
        f"{printed.OBJECTS[0].still_m} to {turned['converged_range_m']:.3f} m: smaller, and LONGER. Diverging gives "
        f"{turned['diverged_range_m']:.3f} m, which is Table 3.",
        "The matrix equation after eq. 12 is numbered (1) again and is not a determinant of the conditions above; it "
        "refers to an equation 17 that does not exist. The standard frequency equation stands in for it.",
    )
    return Section("equations", "Equations 1 to 12", findings, (_table(equations),), (), data)


def _table(equations: list[Equation]) -> Table:
    rows = tuple(
        (
            entry.label,
            entry.meaning,
            entry.implementation,
            entry.check,
            number(entry.error, 2),
            "" if entry.as_printed is None else number(entry.as_printed, 3),
            entry.remark,
        )
        for entry in equations
    )
    heads = ("eq.", "says", "implementation (companion.)", "check", "error of ours", "as printed", "remark")
    return Table(heads, rows, title="Equation by equation")
