"""Tables 1 and 2: the beam's properties as printed and as corrected, and what frequencies follow from each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from companion.core.wing.beam import Beam, characteristic_roots
from companion.paper import printed
from companion.paper.findings import Section, deviation, number, percent
from companion.records import Floats
from companion.reporting.blocks import Table

STRIP_WIDTH_M = 0.0507  # derived: area and second moment of one strip that fit Table 2
STRIP_THICKNESS_M = 0.001  # derived: with the width above
HEAVIER_TIP_KG = 0.0365  # derived: the printed 35 g corrected by the digits that bring mode 1 to Table 2
_POWERS = range(-9, 10)


@dataclass(frozen=True, slots=True)
class Property:
    """One line of Table 1 in SI units: as printed (units included), as corrected, and why."""

    what: str
    as_printed: str
    printed: float
    corrected: float
    unit: str
    because: str
    sure: str


def properties() -> tuple[Property, ...]:
    """Table 1, line by line."""
    strip = corrected_beam()
    return (
        Property("E", "70e9 GPa", printed.YOUNGS_MODULUS * 1e9, strip.youngs_modulus_pa, "Pa",
                 "70e9 GPa is a thousand million times aluminium", "certain"),
        Property("rho", "2700 kg/m^3", printed.DENSITY_KGPM3, strip.density_kgpm3, "kg/m^3", "aluminium", "as printed"),
        Property("I", "4.225e-10 m^4", printed.SECOND_MOMENT_M4, strip.second_moment_m4, "m^4",
                 "b h^3 / 12 of a strip of 50.7 x 1.00 mm, to the last digit", "inferred"),
        Property("A", "3.07e-8 m^2", printed.AREA_M2, strip.area_m2, "m^2",
                 "the same strip; one wrong digit and the power of ten",
                 "inferred: A and I of one strip fit all three frequencies, and no power of ten does"),
        Property("m", ".035 g", printed.TIP_MASS * 1e-3, strip.tip_mass_kg, "kg",
                 "kg is certain: Table 2 needs a tip of 2.3 to 2.4 beam masses. The last digits bring mode 1 from 2 % "
                 "to 0.02 %", "unit certain, digits a guess"),
        Property("l", ".1115 m", printed.LENGTH_M, strip.length_m, "m", "", "as printed"),
    )  # fmt: skip


def printed_omegas() -> Floats:
    """Table 2's frequencies, rad/s, (3,)."""
    return np.array([mode.omega_radps for mode in printed.MODES])


def literal_beam() -> Beam:
    """Table 1 taken at its word, units included."""
    return Beam(
        printed.YOUNGS_MODULUS * 1e9,
        printed.SECOND_MOMENT_M4,
        printed.DENSITY_KGPM3,
        printed.AREA_M2,
        printed.LENGTH_M,
        printed.TIP_MASS * 1e-3,
    )


def corrected_beam(tip_mass_kg: float = HEAVIER_TIP_KG) -> Beam:
    """The strip that fits Table 2: 50.7 x 1.00 mm of aluminium."""
    width, thickness = STRIP_WIDTH_M, STRIP_THICKNESS_M
    return Beam(
        printed.YOUNGS_MODULUS,
        width * thickness**3 / 12.0,
        printed.DENSITY_KGPM3,
        width * thickness,
        printed.LENGTH_M,
        tip_mass_kg,
    )


def implied_mass_ratio(root: float) -> float:
    """Tip mass ratio for which ``root`` solves ``1 + cos x cosh x + mu x (cos x sinh x - sin x cosh x) = 0``."""
    x = root
    return -(1.0 + math.cos(x) * math.cosh(x)) / (x * (math.cos(x) * math.sinh(x) - math.sin(x) * math.cosh(x)))


def best_fit() -> tuple[float, float, Floats]:
    """Mass ratio and omega/(beta*l)^2 that fit the printed frequencies best, and the deviations left, (3,)."""
    logs = np.log(printed_omegas())

    def residuals(mass_ratio: float) -> Floats:
        gap = logs - 2.0 * np.log(characteristic_roots(3, mass_ratio))
        return np.asarray(gap - gap.mean())

    minimum = minimize_scalar(lambda mu: float(np.sum(residuals(mu) ** 2)), bounds=(1.5, 3.5), options={"xatol": 1e-9})
    mass_ratio = float(minimum.x)
    roots = characteristic_roots(3, mass_ratio)
    scale = float(np.exp(np.mean(logs - 2.0 * np.log(roots))))
    return mass_ratio, scale, np.asarray(np.exp(-residuals(mass_ratio)) - 1.0)


def powers_of_ten() -> tuple[float, int, int]:
    """Best powers of ten for A and I as printed: the worst deviation of three modes that they leave, and the powers."""
    candidates = []
    for a, i in itertools.product(_POWERS, _POWERS):
        area, moment = printed.AREA_M2 * 10.0**a, printed.SECOND_MOMENT_M4 * 10.0**i
        beam = Beam(printed.YOUNGS_MODULUS, moment, printed.DENSITY_KGPM3, area, printed.LENGTH_M, printed.TIP_MASS)
        gaps = [deviation(m.omega_radps, p.omega_radps) for m, p in zip(beam.modes(3), printed.MODES, strict=True)]
        candidates.append((max(abs(gap) for gap in gaps), a, i))
    return min(candidates)


def section() -> Section:
    """Tables 1 and 2 audited."""
    beams = {
        "as printed": literal_beam(),
        "strip, 0.0350 kg": corrected_beam(printed.TIP_MASS),
        "strip, 0.0365 kg": corrected_beam(),
    }
    mass_ratio, scale, left = best_fit()
    worst, area_power, moment_power = powers_of_ten()
    modes = {name: _of_beam(beam) for name, beam in beams.items()}
    modes["best fit"] = _of_fit(mass_ratio, scale)
    implied = [implied_mass_ratio(mode.root) for mode in printed.MODES]
    scales = [mode.omega_radps / mode.root**2 for mode in printed.MODES]
    first_root = float(characteristic_roots(1, mass_ratio)[0])
    hertz = printed.MODES[0].omega_radps / (2.0 * math.pi)
    data: dict[str, Any] = {
        "modes": modes,
        "implied_mass_ratio": implied,
        "omega_over_root_squared": scales,
        "best_fit": {"mass_ratio": mass_ratio, "omega_scale_radps": scale, "deviation": left.tolist()},
        "first_root_of_best_fit": first_root,
        "first_root_of_omega_1": math.sqrt(printed.MODES[0].omega_radps / scale),
        "first_frequency_hz": hertz,
        "powers_of_ten": {"worst_deviation": worst, "area_power": area_power, "moment_power": moment_power},
        "strip": {"area_m2": corrected_beam().area_m2, "second_moment_m4": corrected_beam().second_moment_m4},
    }
    findings = (
        f"With a 50.7 x 1.00 mm strip and a tip of {HEAVIER_TIP_KG} kg all three frequencies come within "
        f"{percent(max(abs(row['deviation']) for row in modes['strip, 0.0365 kg']))} of Table 2.",
        f"As printed the beam would ring at {number(beams['as printed'].modes(1)[0].frequency_hz, 3)} Hz.",
        f"No power of ten for A and I repairs Table 1: the best one leaves {percent(worst, 1)}.",
        f"No single tip mass gives the three beta*l: they imply mu = {', '.join(number(mu) for mu in implied)}.",
        f"omega_1 belongs to beta*l = {number(data['first_root_of_omega_1'])}, not {printed.MODES[0].root}: "
        f"omega/(beta*l)^2 is {', '.join(number(k, 6) for k in scales)}. Best fit: mu = {number(mass_ratio)}, "
        f"K = {number(scale, 6)} rad/s.",
        f"{printed.MODES[0].omega_radps} rad/s is {hertz:.4f} Hz, not {printed.MODES[0].frequency_hz}.",
    )
    return Section("tables_1_2", "Tables 1 and 2: the beam", findings, _tables(modes), (), data)


def _against_table_2(roots: Iterable[float], omegas_radps: Iterable[float]) -> list[dict[str, float]]:
    return [
        {
            "root": root,
            "omega_radps": omega,
            "frequency_hz": omega / (2.0 * math.pi),
            "root_deviation": deviation(root, row.root),
            "deviation": deviation(omega, row.omega_radps),
            "frequency_deviation": deviation(omega / (2.0 * math.pi), row.frequency_hz),
        }
        for root, omega, row in zip(roots, omegas_radps, printed.MODES, strict=True)
    ]


def _of_beam(beam: Beam) -> list[dict[str, float]]:
    modes = beam.modes(3)
    return _against_table_2([mode.root for mode in modes], [mode.omega_radps for mode in modes])


def _of_fit(mass_ratio: float, scale_radps: float) -> list[dict[str, float]]:
    roots = characteristic_roots(3, mass_ratio).tolist()
    return _against_table_2(roots, [scale_radps * root**2 for root in roots])


def _tables(modes: dict[str, list[dict[str, float]]]) -> tuple[Table, ...]:
    rows = []
    for name, modes_of_case in modes.items():
        for n, (mode, row) in enumerate(zip(modes_of_case, printed.MODES, strict=True), start=1):
            rows.append((
                name if n == 1 else "", str(n), f"{row.root}", number(mode["root"]), percent(mode["root_deviation"]),
                f"{row.omega_radps}", number(mode["omega_radps"], 6), percent(mode["deviation"]),
                f"{row.frequency_hz}", number(mode["frequency_hz"], 6), percent(mode["frequency_deviation"]),
            ))  # fmt: skip
    header = (
        "beam", "mode", "beta*l printed", "ours", "dev.", "rad/s printed", "ours", "dev.", "Hz printed", "ours", "dev.",
    )  # fmt: skip
    lines = tuple(
        (p.what, p.as_printed, f"{p.corrected:.4g} {p.unit}", _times(p.printed / p.corrected), p.because, p.sure)
        for p in properties()
    )
    heads = ("", "printed", "ours", "printed / ours", "because", "sure?")
    note = "dev.: ours over the printed figure, less 1. Strip: 50.7 x 1.00 mm. Best fit: mass ratio, stiffness free."
    return (
        Table(heads, lines, title="Table 1: printed against corrected"),
        Table(header, rows, title="Table 2: printed against computed", note=note),
    )


def _times(ratio: float) -> str:
    return "1" if math.isclose(ratio, 1.0) else number(ratio, 3)
